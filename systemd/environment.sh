#!/bin/bash
# environment.sh DIR: makes or updates a Python environment of the program in DIR, of exactly the wheels that
# requirements.lock names. PYTHON chooses the interpreter (3.11 to 3.14; default python3).
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
app=${1:?expected a folder}
python=${PYTHON:-python3}

fail() { echo "environment.sh: $1" >&2; exit 1; }

"$python" -c 'import sys; raise SystemExit(not (3, 11) <= sys.version_info[:2] < (3, 15))' 2>/dev/null ||
  fail "found $("$python" --version 2>&1 || true), expected Python 3.11 to 3.14 (set PYTHON)"
[ -x "$app/bin/python" ] || "$python" -m venv "$app" || fail "expected python3-venv"
pip=("$app/bin/python" -m pip install --quiet --disable-pip-version-check --no-deps)
"${pip[@]}" --require-hashes -r "$here/requirements.lock" || fail "pip failed"
# Debian's python3-systemd, where it is installed for this Python: the lock has no wheel of it.
found=$("$python" -c 'import systemd.journal as j; print(j.__file__.rpartition("/")[0])' 2>/dev/null || true)
packages=$("$app/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
[ -z "$found" ] || [ -e "$packages/systemd" ] || ln -sfn "$found" "$packages/systemd"
# What builds ours is of the lock too.
"${pip[@]}" --no-index --no-build-isolation --force-reinstall "$here/.." || fail "pip failed"
