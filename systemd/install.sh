#!/bin/bash
# install.sh [--uninstall]: puts the service in place, as root; running it again changes nothing that a person edited.
# DESTDIR=DIR stages the files below DIR and touches neither Python, users nor the running system; LIB=/usr/lib puts them
# where a distribution's packages have theirs.
# PYTHON chooses the interpreter (3.11 to 3.14; default python3).
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
dest=${DESTDIR:-}
app=/opt/tacshade-edge
lib=${LIB:-/usr/local/lib}
rules=${LIB:-/etc}/udev/rules.d
# So that sudo finds the command; a distribution's package has its own in /usr/bin.
command=/usr/local/bin/tacshade-edge
# source and target
files=(
  "tacshade-edge.service $lib/systemd/system/tacshade-edge.service"
  "tacshade-dashboard.service $lib/systemd/system/tacshade-dashboard.service"
  "tacshade-edge.sysusers $lib/sysusers.d/tacshade-edge.conf"
  "99-tacshade.rules $rules/99-tacshade.rules"
)
# A person edits these: never overwritten, removed only when they are as installed.
edited=(
  "../config/default.yaml /etc/tacshade-edge/config.yaml"
  "mosquitto-tacshade.conf /etc/mosquitto/conf.d/tacshade.conf"
  "mosquitto-tacshade.acl /etc/mosquitto/tacshade.acl"
)

fail() { echo "install.sh: $1" >&2; exit "${2:-1}"; }
live() { [ -z "$dest" ]; }

install_all() {
  for line in "${files[@]}"; do
    read -r from to <<<"$line"
    install -D -m 644 "$here/$from" "$dest$to"
  done
  live && { "$here/environment.sh" "$app" || exit 1; }
  if [ -z "${LIB:-}" ] && ! [ -e "$dest$command" ]; then
    install -d "$dest${command%/*}"
    ln -sfn "$app/bin/tacshade-edge" "$dest$command"
  fi
  install -d -m 750 "$dest/etc/tacshade-edge"
  for line in "${edited[@]}"; do
    read -r from to <<<"$line"
    if [ -e "$dest$to" ]; then cmp -s "$here/$from" "$dest$to" || echo "kept: $to"; else install -D -m 644 "$here/$from" "$dest$to"; fi
  done
  if live; then
    "$here/refresh.sh" "$lib"
    systemctl enable --quiet tacshade-edge.service
    echo "installed; calibrate, edit /etc/tacshade-edge/config.yaml, then: systemctl restart tacshade-edge"
  fi
}

uninstall_all() {
  live && { systemctl disable --quiet --now tacshade-edge.service tacshade-dashboard.service 2>/dev/null || true; }
  for line in "${files[@]}"; do rm -f "$dest${line#* }"; done
  if [ "$(readlink "$dest$command")" = "$app/bin/tacshade-edge" ]; then rm "$dest$command"; fi
  for line in "${edited[@]}"; do
    read -r from to <<<"$line"
    [ -e "$dest$to" ] || continue
    if cmp -s "$here/$from" "$dest$to"; then rm -f "$dest$to"; else echo "kept: $to (edited)"; fi
  done
  rmdir "$dest/etc/tacshade-edge" 2>/dev/null || true
  if live; then
    rm -rf "$app"
    "$here/refresh.sh" "$lib"
    echo "uninstalled; kept: /var/lib/tacshade-edge (calibrations) and the user tacshade-edge"
  fi
}

live && [ "$(id -u)" -ne 0 ] && fail "expected root (or DESTDIR=DIR to stage the files)"
live && dpkg-query -W -f='${db:Status-Status}' tacshade-edge 2>/dev/null | grep -qx installed &&
  fail "found the Debian package, expected apt-get remove tacshade-edge first; settings and calibrations stay"
case "${1:-}" in
  "") install_all ;;
  --uninstall) uninstall_all ;;
  *) fail "found $1, expected --uninstall or nothing" 2 ;;
esac
