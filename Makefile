# `make demo` and `make test` are all a newcomer needs; each sets up what it needs in .venv.
PYTHON ?= python3
# Where nothing may be kept, each process of the tests compiles every file and rewrites every assertion again: 15 s each.
unexport PYTHONDONTWRITEBYTECODE
BIN := .venv/bin
VEHICLE := .venv-vehicle/bin

CAMPAIGNS := $(addprefix campaign-, recordings discrepancy ablations training diagnosis stories false-alarms rivals \
	endurance mutation compose alarms clients power screenshots emps logs proposals experiments families time-constants ladder \
	undeclared dirty clairvoyant transfer scarce one-drive aarch64 fleet)
.PHONY: demo test check lint bench clean $(CAMPAIGNS)
test check $(CAMPAIGNS): export OPENBLAS_NUM_THREADS := 1  # two or three processes share the two cores

demo: .venv/.demo  ## the main job, end to end, with a picture
	@$(BIN)/faultline demo

# A file's tests stay in one process, as they share what is made for them, and the costliest file begins first. Those of
# the service run with the vehicle's libraries alone, beside the others, as they mostly wait; what they print comes at the
# end. What must not share the machine comes after, by itself.
WORKERS ?= 3
WAITING ?= 4
SERVICE_TESTS := out/test-service.txt
TOGETHER := -m "not alone and not long" --dist loadfile --no-loadscope-reorder --durations 20 --durations-min 8
test: lint .venv-vehicle/.done  ## everything that CI checks
	@bash tests/broker.sh
	@bash tests/browser.sh
	@mkdir -p out
	@$(VEHICLE)/python -m pytest $(TOGETHER) -n $(WAITING) tests/service > $(SERVICE_TESTS) 2>&1 & service=$$!; \
	$(BIN)/python -m pytest $(TOGETHER) -n $(WORKERS) --ignore tests/service; code=$$?; \
	wait $$service || code=1; cat $(SERVICE_TESTS); exit $$code
	@$(BIN)/python -m pytest -m alone

ALL ?=
check: .venv/.test  ## what the changes since its last success reach, in a minute; ALL=1: all but slow tests, in three
	@$(BIN)/python tests/check.py $(if $(ALL),--all)

lint: .venv/.test
	@$(BIN)/ruff check
	@$(BIN)/ruff format --check --quiet
	@$(BIN)/mypy
	@$(BIN)/lint-imports

bench: .venv/.test .venv-peer/.done  ## cost of a tick, of logs and of structural analysis, paired with what it is compared to
	@$(BIN)/python -m tests.bench
	@$(BIN)/python -m tests.bench_logs
	@$(BIN)/python tests/analysis/structure/bench_engine.py .venv-peer/bin/python
	@$(BIN)/python tests/analysis/structure/bench_command.py

campaign-recordings: .venv/.test  ## hours of rig time: are clocks and parameters found? writes docs/results
	@$(BIN)/python tests/campaigns/synchronisation.py --out docs/results/synchronisation.md
	@$(BIN)/python tests/campaigns/calibration.py --out docs/results/calibration.md

# In parts if wanted: SHARD=1/4 ...; set A is for development. Results so far are in docs/results/*.jsonl.
SET ?= B
campaign-discrepancy: .venv/.test  ## hours: hidden effects found, named, added? writes docs/results
	@$(BIN)/python tests/campaigns/discrepancy.py --set $(SET)

campaign-proposals: .venv/.test  ## hours: effects in no library, is the right formula proposed? writes docs/results
	@$(BIN)/python tests/campaigns/proposals.py

campaign-experiments: .venv/.test  ## two hours: several names for an effect, does the experiment tell? writes docs/results
	@$(BIN)/python tests/campaigns/experiments.py

campaign-ablations: .venv/.test .venv-peer/.done  ## the same without its parts, and pysindy; writes docs/results
	@$(BIN)/python tests/campaigns/discrepancy_ablations.py

# In parts if wanted: SHARD=1/4 ...; EFFECTS=B once, after a commit that says so.
campaign-diagnosis: .venv/.test  ## faults on other vehicles: detected, named? an hour or more; writes docs/results
	@$(BIN)/python tests/campaigns/diagnosis.py

campaign-ladder: .venv/.test  ## faults from small to total failure on eight vehicles; two hours; writes docs/results
	@$(BIN)/python tests/campaigns/ladder.py

campaign-undeclared: .venv/.test  ## faults that no model declares on six vehicles; half an hour; writes docs/results
	@$(BIN)/python tests/campaigns/undeclared.py

campaign-clairvoyant: .venv/.test  ## is the limit one, beside who knows fault, onset and size? half an hour; writes docs/results
	@$(BIN)/python tests/campaigns/clairvoyant.py

campaign-loops: .venv/.test  ## networks from structure alone where nothing is dynamic, ten loops; ten minutes; writes docs/results
	@$(BIN)/python tests/campaigns/loops.py

campaign-transfer: .venv/.test  ## networks of the bench on ten trucks, adapted to 2, 5 and 10 minutes; an hour; writes docs/results
	@$(BIN)/python tests/campaigns/transfer.py

campaign-one-drive: .venv/.test  ## a vehicle tuned with one drive and a fleet, ten trucks; two hours; writes docs/results
	@$(BIN)/python tests/campaigns/one_drive.py

campaign-aarch64: .venv/.test  ## the golden bundle on an emulated ARM processor; fetches 150 MB, minutes; writes docs/results
	@$(BIN)/python tests/campaigns/aarch64.py

campaign-fleet: .venv/.test  ## 1,000 vehicles made and diagnosed in shards; hours; writes docs/results
	@$(BIN)/python tests/campaigns/fleet_at_size.py

campaign-scarce: .venv/.test  ## equations and networks from 2, 5 and 20 minutes, four trucks; two hours; writes docs/results
	@$(BIN)/python tests/campaigns/scarce.py

campaign-dirty: .venv/.test  ## samples that are off, in drives with and without a fault; half an hour; writes docs/results
	@$(BIN)/python tests/campaigns/dirty.py

# Hours of each vehicle; sessions add to what is there.
HOURS ?= 25
campaign-false-alarms: .venv/.test  ## fault-free driving of those vehicles, a minute of computing for an hour
	@HOURS=$(HOURS) $(BIN)/python tests/campaigns/false_alarms.py

campaign-rivals: .venv/.test  ## other methods on the recordings of campaign-diagnosis, whose residuals are in out
	@$(BIN)/python tests/campaigns/rivals.py

campaign-endurance: .venv/.test  ## 25 hours of log time and 10 million mutated frames; writes docs/results
	@$(BIN)/python tests/campaigns/endurance.py

campaign-alarms: .venv/.test  ## 200 kills at random instants: is every alarm told to everybody? writes docs/results
	@$(BIN)/python tests/campaigns/alarms.py

campaign-clients: .venv/.test  ## HTTP clients that are slow, hostile or vanish; writes docs/results
	@$(BIN)/python tests/campaigns/clients.py

campaign-power: .venv/.test  ## 20 power cuts of a guest while alarms are told, as root; writes docs/results
	@$(BIN)/python tests/campaigns/power.py

campaign-families: .venv/.test  ## two hours: plants of other structures, in which nothing is missing; writes docs/results
	@$(BIN)/python tests/campaigns/families.py

campaign-hybrid: .venv/.test  ## four hours: networks as a diagnosis system, beside the equations; writes docs/results
	@$(BIN)/python tests/campaigns/hybrid.py

campaign-emps: .venv/.test  ## a real linear drive at 200 Hz, EMPS=the folder of its two files; writes docs/results
	@$(BIN)/python tests/campaigns/emps.py $(EMPS)

campaign-logs: .venv/.test  ## formats, damage, cost and memory of reading logs; writes docs/results
	@$(BIN)/python tests/campaigns/logs.py

campaign-screenshots: .venv/.test  ## pictures of the page in a real browser; writes docs
	@bash tests/browser.sh
	@$(BIN)/python tests/campaigns/screenshots.py docs

campaign-compose:  ## images built and brought up in a container engine, as root; writes docs/results
	@bash tests/campaigns/compose.sh

campaign-mutation: .venv/.test .venv-mutation/.done  ## which changes of the code no test notices; writes docs/results
	@$(BIN)/python tests/campaigns/mutation.py

campaign-stories: .venv/.test  ## all stories of docs/: do their commands print what the pages say?
	@$(BIN)/python -m pytest tests/thread/test_stories.py

campaign-time-constants: .venv/.test  ## ten minutes: how often intervals hold a drift's time constant; writes docs/results
	@$(BIN)/python tests/campaigns/time_constants.py

campaign-training: .venv/.test  ## networks beside the calibrated equations; writes docs/results
	@$(BIN)/python tests/campaigns/grey_box.py
	@$(BIN)/python tests/campaigns/effort.py

clean:
	rm -rf .venv .venv-vehicle .venv-peer .venv-mutation out build *.egg-info

.venv/bin/pip:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
		|| { echo "faultline needs Python 3.11 or newer; name one: make PYTHON=python3.12 ..."; exit 1; }
	@$(PYTHON) -m venv .venv \
		|| { rm -rf .venv; echo "faultline needs venv and pip: apt-get install python3-venv python3-pip"; exit 1; }

# One stamp for what the demo needs, one for what the tests need besides.
.venv/.demo: .venv/bin/pip pyproject.toml constraints.txt
	@echo "setting up .venv (vehicle, web and design libraries, a minute)"
	@$(BIN)/pip install --quiet --constraint constraints.txt --editable '.[design,web]'
	@touch $@

.venv/.test: .venv/bin/pip pyproject.toml constraints.txt
	@echo "setting up .venv (design and training libraries and test tools, two minutes)"
	@$(BIN)/pip install --quiet --constraint constraints.txt --editable '.[design,train,dev]'
	@touch .venv/.demo $@

# What the vehicle has, and a test runner: no scipy, sympy, networkx, onnx, matplotlib, rich or torch.
ABSENT := scipy sympy networkx onnx matplotlib rich torch starlette
.venv-vehicle/.done: .venv/bin/pip pyproject.toml constraints.txt
	@echo "setting up .venv-vehicle (the vehicle's libraries, half a minute)"
	@$(PYTHON) -m venv .venv-vehicle
	@$(VEHICLE)/pip install --quiet --constraint constraints.txt --editable . pytest pytest-xdist hypothesis
	@$(VEHICLE)/python -c 'import sys, importlib.util as u; found = [*filter(u.find_spec, sys.argv[1:])]; sys.exit(f"the vehicle has {found}" if found else 0)' $(ABSENT)
	@touch $@

# The peer tool has an environment of its own: it may crash, and wants libraries that are none of ours.
PEER := tests/analysis/structure/peer-requirements.txt
.venv-peer/.done: $(PEER)
	@echo "setting up .venv-peer (the Fault Diagnosis Toolbox and pysindy, a minute)"
	@$(PYTHON) -m venv .venv-peer
	@.venv-peer/bin/pip install --quiet --requirement $(PEER)
	@touch $@

# mutmut runs in a copy of the repository, with the vehicle's libraries and what the core's tests need.
MUTATION := tests/campaigns/mutation-requirements.txt
.venv-mutation/.done: $(MUTATION) constraints.txt pyproject.toml
	@echo "setting up .venv-mutation (mutmut, half a minute)"
	@$(PYTHON) -m venv .venv-mutation
	@.venv-mutation/bin/pip install --quiet --constraint constraints.txt --requirement $(MUTATION) . pytest hypothesis
	@.venv-mutation/bin/pip uninstall --quiet --yes faultline-diagnosis
	@touch $@
