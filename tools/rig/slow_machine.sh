#!/bin/bash
# slow_machine.sh PERCENT COMMAND [ARGUMENT...]: runs COMMAND with so much of this machine's processor time, as root, by
# the quota of a control group (version 1 or 2). `tools/rig/slow_machine.sh 33 make test` is a machine three times slower.
set -euo pipefail
percent=$1
shift
quota=$(($(nproc) * 100000 * percent / 100))
if [ -e /sys/fs/cgroup/cgroup.controllers ]; then
  group=/sys/fs/cgroup/slow-machine.$$
  echo +cpu >/sys/fs/cgroup/cgroup.subtree_control
  mkdir "$group"
  echo "$quota 100000" >"$group/cpu.max"
else
  group=/sys/fs/cgroup/cpu/slow-machine.$$
  mkdir "$group"
  echo 100000 >"$group/cpu.cfs_period_us"
  echo "$quota" >"$group/cpu.cfs_quota_us"
fi
trap 'rmdir "$group" 2>/dev/null || true' EXIT
(
  echo "$BASHPID" >"$group/cgroup.procs"
  exec "$@"
)
