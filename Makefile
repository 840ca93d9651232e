# A fresh machine needs Python 3.11 or newer and make; everything else is installed into .venv. Tested with 3.11 to 3.13,
# which are taken first; newer ones need a JAX with wheels for them.
# A command may be there and still not run (version managers), or lack venv: only those that pass are taken.
SUITABLE := import sys, venv, ensurepip; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 15))
NAMES := python3.11 python3.12 python3.13 python3.14 python3.15 python3
PYTHONS := $(foreach p,$(NAMES),$(shell $(p) -c '$(SUITABLE)' >/dev/null 2>&1 && echo $(p)))
# The newest takes the newest JAX; `python3` stands last and is used where no numbered name is there.
NEWEST := $(firstword $(filter python3.13,$(PYTHONS)) $(filter python3.12,$(PYTHONS)) $(PYTHONS))
OLDEST := $(firstword $(PYTHONS))
PYTHON ?= $(NEWEST)
# pyenv's stand-ins run only for the versions that it is told to use; the matrix takes the newest there is.
PYENV := $(wildcard $(HOME)/.pyenv/versions/3.13.*/bin/python)
MATRIX_NEWEST ?= $(firstword $(filter python3.15,$(PYTHONS)) $(filter python3.14,$(PYTHONS)) $(filter python3.13,$(PYTHONS)) $(PYENV) $(NEWEST))
BIN := .venv/bin

# Measured free-swing traces are not part of the project; tests that need them say so where the folder is missing.
export DROPPER_MEASURED_DATA ?= $(abspath $(wildcard ../shared/data/measured))
# Bytecode is kept even where the machine says otherwise: tests start 60 processes.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: demo test check fuzz docs test-matrix package lint clean

demo: .venv/.installed
	$(BIN)/dropper demo --out demo

test: .venv/.installed-test
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder --durations=40 --durations-min=5

# What does not fit into `make test`, some five hours on two cores: the tests marked `check`, programs as users compile
# them, the whole catalogue of hard cases, many kinds of scene in one process, random calls,
# 2000 random scenes, 2000 damaged files. Each part runs alone too.
# Two processes at a time, outputs in build/check, a table at the end; CHECK="--only NAME" runs one part.
check: .venv/.installed-test
	$(BIN)/python tests/check.py $(CHECK)

fuzz: .venv/.installed-test
	FUZZ_EXAMPLES=2000 $(BIN)/python -m pytest tests/load/test_fuzz.py
	FUZZ_FILES=2000 $(BIN)/python -m pytest tests/faults/test_fuzz_files.py

# Source distribution and wheel in dist/, their metadata and contents looked at.
package: $(BIN)/python
	$(BIN)/python -m pip install --quiet --editable '.[package]'
	rm -rf build dist *.egg-info
	$(BIN)/python -m build --outdir dist
	$(BIN)/twine check --strict dist/*
	$(BIN)/check-wheel-contents dist/*.whl

# Generated pages anew, and all pages as a site in site/ that asks for no network.
docs: .venv/.installed-test
	$(BIN)/python docs/site/pages.py
	$(BIN)/mkdocs build --strict

# The oldest Python with the oldest JAX, the newest with the newest; MATRIX_TESTS="tests/axial -k rope" runs a sample.
test-matrix:
	$(call suite,$(OLDEST),.venv-oldest,jax==0.9.2 jaxlib==0.9.2)
	$(call suite,$(MATRIX_NEWEST),.venv-newest,jax)

define suite
	$(1) -m venv $(2)
	$(2)/bin/python -m pip install --quiet --upgrade --editable '.[test]' $(3)
	$(2)/bin/python -c "import jax, sys; print('Python', sys.version.split()[0], 'JAX', jax.__version__)"
	$(2)/bin/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder $(MATRIX_TESTS)
endef

lint: .venv/.installed-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports --no-cache
	$(BIN)/python tests/type_errors.py

$(BIN)/python:
	@test -n "$(PYTHON)" || { echo "no suitable python3 found; needed: Python 3.11 to 3.15 with venv"; exit 1; }
	$(PYTHON) -m venv .venv

# The stamps make a repeated `make test` start at once; a changed pyproject.toml installs again.
.venv/.installed: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --editable .
	@touch $@

.venv/.installed-test: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --editable '.[test]'
	@touch $@ .venv/.installed

clean:
	rm -rf .venv .venv-oldest .venv-newest demo build dist site
