#!/bin/bash
# docker compose up, as docs/service.md says: a simulated truck with a clogged tank filter, the service, its subscribers.
# `make campaign-compose`, as root. An engine that is not there is installed and runs for as long as this lasts, without a
# bridge; a base image too, made of Debian's packages, as there may be no registry. Writes docs/results/compose.md.
set -euo pipefail
trap 'echo "campaign-compose: line $LINENO failed; out/campaign-compose has what was said" >&2' ERR
cd "$(dirname "$0")/../.."
WORK=out/campaign-compose DATA=/var/tmp/faultline-docker
FAULT=fA_t WITHIN_S=240
[ "$(id -u)" = 0 ] || { echo "campaign-compose: needs root, for a container engine" >&2; exit 1; }
[ -e out/demo/bundle/manifest.json ] || { echo "campaign-compose: first \`make demo\`, which makes the bundle" >&2; exit 1; }
mkdir -p $WORK
apt-get install -y --no-install-recommends docker.io docker-compose debootstrap >$WORK/apt.log 2>&1
ENGINE=""
if ! docker info >/dev/null 2>&1; then
	[ -e /sys/fs/cgroup/cgroup.controllers ] || mount -t cgroup2 cgroup2 /sys/fs/cgroup
	dockerd --iptables=false --ip6tables=false --bridge=none --ip-forward=false --data-root $DATA >$WORK/engine.log 2>&1 &
	ENGINE=$!
	for _ in $(seq 60); do docker info >/dev/null 2>&1 && break; sleep 1; done
fi
COMPOSE=(docker-compose --file docker-compose.yml --file $WORK/network.yml)
printf 'services:\n' >$WORK/network.yml
for service in service rig watch page mqtt broker; do printf '  %s:\n    build: {network: host}\n' $service >>$WORK/network.yml; done
finish() {
	"${COMPOSE[@]}" down --volumes >>$WORK/compose.log 2>&1 || true
	[ -z "$ENGINE" ] || { kill $ENGINE; wait $ENGINE || true; rm -rf $DATA; }
}
trap finish EXIT
if ! docker image inspect faultline-base >/dev/null 2>&1; then
	ROOT=$(mktemp -d)
	. /etc/os-release
	MIRROR=$(grep -hoE 'https?://[^ ]+/(debian|ubuntu)/?( |$)' -r /etc/apt/sources.list /etc/apt/sources.list.d 2>/dev/null | head -1 || true)
	debootstrap --variant=minbase --include=python3,python3-venv,python3-pip,ca-certificates "$VERSION_CODENAME" "$ROOT" $MIRROR >$WORK/base.log
	cp /etc/ssl/certs/ca-certificates.crt "$ROOT/etc/ssl/certs/"
	printf '[global]\ncert = /etc/ssl/certs/ca-certificates.crt\n' >"$ROOT/etc/pip.conf"
	rm -rf "$ROOT"/var/cache/apt/archives/*.deb
	tar -C "$ROOT" -c . | docker import - faultline-base >/dev/null
	rm -rf "$ROOT"
fi
sed 's/^host = .*/host = "localhost"\nport = 21883/' service/vehicle/mqtt.toml >$WORK/mqtt.toml
export MQTT_CONFIG=./$WORK/mqtt.toml MQTT_PORT=21883 LISTEN=127.0.0.1:28080
"${COMPOSE[@]}" build --build-arg BASE=faultline-base >$WORK/build.log 2>&1
FAULT=$FAULT "${COMPOSE[@]}" up --detach >>$WORK/compose.log 2>&1
BEGIN=$SECONDS FOUND=""
while [ $((SECONDS - BEGIN)) -lt $WITHIN_S ] && [ -z "$FOUND" ]; do
	sleep 2
	FOUND=$("${COMPOSE[@]}" logs --no-color watch 2>/dev/null | grep -A6 "FAULT" | grep -m1 "$FAULT" || true)
done
[ -n "$FOUND" ] || { echo "campaign-compose: no fault was told within $WITHIN_S s" >&2; "${COMPOSE[@]}" logs >&2; exit 1; }
# The other two subscribers: the page says the same, and the broker holds the fault.
fetch() { python3 -c 'import sys, urllib.request as u; print(u.urlopen(u.Request(f"http://{sys.argv[1]}", headers={"Host": "localhost"}), timeout=10).read().decode())' "$1"; }
fetch $LISTEN/ | grep -q '<title>faultline</title>'
PAGE=$(fetch $LISTEN/v1/components/uds/faults | python3 -c 'import json, sys; print(json.load(sys.stdin)["items"][0]["fault_name"])')
RETAINED=$("${COMPOSE[@]}" logs --no-color mqtt 2>/dev/null | grep -c "connected, as" || true)
resident() { awk '/VmRSS/ {print int($2 / 1024)}' "/proc/$(docker inspect --format '{{.State.Pid}}' "$("${COMPOSE[@]}" ps -q "$1")")/status"; }
size() { docker image inspect --format '{{.Size}}' "$1" | awk '{print int($1 / 1000000)}'; }
{
	echo "# Containers"
	echo
	echo "\`make campaign-compose\` at $(git rev-parse --short HEAD), $(uname -m), $(nproc) cores, engine $(docker version --format '{{.Server.Version}}'), base: Debian's packages."
	echo "The images were built from this checkout, \`docker-compose.yml\` brought up as it is. The truck is simulated."
	echo
	echo "| | |"
	echo "|---|---|"
	echo "| image of the service, of which the base | $(size faultline) MB, $(size faultline-base) MB |"
	echo "| image of the simulated truck | $(size faultline-rig) MB |"
	echo "| resident memory of the service | $(resident service) MB |"
	echo "| and of the page's server, of MQTT's | $(resident page) MB, $(resident mqtt) MB |"
	echo "| the page says | $PAGE |"
	echo "| connections of \`faultline mqtt\` to the broker | $RETAINED |"
	echo "| fault injected 60 s after the truck's start, told to the subscriber | $((SECONDS - BEGIN)) s after the containers' start |"
	echo
	echo "What the subscriber printed:"
	echo
	echo '```'
	"${COMPOSE[@]}" logs --no-color watch 2>/dev/null | sed -n 's/^watch_1 *| //p'
	echo '```'
} >docs/results/compose.md
echo "$FOUND; wrote docs/results/compose.md"
