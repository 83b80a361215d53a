#!/usr/bin/env bash
# What the guest needs of this machine: a kernel that runs as a process (user-mode-linux, Debian and Ubuntu), and
# systemd, udev and can-utils, which the guest takes from here. Nothing is done where all of it is there. Fails, with one
# line that says what to do, where it cannot be had: the tests in this folder are skipped then.
set -euo pipefail
packages=(user-mode-linux kmod iproute2 can-utils systemd systemd-sysv udev dbus e2fsprogs gcc libc6-dev)
missing() {
	local name
	for name in linux.uml canplayer ip systemctl udevadm mkfs.ext4 kmod dbus-daemon cc; do
		command -v "$name" >/dev/null || return 0
	done
	ls /usr/lib/uml/modules/*/kernel/drivers/net/can/vcan.ko >/dev/null 2>&1 || return 0
	return 1
}
refuse() {
	echo "no guest with a CAN bus and systemd, its tests are skipped: $1" >&2
	exit 1
}
missing || exit 0
command -v apt-get >/dev/null || refuse "user-mode-linux is had on Debian and Ubuntu only"
[ "$(id -u)" = 0 ] || refuse "as root: apt-get install ${packages[*]}"
export DEBIAN_FRONTEND=noninteractive
install() { apt-get install -y -qq --no-install-recommends "${packages[@]}" >/dev/null 2>&1; }
echo "installing what a guest with a CAN bus and systemd needs (${packages[*]})"
install || { apt-get update -qq >/dev/null 2>&1 && install; } || refuse "apt-get install ${packages[*]} fails"
missing && refuse "something of ${packages[*]} is not where it is on Debian 12"
exit 0
