# Everything runs in .venv, which these targets make from nothing but python3 (3.11 or newer).
# `make demo` and `make test` on a fresh machine are the two commands the README promises.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
# Two workers, each on its own share of the cores (tests/conftest.py), and no thread pools beside XLA's. Neighbours in
# a file stay with one worker, which has compiled their programs.
WORKERS ?= 2
PYTEST := $(BIN)/pytest -n $(WORKERS) --dist worksteal
export OMP_NUM_THREADS ?= 1
# Tests start many processes, and each would compile the package's modules again.
unexport PYTHONDONTWRITEBYTECODE

WHEEL := dist/.tried

.PHONY: help demo test test-all quick-tests all-tests lint wheel format refusals drawn bench docs clean
.DEFAULT_GOAL := help

help: ## Say what each target does
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-10s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

$(STAMP): requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { \
	  echo "odaf needs Python 3.11 or newer; '$(PYTHON)' is $$($(PYTHON) --version 2>/dev/null || echo missing)." >&2; \
	  echo "Name another interpreter, for example: make $(MAKECMDGOALS) PYTHON=python3.12" >&2; exit 1; }
	@test -x $(BIN)/python || { echo "Making $(VENV) ..."; $(PYTHON) -m venv $(VENV); }
	@echo "Installing the versions named in requirements.lock (a few minutes the first time) ..."
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements.lock
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	@touch $@

demo: $(STAMP) ## Learn to stitch a maze from poor demonstrations; ends with runs/demo/report.html
	$(BIN)/odaf demo --out runs/demo

lint: $(STAMP) ## Check style and types, change nothing
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

wheel: $(WHEEL) ## Build the wheel into dist/, install it into an empty environment and train from there

$(WHEEL): $(STAMP) tools/wheel.py README.md LICENSE $(shell find src/odaf -type f -not -name '*.pyc')
	$(BIN)/python -m tools.wheel dist
	@touch $@

# The checks run one after another beside the tests, in what these leave of the cores. What a check says is shown in one
# piece when it ends, and what the tests say at once: they write past make, to the output as it was before.
BESIDE := $(MAKE) --no-print-directory -j2 --keep-going $(if $(filter output-sync,$(.FEATURES)),--output-sync=target)
CHECKS := wheel lint docs
OUTPUT ?= 1

test: $(STAMP) ## Check style, types, wheel, documentation, import direction and behaviour
	@exec 9>&1; $(BESIDE) quick-tests $(CHECKS) OUTPUT=9

test-all: $(STAMP) ## The same, with the slow tests
	@exec 9>&1; $(BESIDE) all-tests $(CHECKS) OUTPUT=9

quick-tests: $(STAMP)
	$(PYTEST) -m "not slow" >&$(OUTPUT)

all-tests: $(STAMP)
	$(PYTEST) >&$(OUTPUT)

format: $(STAMP) ## Rewrite files in the house style
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

refusals: $(STAMP) ## Write the page of all refusals and their remedies from the code
	$(BIN)/python -m tools.refusals

drawn: $(STAMP) ## Put what the ledgers say now into the pages that have parts drawn by studies
	$(BIN)/python -m tools.drawn

bench: $(STAMP) ## Time the parts that matter; prints one figure a line
	$(BIN)/python -m benchmarks

docs: $(STAMP) ## Build the documentation into site/; every page opens from disk, without a network
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet
	$(BIN)/python -m tools.offline site

clean: ## Remove what commands produced; keeps results/ and .venv
	rm -rf build dist site runs .pytest_cache .ruff_cache .hypothesis .cache
	find src tests -name __pycache__ -type d -prune -exec rm -rf {} +
