# Every target sets up what it needs: system packages (.ci/system-packages) and a virtual environment in .venv with the
# package installed for editing. Python files take effect as they are; a change in the C++ core is compiled on the next
# call; a change in pyproject.toml installs again. `make PYTHON=python3.12 test` picks the interpreter of a new .venv.
PYTHON ?= python3
VENV := .venv
BIN := $(CURDIR)/$(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet
# An installation for editing knows the modules that there were: it is made again when there are others.
MODULES := $(shell find pmc_sampler adapters eval scenes -name '*.py' | sort | cksum | cut -d ' ' -f 1)
BUILT := $(VENV)/.built-$(MODULES)
CORE := $(wildcard pmc_sampler/core/* adapters/opencl/core/*)
DEMO_ARGS ?= -o demo/
BENCH_ARGS ?= -o benchmarks/
SUITE_ARGS ?= quick -o results/quick
PYTEST_ARGS ?=
FUZZ_SECONDS ?= 600
FUZZ_ARGS ?=

.PHONY: demo test test-long browser sanitize coverage fuzz bench lint types setup system-packages clean
.DEFAULT_GOAL := test

demo: setup
	$(BIN)/python examples/demo.py $(DEMO_ARGS)

# `pytest`, not `python -m pytest`: the latter would put the checkout on sys.path.
test: setup
	$(BIN)/pytest --numprocesses auto --maxprocesses 4 --dist loadfile $(PYTEST_ARGS)

test-long: setup
	$(BIN)/pytest -m long $(PYTEST_ARGS)

sanitize: setup
	.ci/sanitize

coverage: setup
	$(BIN)/pytest --cov $(PYTEST_ARGS)

# The report in Chromium (apt install chromium).
browser: setup
	$(BIN)/pytest -m long tests/eval/test_report_browser.py $(PYTEST_ARGS)

# Each reader of files for FUZZ_SECONDS, in its turn; `make FUZZ_ARGS="gltf image" fuzz` picks some.
fuzz: setup
	$(PIP) install --group fuzz
	$(BIN)/python tests/fuzz/fuzz.py $(FUZZ_SECONDS) $(FUZZ_ARGS)

bench: setup
	$(BIN)/pmc-sampler bench $(SUITE_ARGS)
	$(BIN)/pmc-sampler bench benchmarks/gains.toml -o results/gains
	sed 's|results/gains/suite.toml -o results/gains|benchmarks/gains.toml -o DIR|' results/gains/results.md > benchmarks/gains.md
	$(BIN)/python benchmarks/overhead.py $(BENCH_ARGS)
	$(BIN)/python benchmarks/mitsuba_throughput.py $(BENCH_ARGS)
	$(BIN)/python benchmarks/opencl.py $(BENCH_ARGS)

lint: setup
	$(BIN)/pre-commit run --all-files
	$(MAKE) --no-print-directory types

# mypy does not follow editable installs: it checks an installed copy, from a folder without sources.
types: setup
	@rm -rf build/types && mkdir -p build/types/empty
	$(PIP) install --no-deps --no-build-isolation --target build/types/installed .
	cd build/types/empty && MYPYPATH=../installed $(BIN)/mypy --config-file ../../../pyproject.toml -p pmc_sampler

clean:
	rm -rf $(VENV) build dist demo .pytest_cache .mypy_cache .ruff_cache .hypothesis .coverage htmlcov
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

setup: $(BUILT)

system-packages:
	@PYTHON=$(PYTHON) .ci/system-packages

$(VENV)/.created: | system-packages
	@echo "Setting up $(VENV); this takes a few minutes the first time."
	$(PYTHON) -m venv --clear $(VENV)
	$(PIP) install --upgrade 'pip>=25.1'
	@touch $@

# Without isolation the build folder stays valid, so that a rebuild compiles only what changed.
$(VENV)/.installed: pyproject.toml $(VENV)/.created
	$(PIP) install --group build
	$(PIP) install --no-build-isolation --editable '.[dev]'
	@touch $@

$(BUILT): $(VENV)/.installed CMakeLists.txt $(CORE)
	$(PIP) install --no-deps --no-build-isolation --editable .
	@rm -f $(VENV)/.built-*
	@touch $@
