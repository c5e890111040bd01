# Two commands set up everything: `make run` and `make test`.

PYTHON ?= $(shell for p in python3.12 python3.11 python3.13 python3 python; do \
	$$p -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' 2>/dev/null && echo $$p && break; done)
BIN := .venv/bin

.PHONY: run test lines wire others browser mutants check claims docs format bench recordings soak-test fuzz swarm lerobot franka lock diagrams clean

run: .venv/run.stamp            ## the main job on the mock bench: 126 approaches, from nothing to a report
	$(BIN)/python run.py run papers/table_1

SAFETY := $(addprefix tests/unit/controller/test_,$(addsuffix .py,arrivals guard loop loop_together stop_all)) \
	$(addprefix tests/unit/drivers/,arm test_axis_limits.py barrett_hand can_gripper gripper robotiq sensor_board/test_sensor_board_driver.py ur_arm zaber_stage)

test: export PYTHONDONTWRITEBYTECODE :=
test: .venv/dev.stamp browser   ## the tests; what they need is compiled before; guard, limits, loop and stop paths: every line
	$(BIN)/python -m config.precompile
	$(MAKE) -s -j3 lines wire others

PARALLEL := -n 2 --dist loadscope --no-loadscope-reorder --durations=15

wire: .venv/dev.stamp           # beside the others: tests on the wire wait half of their time
	$(BIN)/python -m pytest $(PARALLEL) tests/wire

others: .venv/dev.stamp         # each worker imports all tests that it may get: none needs what the wire's import
	$(BIN)/python -m pytest $(PARALLEL) --ignore=tests/wire $(SAFETY:%=--ignore=%)

lines: .venv/dev.stamp          ## the unit tests of guard, limits, loop and stop paths, which leave no line of these out
	@mkdir -p build
	$(BIN)/python -m coverage run -m pytest $(SAFETY) >build/lines.log 2>&1 || { cat build/lines.log; exit 1; }
	@tail -1 build/lines.log
	$(BIN)/python -m coverage report

browser:                        ## the report is tested in one
	@for b in chromium chromium-browser google-chrome; do command -v $$b && exit; done >/dev/null; { test "$$(id -u)" = 0 && apt-get update -qq && \
		DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends chromium >/dev/null; } \
		|| { echo "the report is tested in a browser: install chromium (apt-get install chromium)"; exit 2; }

mutants: .venv/dev.stamp        ## what small changes the unit tests let pass: guard, loop, stop paths, codecs; goes on where it was
	@test -f mutants/mutmut-stats.json || rm -rf mutants  # what was interrupted before the first mutant is made anew
	nice -n 15 $(BIN)/python -P -m mutmut run
	$(BIN)/python -P -m mutmut results

swarm: .venv/dev.stamp          ## a thousand short campaigns in which things go wrong; which cells were seen goes to benchmarks/results/swarm.md
	nice -n 15 $(BIN)/python run.py swarm --seeds $(or $(SEEDS),0:1000) --table benchmarks/results/swarm.md

docs: .venv/dev.stamp           ## the documentation as a searchable site in build/site; a link that leads nowhere is an error
	rm -rf build/pages && mkdir -p build/pages
	find *.md docs benchmarks simulator \( -name '*.md' -o -name '*.svg' -o -name '*.png' \) -exec cp --parents -t build/pages {} +
	$(BIN)/zensical build --strict >build/docs.log 2>&1 || { cat build/docs.log; exit 1; }
	@echo "to search it: $(BIN)/python -m http.server -b 127.0.0.1 -d build/site, then open http://127.0.0.1:8000"

claims: .venv/dev.stamp         ## every figure of README and results, from stored results and from runs of the papers: minutes
	rm -rf build/claims
	$(BIN)/python -m tests.claims

check: .venv/dev.stamp docs     ## format, lint, types, import layers, links, stored figures; about a minute the first time, then seconds
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m tests.claims --stored
	@! ls */*.py | cut -d/ -f1 | sort -u | grep -vxE 'touchbench|benchmarks|config|simulator|controller|behaviors|drivers|tests|mutants|examples' \
		|| { echo "a new package: give it a place in the layers in pyproject.toml, and here"; exit 1; }

format: .venv/dev.stamp         ## put code into its format
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

bench: .venv/dev.stamp          ## run time against error, the loop's cost, the stop's latency: into benchmarks/
	$(BIN)/python -m pytest benchmarks
	$(BIN)/python -m benchmarks

recordings: .venv/dev.stamp     ## public recordings with truth, by git, into build/recordings: slip on real signals
	$(BIN)/python -m benchmarks.recordings $(FROM)

soak-test: .venv/dev.stamp      ## the swarm's plans on emulated benches, then a run with faults: hours; into benchmarks/results
	$(BIN)/python -m benchmarks.wire_plans 0:100 --minutes 120
	$(BIN)/python -m benchmarks.wire_plans --soak 20

FUZZ_SECONDS ?= 600
fuzz: .venv/dev.stamp           ## bytes of all kinds into every decoder, FUZZ_SECONDS each; findings stay in build/fuzz
	$(BIN)/python -m tests.fuzz --seconds $(FUZZ_SECONDS)

lerobot: .venv/dev.stamp         ## exported runs, loaded by LeRobot itself: some 7 GB into build/lerobot
	test -x build/lerobot/bin/python || $(PYTHON) -m venv build/lerobot
	build/lerobot/bin/python -m pip install --quiet --disable-pip-version-check -r requirements/lerobot.in
	$(BIN)/python -m tests.lerobot_reads build/lerobot/bin/python

franka: .venv/dev.stamp         ## the Franka arm's driver on franka-sim, a twin that others wrote: a minute, best on a quiet machine
	test -x build/franka/bin/python || $(PYTHON) -m venv build/franka
	build/franka/bin/python -m pip install --quiet --disable-pip-version-check -r requirements/franka.in
	$(BIN)/python -m tests.franka_moves build/franka/bin/python

diagrams: .venv/run.stamp       ## the state diagrams in docs/, from the behaviors' own tables
	$(BIN)/python -m config.diagrams

.venv/run.stamp: requirements/run.txt
	@test -n "$(PYTHON)" || { echo "touchbench needs Python 3.11 to 3.13: install one, or say make PYTHON=/path/to/python3.12"; exit 2; }
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements/run.txt
	touch $@

.venv/dev.stamp: .venv/run.stamp requirements/dev.txt
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements/dev.txt
	touch $@

COMPILE = uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-annotate --no-header
lock:                           ## new pins from pyproject.toml and requirements/dev.in (needs uv)
	$(COMPILE) --extra ur --extra can --extra sound -o requirements/run.txt pyproject.toml
	$(COMPILE) --all-extras -c requirements/run.txt -o requirements/dev.txt pyproject.toml requirements/dev.in

clean:                          ## all that was made here, runs excepted
	rm -rf .venv .mypy_cache .ruff_cache build mutants
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
