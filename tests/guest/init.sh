#!/bin/sh
# The first process of the guest. Its root is this machine's, read-only, under an overlay that is gone with the guest;
# $SHARE is at /vm and `bind` says what else is seen where. Then systemd, which runs /vm/cmd and powers off.
# Of the host's root nothing may be written: systemd's tmpfiles empty /tmp when they start.
set -e
export PATH=/usr/sbin:/usr/bin:/sbin:/bin
mount -t proc proc /proc
for word in $(cat /proc/cmdline); do
	case $word in share=*) SHARE=${word#*=} ;; bind=*) BINDS=${word#*=} ;; esac
done
MODULES=/usr/lib/uml/modules/$(uname -r)
mount -t tmpfs -o mode=755 tmpfs /mnt
mkdir -p /mnt/upper /mnt/work /mnt/root /mnt/modules
mount -t hostfs -o ro -o "$MODULES" none /mnt/modules
insmod /mnt/modules/kernel/fs/overlayfs/overlay.ko
ROOT=/mnt/root
mount -t overlay -o lowerdir=/,upperdir=/mnt/upper,workdir=/mnt/work overlay $ROOT
mkdir -p "$ROOT/lib/modules/$(uname -r)" $ROOT/vm
mount -t hostfs -o ro -o "$MODULES" none "$ROOT/lib/modules/$(uname -r)"
mount -t hostfs -o "$SHARE" none $ROOT/vm
IFS=,
for bind in $BINDS; do
	mkdir -p "$ROOT${bind#*:}"
	mount -t hostfs -o ro -o "${bind%%:*}" none "$ROOT${bind#*:}"
	# A Python may name its library by a RUNPATH into a home, which units do not see: then it is found where it is bound,
	# and not taken from another build that the machine has.
	if [ -d "$ROOT${bind#*:}/lib" ]; then echo "${bind#*:}/lib" >>$ROOT/etc/ld.so.conf.d/00-bound.conf; fi
done
unset IFS
chroot $ROOT ldconfig
# Nothing that the host happens to have enabled, and /tmp as it is: the service's environment may be in it.
units=$ROOT/etc/systemd/system
mkdir -p $ROOT/etc/tmpfiles.d $units
rm -rf $units/*.wants
mkdir -p $units/multi-user.target.wants
ln -sfn /dev/null $ROOT/etc/tmpfiles.d/tmp.conf
for unit in tmp.mount getty.target console-getty.service systemd-random-seed.service systemd-timesyncd.service; do
	ln -sfn /dev/null $units/$unit
done
: >$ROOT/etc/fstab
ln -sfn /lib/systemd/system/multi-user.target $units/default.target
cat >$units/guest.service <<UNIT
[Unit]
After=multi-user.target
SuccessAction=poweroff-force
FailureAction=poweroff-force
[Service]
Type=oneshot
TimeoutStartSec=infinity
ExecStart=/bin/sh -c '/bin/sh /vm/cmd >/vm/output.txt 2>&1; echo \$? >/vm/rc; journalctl -b -o short-monotonic --no-pager >/vm/journal.txt; sync'
UNIT
ln -sfn ../guest.service $units/multi-user.target.wants/guest.service
mkdir -p $ROOT/etc/systemd/network
ln -sfn /lib/systemd/system/systemd-networkd.service $units/multi-user.target.wants/systemd-networkd.service
if [ -b /dev/ubda ]; then # what lasts through a power cut
	mkdir -p $ROOT/disk $ROOT/var/lib/faultline-bundles $ROOT/var/lib/private
	mount -t ext4 /dev/ubda $ROOT/disk
	mkdir -p $ROOT/disk/bundles $ROOT/disk/private
	chmod 700 $ROOT/disk/private
	mount --bind $ROOT/disk/bundles $ROOT/var/lib/faultline-bundles
	mount --bind $ROOT/disk/private $ROOT/var/lib/private
fi
mount -t proc proc $ROOT/proc
mount -t devtmpfs dev $ROOT/dev 2>/dev/null || true
umount /proc
# The overlay becomes the root, and is not only seen as one: units with PrivateUsers= are refused in a chroot.
cd $ROOT
mkdir -p before
pivot_root . before
exec chroot . /lib/systemd/systemd
