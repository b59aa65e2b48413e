# make run       install what is needed and fly a descent on the built-in loopback
# make test      install and run the checks and the quick tests: four minutes on two cores
# make test-all  the checks, the quick tests and the slow ones; CONTRIBUTING.md says what else there is
# make examples  the tests that draw their input, each time with other input
# make simulate-runtime SEEDS=500  runs in simulated time, each under one seed
# make fuzz      the decoders and the readers of files on bytes of a fuzzer
# make soak      the tests that take minutes each, an hour in real time, and eight hours accelerated
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PYTEST := $(BIN)/pytest -n auto --dist worksteal
# Bytecode is made of the modules that are imported: most of what is installed never is.
INSTALL := $(BIN)/pip install --quiet --disable-pip-version-check --no-compile --editable
# Without bytecode each of the hundreds of processes that tests start compiles all that it imports.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: run test test-all examples simulate-runtime soak adapters checks-and-kernels check style types imports budget kernels docs wheel performance integrations flight site basilisk lowest speckle left-out haze plume sigma published fit-coverage pictures mutants fuzz clean

run: $(VENV)/.ready
	@$(BIN)/lidar-emu run descent.yaml

test: checks-and-kernels
	$(PYTEST)

# Many of the slow tests wait for flights in real time: one process more than there are processors.
test-all: checks-and-kernels
	$(PYTEST) -n $$(($$(nproc) + 1)) -m 'not soak' --durations=50 --durations-min=10

# Compiling takes one processor for about a minute, the checks another for as long.
checks-and-kernels: $(VENV)/.ready-dev
	@$(MAKE) --no-print-directory --jobs=2 --output-sync=target check kernels

# The first lines state the seed that repeats it.
examples: checks-and-kernels
	$(PYTEST) -m 'hypothesis and not soak' --hypothesis-seed=$(shell date +%s)

# Runs under the seeds 0 to SEEDS - 1, or FIRST:END, in simulated time; what fails is shortened, and repeats by its seed.
SEEDS ?= 500
simulate-runtime: kernels
	@PYTHONPATH=tests/support $(BIN)/python -m simulated_runtime $(SEEDS)

soak: kernels
	$(BIN)/pytest -m soak
	$(BIN)/python tools/soak.py
	$(BIN)/python tools/soak.py --pace max --hours 8

# USB adapters that are unplugged, in a machine of QEMU with a Debian kernel: ten minutes.
adapters: $(VENV)/.ready-dev build/kernel
	tests/integration/adapters/machine $(BIN)/pytest -p no:cacheprovider tests/integration/adapters

build/kernel:
	mkdir -p build
	cd build && apt-get download $$(apt-cache depends linux-image-amd64 | awk '/Depends:/ {print $$2}')
	dpkg-deb -x build/linux-image-*.deb $@

check: style types imports budget

style: $(VENV)/.ready-dev
	$(BIN)/ruff check
	$(BIN)/ruff format --check

types: $(VENV)/.ready-dev
	$(BIN)/mypy

imports: $(VENV)/.ready-dev
	$(BIN)/lint-imports --no-logo

# Printed only: .ci/run fails over a limit.
budget: $(VENV)/.ready-dev
	@$(BIN)/python tools/budget.py || true

# Runs fill the cache of compiled kernels once, where the test workers would each fill it for themselves.
kernels: $(VENV)/.ready-dev
	@$(BIN)/lidar-emu run paper_fig4.yaml --pace max > /dev/null
	@$(BIN)/lidar-emu run powered_descent.yaml --duration 1 --pace max > /dev/null

# A wheel in dist/ with machine code for x86-64 processors of 2013 and later: two minutes, and a C compiler.
wheel: $(VENV)/.ready-dev
	$(BIN)/python tools/build_kernels.py build/kernels
	LIDAR_EMU_KERNELS=build/kernels $(BIN)/python -m build --wheel --no-isolation --outdir dist

# Everything in docs/ and in the protocol package that is generated from code and definitions.
docs: $(VENV)/.ready-dev
	$(BIN)/python tools/reference_page.py
	$(BIN)/python tools/columns_page.py > docs/columns.md
	$(BIN)/python tests/protocol/make_documents.py

# The tables of docs/evidence/performance.md: half an hour on an otherwise idle machine.
performance: wheel
	$(BIN)/python -m benchmarks.tables ratios starts growth

# One recorded descent, decoded by programs of others; each that is not installed is skipped with a word.
integrations: $(VENV)/.ready-integrations
	$(BIN)/pytest -m '' tests/interoperability

# A descent with the firmware of examples/flight_processor on an emulated processor.
PROCESSOR ?= cortex_m3
flight: $(VENV)/.ready
	@PATH="$(CURDIR)/$(BIN):$$PATH" $(BIN)/python examples/flight_processor/fly.py $(PROCESSOR)

# The documentation site in build/site, its notebooks executed: some minutes.
site: $(VENV)/.ready-site
	$(BIN)/python tools/build_site.py

$(VENV)/.ready-site: $(VENV)/.ready-dev
	$(INSTALL) '.[site]'
	@touch $@

$(VENV)/.ready-integrations: $(VENV)/.ready-dev
	$(INSTALL) '.[fprime,view,yamcs]'
	@touch $@

# The example with Basilisk, as its page prints it, in an environment of its own: 0.6 GB.
basilisk: $(VENV)-basilisk/.ready
	$(VENV)-basilisk/bin/pytest -m slow tests/integration/test_basilisk.py

$(VENV)-basilisk/.ready: pyproject.toml
	$(PYTHON) -m venv --clear $(VENV)-basilisk
	$(VENV)-basilisk/bin/pip install --quiet --disable-pip-version-check --no-compile --editable '.[basilisk]' hypothesis pytest
	@touch $@

# The packets of every shipped scenario, with the lowest versions of dependencies that pyproject.toml admits: three minutes.
lowest:
	$(PYTHON) -m venv --clear $(VENV)-lowest
	mkdir -p build
	sed -n -e '/^dependencies/,/^]/s/^ *"\(.*\)>=\([^"]*\)".*/\1==\2/p' \
	  -e 's/^compiler = \["\(.*\)>=\([^"]*\)"\].*/\1==\2/p' pyproject.toml > build/lowest.txt
	$(VENV)-lowest/bin/pip install --quiet --disable-pip-version-check --requirement build/lowest.txt --editable .
	NUMBA_CACHE_DIR=build/lowest-kernels $(VENV)-lowest/bin/python tools/scenario_bytes.py --packets

# The table of docs/evidence/accuracy.md on speckle and motion, from 20 m to 5 km, by Monte Carlo: fifty minutes.
speckle: $(VENV)/.ready-dev
	$(BIN)/python -m benchmarks.tables speckle

# Decoders and readers of files on bytes that a fuzzer guesses, guided by coverage: SECONDS for each, see tools/fuzz.py.
SECONDS ?= 60
fuzz: $(VENV)/.ready-dev
	$(BIN)/pip install --quiet --disable-pip-version-check 'atheris>=3'
	@for target in serial can command can_command truth trajectory points ply obj stl tab dsk interface scenario; do \
	  echo "fuzz $$target"; \
	  $(BIN)/python tools/fuzz.py $$target build/fuzz/$$target -max_total_time=$(SECONDS) -verbosity=0 || exit 1; \
	done

# The pictures of docs/ that commands make, or NAMES of them: ten minutes, with Chromium.
pictures: $(VENV)/.ready-dev
	$(INSTALL) '.[plots,sensitivity,tables,view]'
	$(BIN)/python tools/pictures.py $(NAMES)

# The table of docs/evidence/accuracy.md on what is left out, by Monte Carlo: ten minutes.
left-out: $(VENV)/.ready-dev
	$(BIN)/python -m benchmarks.tables "left out"

# The tables of docs/evidence/accuracy.md on the sigma that an instrument states, by Monte Carlo: twenty minutes.
sigma: $(VENV)/.ready-dev
	$(BIN)/python -m benchmarks.tables sigma looks

# The table of docs/evidence/published.md: a quarter of an hour. New Shepard's row needs LIDAR_EMU_REAL_DATA, the folder of its record.
published: $(VENV)/.ready-dev
	$(BIN)/python -m benchmarks.tables published

# The table of docs/evidence/fit-coverage.md: a minute.
fit-coverage: $(VENV)/.ready-dev
	$(BIN)/python -m benchmarks.fit_coverage

# The table of docs/evidence/accuracy.md on haze as a target, by Monte Carlo: ten minutes.
haze: $(VENV)/.ready-dev
	$(BIN)/python -m benchmarks.tables haze

# The table of docs/evidence/accuracy.md on dust of a plume, by Monte Carlo: three minutes.
plume: $(VENV)/.ready-dev
	$(BIN)/python -m benchmarks.tables plume

# The stamps are written last: an environment without one was left half made and is made again.
$(VENV)/.ready: pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "lidar-emu needs Python 3.11 or later; say which: make $(MAKECMDGOALS) PYTHON=python3.12" >&2; exit 2; }
	@test -e $@ || $(PYTHON) -m venv --clear $(VENV) || \
	  { rm -rf $(VENV); echo "No venv here; on Debian and Ubuntu: apt install python3-venv" >&2; exit 2; }
	$(INSTALL) '.[geo,pandas,plots,tables]'
	@touch $@

$(VENV)/.ready-dev: $(VENV)/.ready
	$(INSTALL) '.[dev]'
	@touch $@

# Which small faults in the core no test notices: two hours; verdicts in .mutants/verdicts.jsonl, results in docs/evidence/mutants.md.
mutants: $(VENV)/.ready-dev
	$(INSTALL) '.[mutants]'
	$(BIN)/python tools/mutants.py map
	$(BIN)/python tools/mutants.py run

clean:
	rm -rf $(VENV) $(VENV)-basilisk build dist
