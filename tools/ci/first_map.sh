#!/bin/bash
# first_map.sh apt|pip ADDRESS SUITE VERSION: in a bare guest, from nothing to a height map that a subscriber decodes.
# Prints the minutes since the installation began at each step; ends with 0 when a map came.
set -euo pipefail
way=$1 address=$2 suite=$3 version=$4
host=${address#http://} host=${host%:*}
export DEBIAN_FRONTEND=noninteractive LC_ALL=C.UTF-8
apt=(apt-get -qq -o Acquire::Languages=none -o Dpkg::Use-Pty=0)
[ -s /etc/hosts ] || echo "127.0.0.1 localhost" >/etc/hosts # an installer's work, which debootstrap leaves out
began=$SECONDS
step() { echo "$((SECONDS - began)) s: $1"; }
calibrated() {
  tacshade-edge simulate --calibration-set practice --presses 9
  tacshade-edge calibrate --sensor practice/SENSOR.yaml --reference practice/reference_*.png \
    --presses practice/PRESSES.csv --out calibration.npz
}
export -f calibrated
listen="
import sys, time, tacshade_edge as ts
from tacshade_edge.errors import DeviceError
until = time.monotonic() + 600
while time.monotonic() < until:
    try:
        with ts.listen('localhost:1883', 'tacshade') as sensor:
            for r in sensor:
                if r.in_contact:
                    print(f'a height map of {r.height_mm.shape}, deepest {r.depth_max_mm:.2f} mm')
                    sys.exit()
    except DeviceError as error:
        print(error)
sys.exit('no height map within ten minutes')
"
if [ "$way" = apt ]; then
  /usr/lib/apt/apt-helper download-file "$address/apt/tacshade-edge.asc" /usr/share/keyrings/tacshade-edge.asc
  echo "deb [signed-by=/usr/share/keyrings/tacshade-edge.asc] $address/apt $suite main" \
    >/etc/apt/sources.list.d/tacshade-edge.list
  "${apt[@]}" update
  step "apt update"
  "${apt[@]}" install -y tacshade-edge
  step "apt install: $(dpkg-query -W tacshade-edge), mosquitto $(dpkg-query -W -f='${Version}' mosquitto)"
  [[ $(tacshade-edge --version) == "tacshade-edge $version" ]]
  cd /var/lib/tacshade-edge
  runuser -u tacshade-edge -- bash -c calibrated
  step "calibrated"
  echo "source: {kind: simulated, fps: 5}" >/etc/tacshade-edge/config.yaml
  # An emulated processor takes longer than the unit allows a board.
  mkdir -p /etc/systemd/system/tacshade-edge.service.d
  printf '[Service]\nTimeoutStartSec=infinity\nWatchdogSec=0\n' >/etc/systemd/system/tacshade-edge.service.d/slow.conf
  systemctl daemon-reload
  systemctl restart mosquitto tacshade-edge || { journalctl -n 30 --no-pager -u tacshade-edge; exit 1; }
  step "$(systemctl is-active tacshade-edge)"
  /opt/tacshade-edge/bin/python -c "$listen"
else
  "${apt[@]}" update
  "${apt[@]}" install -y --no-install-recommends mosquitto
  systemctl restart mosquitto
  step "Debian's mosquitto"
  python3 -m venv /root/env
  export PATH=/root/env/bin:$PATH
  pip install --quiet --disable-pip-version-check --index-url "$address/simple/" --trusted-host "$host" \
    'tacshade-edge[dashboard]'
  step "pip install: $(tacshade-edge --version)"
  [[ $(tacshade-edge --version) == "tacshade-edge $version" ]]
  cd /root
  calibrated
  step "calibrated"
  printf 'calibration: calibration.npz\nsource: {kind: simulated, fps: 5}\n' >config.yaml
  tacshade-edge run --config config.yaml &
  python -c "$listen"
fi
step "published"
