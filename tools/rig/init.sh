#!/bin/busybox sh
# First process of the guest (guest.py packs it): reach the host's root over 9p, lay a memory file system over it, start
# systemd there, which runs /out/.command; leave its exit status in /out/.status, power off.
# Each second it writes /out/.alive: guest.py gives up on a guest that no longer does.
export PATH=/bin
/bin/busybox --install -s /bin
mount -t proc proc /proc
mount -t sysfs sys /sys
mount -t devtmpfs dev /dev
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
