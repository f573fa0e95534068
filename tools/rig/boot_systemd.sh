#!/bin/bash
# boot_systemd.sh FOLDER [NSPAWN OPTIONS]: boots systemd as PID 1 over a throw-away overlay of this machine's root (own
# network, processes and mounts; no video or serial devices) and runs FOLDER/scenario there as root, with FOLDER at
# /payload. Prints what the scenario printed and exits with its status; 125 when it could not boot.
# 124 when it ran longer than LIMIT_S (180).
# Needs root and Debian's systemd-container and dbus.
set -euo pipefail
folder=$(readlink -f "$1")
shift
work=$(mktemp -d "$folder/boot.XXXX")
root=$work/root
cleanup() { umount "$root" "$work/rw" 2>/dev/null; rmdir "$root" "$work/rw"; rm -f "$work/console"; rmdir "$work"; } 2>/dev/null
trap 'cleanup || true' EXIT
mkdir "$work/rw" "$root"
mount -t tmpfs tmpfs "$work/rw"
mkdir "$work/rw/upper" "$work/rw/work"
mount -t overlay overlay -o "lowerdir=/,upperdir=$work/rw/upper,workdir=$work/rw/work" "$root"
rm -f "$root/payload"
"$(dirname "$(readlink -f "$0")")/systemd_root.sh" "$root"
echo '/payload/scenario >/scenario.out 2>&1 </dev/null; echo $? >/scenario.rc' >"$root/scenario.sh"
SYSTEMD_NSPAWN_TMPFS_TMP=0 timeout -k 5 "${LIMIT_S:-180}" systemd-nspawn --quiet --directory="$root" --boot --register=no \
  --keep-unit --private-network --bind="$folder:/payload" "$@" \
  systemd.unit=scenario.target systemd.show_status=0 </dev/null >"$work/console" 2>&1 || true
[ -e "$root/scenario.out" ] || { cat "$work/console"; exit 125; }
cat "$root/scenario.out"
[ -e "$root/scenario.rc" ] || exit 124
exit "$(cat "$root/scenario.rc")"
