#!/bin/sh
# systemd_root.sh ROOT: prepares the throw-away root file system at ROOT so that systemd as PID 1 with the argument
# systemd.unit=scenario.target runs ROOT/scenario.sh as root when the machine is up, and powers off after it.
# Nothing of this machine's own services, mounts and identity. For a shell as small as busybox's.
set -eu
root=$1
units=$root/etc/systemd/system
mkdir -p "$units"
: >"$root/etc/fstab"
rm -f "$root/.dockerenv" "$root/run/systemd/container"
echo 0123456789abcdef0123456789abcdef >"$root/etc/machine-id"
ln -sf /dev/null "$units/tmp.mount"
# Minutes of work that no scenario needs.
for unit in systemd-hwdb-update systemd-journal-catalog-update ldconfig systemd-update-done systemd-firstboot \
  systemd-udev-trigger; do
  ln -sf /dev/null "$units/$unit.service"
done
cat >"$units/scenario.target" <<'X'
[Unit]
Wants=scenario.service
Requires=sysinit.target dbus.socket
X
cat >"$units/scenario.service" <<'X'
[Unit]
After=sysinit.target dbus.socket
SuccessAction=exit-force
FailureAction=exit-force
[Service]
Type=oneshot
Environment=HOME=/root SYSTEMD_COLORS=0 SYSTEMD_PAGER=cat
ExecStart=/bin/bash /scenario.sh
TimeoutStartSec=infinity
X
