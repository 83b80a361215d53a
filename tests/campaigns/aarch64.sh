#!/usr/bin/env bash
# A 64-bit ARM machine in FOLDER, by user-mode emulation: the emulator, Debian's Python for arm64, and the vehicle's
# libraries. Nothing of it is installed. apt's own sources and pip's own index are used; 150 MB are fetched.
set -euo pipefail
folder=$(realpath -m "$1") pip=$2 constraints=$3
[ -e "$folder/done" ] && exit 0
refuse() {
	echo "no emulated ARM machine: $1" >&2
	exit 1
}
for tool in apt-get dpkg; do command -v $tool >/dev/null || refuse "needs Debian or Ubuntu's $tool"; done
rm -rf "$folder"
mkdir -p "$folder"/{root,qemu,apt/lists/partial,apt/cache/archives/partial}
touch "$folder/apt/status"
arm() {
	apt-get -qq -o APT::Architecture=arm64 -o APT::Architectures=arm64 -o Dir::State="$folder/apt" \
		-o Dir::State::Lists="$folder/apt/lists" -o Dir::State::status="$folder/apt/status" \
		-o Dir::Cache="$folder/apt/cache" -o APT::Sandbox::User=root "$@"
}
arm update || refuse "apt's sources have no arm64"
arm install -y --no-install-recommends --download-only python3.11 libstdc++6 >/dev/null || refuse "no python3.11:arm64"
for package in "$folder"/apt/cache/archives/*.deb; do dpkg -x "$package" "$folder/root"; done
(cd "$folder/qemu" && apt-get -qq download qemu-user-static 2>/dev/null && dpkg -x qemu-user-static*.deb .) ||
	refuse "qemu-user-static cannot be fetched"
# ONNX Runtime looks at the processor, and dies of what an x86 machine's files say.
cpu=$folder/root/sys/devices/system/cpu
mkdir -p "$folder/root/proc" "$cpu/cpu0/topology"
printf 'processor\t: 0\nFeatures\t: fp asimd evtstrm crc32 cpuid\nCPU implementer\t: 0x41\nCPU architecture: 8
CPU variant\t: 0x0\nCPU part\t: 0xd08\nCPU revision\t: 3\n\n' >"$folder/root/proc/cpuinfo"
for file in possible present kernel_max; do echo 0 >"$cpu/$file"; done
libraries=$(sed -n '/^dependencies = \[/,/^\]/s/^ *"\([a-z-]*\).*/\1/p' pyproject.toml)
# shellcheck disable=SC2086  # a word each
"$pip" install -q --target "$folder/site" --python-version 311 --implementation cp --only-binary=:all: \
	--platform manylinux_2_28_aarch64 --platform manylinux_2_17_aarch64 --platform manylinux2014_aarch64 \
	-c "$constraints" $libraries 2>/dev/null || refuse "pip finds no wheels for it"
touch "$folder/done"
