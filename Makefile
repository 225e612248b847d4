# corridor-fusion: `make run` and `make test` need Python 3.11 or later and make, nothing else.
# Everything lives in .venv; nothing is installed outside the folder.

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:

VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
PYTHON ?=
# pytest-xdist: each worker gets whole files, so that module fixtures are built once; an idle worker steals tests.
PYTEST_FLAGS ?= -n 2 --dist worksteal
EXTRA ?= dev
CONSTRAINTS ?=
# Some containers forbid byte code. Each of the many processes that the tests start would compile all libraries then.
unexport PYTHONDONTWRITEBYTECODE
# Tests of code that depends on other libraries' behaviour.
LOWEST_TESTS := tests/test_cli.py tests/fusion/test_log_ulog.py tests/fusion/test_log_tlog.py \
	tests/fusion/test_log_dataflash.py tests/fusion/test_log_rosbag.py tests/fusion/test_video.py \
	tests/fusion/test_exports.py tests/fusion/test_report.py tests/fusion/test_config_file.py \
	tests/vision/test_calibration.py tests/vision/test_images.py tests/test_imports.py

help:  ## show this list
	@sed -n 's/^\([a-z]*\):.*## */\1 /p' $(MAKEFILE_LIST) | while read -r name what; do printf '  make %-8s %s\n' "$$name" "$$what"; done

run: $(STAMP)  ## fuse the sample flight in data/office and print how well it went
	@$(BIN)/corridor fuse data/office --config data/office.toml -o out/office

test: $(STAMP)  ## run all tests
	@$(BIN)/python -m pytest $(PYTEST_FLAGS)

lowest:  ## run the tests of what other libraries do with the lowest versions that pyproject.toml allows
	@$(MAKE) --no-print-directory setup VENV=.venv-lowest EXTRA=test CONSTRAINTS=.ci/lowest.py
	@NUMBA_CACHE_DIR=$(CURDIR)/.venv-lowest/numba .venv-lowest/bin/python -m pytest $(PYTEST_FLAGS) $(LOWEST_TESTS)

lint: $(STAMP)  ## ruff: rules and format; import-linter: who may import whom
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/lint-imports --no-logo --no-cache

types: $(STAMP)  ## mypy, strict
	@$(BIN)/mypy

docs: $(STAMP)  ## build the documentation into out/site; warnings are errors
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet
	@echo "open out/site/index.html"

notebook: $(STAMP)  ## open the notebooks in JupyterLab
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[notebook]' >&2
	@$(BIN)/jupyter lab notebooks

release: $(STAMP)  ## build wheel and sdist into dist and check them
	@rm -rf dist
	@$(BIN)/python -m build --outdir dist >/dev/null
	@$(BIN)/twine check --strict dist/*

bench: $(STAMP)  ## print the benchmarks' tables
	@for script in benchmarks/*.py; do echo "== $$script"; $(BIN)/python "$$script"; done

hooks: $(STAMP)  ## install the git hooks (lint and types before each commit)
	@$(BIN)/pre-commit install

setup: $(STAMP)  ## only set up .venv

clean:  ## remove .venv, caches and outputs
	rm -rf $(VENV) .venv-lowest out build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis .benchmarks
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# One shell script on purpose: find a Python, make the environment, install, and only then stamp it. Byte code is
# left to the first import: most of what the libraries bring is never imported.
$(STAMP): pyproject.toml
	@set -eu; python=""; \
	for candidate in $(or $(PYTHON),python3.14 python3.13 python3.12 python3.11 python3 python); do \
	  if "$$candidate" -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then \
	    python="$$candidate"; break; \
	  fi; \
	done; \
	if [ -z "$$python" ]; then \
	  found="$$($(or $(PYTHON),python3) --version 2>/dev/null || echo none)"; \
	  echo "error: Python 3.11 or later with its venv module is needed (found: $$found); install it or name it: make PYTHON=/path/to/python3" >&2; \
	  exit 1; \
	fi; \
	echo "Setting up $(VENV) with $$("$$python" --version) (once, takes a minute or two) ..." >&2; \
	$(BIN)/python -c pass 2>/dev/null || "$$python" -m venv --clear $(VENV); \
	constraint=""; \
	if [ -n "$(CONSTRAINTS)" ]; then \
	  $(BIN)/python $(CONSTRAINTS) >$(VENV)/constraints.txt; constraint="-c $(VENV)/constraints.txt"; \
	fi; \
	$(BIN)/python -m pip install --no-compile --quiet --disable-pip-version-check $$constraint --editable '.[$(EXTRA)]' >&2; \
	touch $(STAMP)

.PHONY: help run test lowest lint types docs notebook release bench hooks setup clean
