#!/usr/bin/env bash
# Makes the golden files anew from the demo's bundle (run `make demo` first). A commit that changes them says why each
# event moved.
set -euo pipefail
cd "$(dirname "$0")/../.."
here=tests/golden
rm -rf "$here"/bundle "$here"/log "$here"/bench
cp -r out/demo/bundle "$here"/bundle
.venv/bin/faultline rig record --id golden --cycle validation --seed 8 --duration 127 --fault fA_du --size 0.65 \
	--onset 70 --out "$here"/bench --truth "$here"/bench-truth
.venv/bin/faultline ingest "$here"/bench/golden --out "$here"/logs
mv "$here"/logs/golden "$here"/log
mv "$here"/bench-truth/golden.toml "$here"/truth.toml
rm -rf "$here"/logs "$here"/bench "$here"/bench-truth "$here"/log/{uniform.csv,synchronisation.png}
.venv/bin/faultline diagnose "$here"/log --bundle "$here"/bundle --json >"$here"/events.jsonl || test $? = 1
