#!/bin/busybox sh
# First process of the guest (guest.py packs it): reach the host's root over 9p, lay a memory file system over it,
# run /out/.command there, under systemd as PID 1 if that is wanted; leave its exit status in /out/.status, power off.
# Each second it writes /out/.alive: guest.py gives up on a guest that no longer does.
export PATH=/bin
/bin/busybox --install -s /bin
mount -t proc proc /proc
mount -t sysfs sys /sys
mount -t devtmpfs dev /dev
mkdir -p /dev/pts /dev/shm
mount -t devpts devpts /dev/pts
mount -t tmpfs tmpfs /dev/shm
for module in /modules/*; do insmod "$module" || echo "insmod $module failed"; done
options=trans=virtio,version=9p2000.L,msize=512000
mount -t 9p -o "$options,ro,cache=loose" root /ro || { echo "no root over 9p"; poweroff -f; }
mount -t tmpfs tmpfs /rw
mkdir -p /rw/upper /rw/work
mount -t overlay -o lowerdir=/ro,upperdir=/rw/upper,workdir=/rw/work overlay /new
mkdir -p /new/out /new/lib/modules
mount -t 9p -o "$options,cache=none" out /new/out
modules=@MODULES@
rm -rf "/new/lib/modules/${modules##*/}"
ln -s "$modules" "/new/lib/modules/${modules##*/}"
for folder in dev proc sys; do mount --move /$folder /new/$folder; done
if [ -n "@SYSTEMD@" ]; then
  umount /new/dev/pts
  mkdir -p /new/etc/tmpfiles.d
  ln -sf /dev/null /new/etc/tmpfiles.d/tmp.conf # it would empty /tmp
  sh /systemd_root.sh /new
  cat > /new/scenario.sh <<'END'
export HOME=/root LANG=C.UTF-8 PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin
while echo >/out/.alive; do sleep 1; done &
bash /out/.command > /dev/hvc0 2>&1 < /dev/null
echo $? > /out/.status
sync
END
  exec switch_root /new /lib/systemd/systemd
fi
cat > /rw/first.sh <<'END'
export HOME=/root LANG=C.UTF-8 PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin
mount -t tmpfs tmpfs /run
mount -t tracefs tracefs /sys/kernel/tracing 2>/dev/null
busybox ifconfig lo 127.0.0.1 up
hostname guest 2>/dev/null || busybox hostname guest
while echo >/out/.alive; do sleep 1; done &
setsid bash /out/.command > /dev/hvc0 2>&1 < /dev/null
echo $? > /out/.status
sync
echo o > /proc/sysrq-trigger
sleep 60
END
cp /rw/first.sh /new/first.sh
exec switch_root /new /bin/bash /first.sh
