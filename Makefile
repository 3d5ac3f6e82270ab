# The front door. Needs python3 (3.11 to 3.13), make and git; everything else goes into .venv.
#   make demo    one press, slide and twist: a bundle and a picture of it in out/
#   make data    every recipe's data set in data/, WORKERS scenes at a time; run again, it goes on
#   make sample  a small data set to publish, with card, splits and scores, in out/sample, WORKERS scenes at a time
#   make test    the tests
#   make torture hostile files and kills, half an hour on two cores: what became of them, into docs/RESULTS.md
#   make docs    the documentation site in out/site
#   make release wheel and sdist in dist, and the wheel tried in an empty environment
#   make gallery docs/gallery.md: every shape, movement and sensor, WORKERS scenes at a time, three hours on one core
#   make bench   error against run time, stability, cost: docs/RESULTS.md, in some 20 minutes; BENCH_FLAGS=--full for more

SUITABLE = import sys, venv, ensurepip; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))
CANDIDATES = python3 python3.13 python3.12 python3.11 python
PYTHON ?= $(shell for p in $(CANDIDATES); do $$p -c '$(SUITABLE)' >/dev/null 2>&1 && { echo $$p; break; }; done)
BIN = .venv/bin
# worksteal: a file stays with one worker, which solves its fixtures once; at most 8, each of which imports all tests
PYTEST_FLAGS ?= -n auto --maxprocesses 8 --dist worksteal
TESTS ?= tests

# one thread per process: sums are added in one order, and two test processes do not fight over cores
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1
export MKL_NUM_THREADS ?= 1
# every process that a test starts would compile what it imports
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help sync check test test-slow smoke torture bench docs release gallery demo data sample clean

help:
	@echo "make demo | data | sample | test | docs | release | gallery | check | test-slow | smoke | torture | bench | sync | clean"

sync: .venv/synced

.venv/synced: pyproject.toml
	@test -x $(BIN)/python || { p="$(PYTHON)"; test -n "$$p" && $$p -c '$(SUITABLE)' 2>/dev/null; } || { \
	  echo "tacgen needs Python 3.11, 3.12 or 3.13 with its venv module (Debian, Ubuntu: apt install python3-venv)."; \
	  echo "Found: $$($(or $(PYTHON),python3) --version 2>&1). Choose another with: make $(MAKECMDGOALS) PYTHON=/path/to/python3.12"; \
	  exit 1; }
	@test -x $(BIN)/python || $(PYTHON) -m venv .venv
	@echo "installing tacgen and its tools into .venv (a few minutes the first time)"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[dev]"
	@touch $@

check: sync
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

test: sync
	$(BIN)/python -m pytest -m "not slow" $(PYTEST_FLAGS) $(TESTS)

test-slow: sync
	$(BIN)/python -m pytest -m slow $(PYTEST_FLAGS)

smoke: sync
	rm -rf out/smoke
	@for recipe in recipes/*.yaml; do \
	  name=$$(basename $$recipe .yaml); \
	  $(BIN)/tacgen run $$recipe -o out/smoke/$$name --set quality=draft --set vary=null && \
	  $(BIN)/tacgen check out/smoke/$$name || exit 1; \
	done

# datasets, recipes, meshes and tables spoilt in many ways, and processes killed
torture: sync
	PYTHONPATH=tests $(BIN)/python -W ignore -m benchmarks.torture -o docs $(TORTURE_FLAGS)

bench: sync
	$(BIN)/python -m benchmarks -o docs $(BENCH_FLAGS)
	$(BIN)/python -m benchmarks.figures

docs: sync
	@# not --quiet: with it --strict counts no warnings
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict
	@echo "the site: out/site/index.html"

release: sync
	scripts/try_wheel.sh $(BIN)/python

demo: sync
	$(BIN)/tacgen run recipes/quickstart.yaml -o out/quickstart
	$(BIN)/tacgen show out/quickstart/scene-00000.h5 -o out/quickstart.png --overwrite
	@echo "bundle:  out/quickstart/scene-00000.h5"
	@echo "picture: out/quickstart.png"

WORKERS ?= 1
DATA ?= data

# exit code 1 of run is rejected or failed scenes: the card and the report say which, and so does the gallery
gallery: sync
	@for sensor in sensors/*.yaml; do \
	  name=$$(basename $$sensor .yaml); \
	  $(BIN)/tacgen run docs/gallery/gallery.yaml -o out/gallery/$$name --set sensor=$$name --workers $(WORKERS) $(DATA_FLAGS) \
	    || [ $$? -eq 1 ] || exit 1; \
	done
	@for chosen in gelsight_mini:4096 digit:1024 ninedtact:144; do \
	  name=$${chosen%%:*}; \
	  $(BIN)/tacgen run recipes/traced_paths.yaml -o out/traced_paths/$$name --set sensor=$$name \
	    --set quality.spp=$${chosen##*:} --workers $(WORKERS) $(DATA_FLAGS) || exit 1; \
	done
	$(BIN)/python scripts/gallery.py out/gallery --paths out/traced_paths -o docs

data: sync
	@for recipe in recipes/*.yaml; do \
	  name=$$(basename $$recipe .yaml); \
	  $(BIN)/tacgen run $$recipe -o $(DATA)/$$name --workers $(WORKERS) $(DATA_FLAGS) || [ $$? -eq 1 ] || exit 1; \
	  $(BIN)/tacgen report $(DATA)/$$name || exit 1; \
	done

sample: sync
	$(BIN)/python scripts/sample.py -o out/sample --workers $(WORKERS) $(SAMPLE_FLAGS)

clean:
	rm -rf .venv build dist out .pytest_cache .mypy_cache .ruff_cache .hypothesis
