#!/bin/sh
# refresh.sh LIB: has this machine know what came to LIB or went from there: the user, what is his to read and write, units,
# rules.
set -eu
users=$1/sysusers.d/tacshade-edge.conf
if [ -e "$users" ]; then
  systemd-sysusers "$users"
  chgrp -R tacshade-edge /etc/tacshade-edge
  # As the unit would at its first start: a person calibrates before that.
  [ -d /var/lib/tacshade-edge ] || install -d -o tacshade-edge -g tacshade-edge /var/lib/tacshade-edge
fi
# Neither runs where a disk's image is made.
[ ! -d /run/systemd/system ] || systemctl daemon-reload
# For cameras that are plugged in already too.
[ ! -S /run/udev/control ] || { udevadm control --reload && udevadm trigger --subsystem-match=video4linux; }
