#!/usr/bin/env bash
# A real browser for the tests of the page, headless. Nothing is done where it is there. Where it cannot be had, one line
# says what to do, and the tests that need it are skipped.
set -euo pipefail
has() { command -v chromium >/dev/null || command -v chromium-browser >/dev/null || command -v google-chrome >/dev/null; }
refuse() {
	echo "no Chromium, the tests of the page are skipped: $1" >&2
	exit 0
}
has && exit 0
command -v apt-get >/dev/null || refuse "install chromium"
[ "$(id -u)" = 0 ] || refuse "as root: apt-get install chromium"
export DEBIAN_FRONTEND=noninteractive
install() { apt-get install -y -qq --no-install-recommends chromium fonts-dejavu-core >/dev/null 2>&1; }
echo "installing the browser that tests need (chromium, a minute)"
install || { apt-get update -qq >/dev/null 2>&1 && install; } || refuse "apt-get install chromium fails"
has || refuse "chromium is not where it is on Debian 12"
