#!/bin/bash
# install_debian.sh [PACKAGE...]: installs the Debian packages that the tests use, and these; one clear line when that is
# not possible.
# The tests that need a missing package say so and are skipped.
set -u
packages=(mosquitto nodejs gcc strace qemu-system-x86 qemu-user kmod busybox-static cpio v4l-utils systemd-container dbus chromium chromium-driver udev python3-systemd libsystemd-dev pkg-config "$@")
missing=()
for p in "${packages[@]}"; do
  [ "$(dpkg-query -W -f='${db:Status-Status}' "$p" 2>/dev/null)" = installed ] || missing+=("$p")
done
[ ${#missing[@]} -eq 0 ] && exit 0
sudo=
if [ "$(id -u)" -ne 0 ]; then
  if sudo -n true 2>/dev/null; then sudo="sudo -n"; else
    echo "tests: missing Debian packages (${missing[*]}) and neither root nor sudo: the broker, browser and guest tests will be skipped"
    exit 0
  fi
fi
if ! command -v apt-get >/dev/null; then
  echo "tests: no apt-get here; missing ${missing[*]}: the broker, browser and guest tests will be skipped"
  exit 0
fi
export DEBIAN_FRONTEND=noninteractive
$sudo apt-get update -qq && $sudo apt-get install -y -qq --no-install-recommends "${missing[@]}" >/dev/null ||
  echo "tests: apt-get could not install ${missing[*]}: the tests that need them will be skipped"
