#!/usr/bin/env bash
# A real MQTT broker for the tests, which start it themselves on a free port. Nothing is done where it is there. Where it
# cannot be had, one line says what to do, and the tests that need it are skipped.
set -euo pipefail
has() { command -v mosquitto >/dev/null || [ -x /usr/sbin/mosquitto ]; }
refuse() {
	echo "no MQTT broker, its tests are skipped: $1" >&2
	exit 0
}
has && exit 0
command -v apt-get >/dev/null || refuse "install mosquitto"
[ "$(id -u)" = 0 ] || refuse "as root: apt-get install mosquitto"
export DEBIAN_FRONTEND=noninteractive
# Its unit would start one on the standard port.
install() { RUNLEVEL=1 apt-get install -y -qq --no-install-recommends mosquitto >/dev/null 2>&1; }
echo "installing the MQTT broker that tests need (mosquitto)"
install || { apt-get update -qq >/dev/null 2>&1 && install; } || refuse "apt-get install mosquitto fails"
has || refuse "mosquitto is not where it is on Debian 12"
