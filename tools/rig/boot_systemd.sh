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
# Nothing of this machine's own services, mounts and identity.
: >"$root/etc/fstab"
rm -f "$root/.dockerenv" "$root/payload"
echo 0123456789abcdef0123456789abcdef >"$root/etc/machine-id"
units=$root/etc/systemd/system
mkdir -p "$units"
ln -sf /dev/null "$units/tmp.mount"
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
ExecStart=/bin/bash -c '/payload/scenario >/scenario.out 2>&1 </dev/null; echo $? >/scenario.rc'
TimeoutStartSec=infinity
X
SYSTEMD_NSPAWN_TMPFS_TMP=0 timeout -k 5 "${LIMIT_S:-180}" systemd-nspawn --quiet --directory="$root" --boot --register=no \
  --keep-unit --private-network --bind="$folder:/payload" "$@" \
  systemd.unit=scenario.target systemd.show_status=0 </dev/null >"$work/console" 2>&1 || true
[ -e "$root/scenario.out" ] || { cat "$work/console"; exit 125; }
cat "$root/scenario.out"
[ -e "$root/scenario.rc" ] || exit 124
exit "$(cat "$root/scenario.rc")"
