# Everything lives in .venv; `make demo` and `make test` need only Python 3.11+, git and make.
VENV := .venv
PYTHON ?= $(firstword $(foreach p,python3.11 python3 python3.12 python3.13,$(if $(shell $(p) -c 'import sys, venv, ensurepip; sys.exit(not (3, 11) <= sys.version_info < (3, 14))' 2>/dev/null && echo yes),$(p))))
BIN := $(VENV)/bin

.PHONY: setup setup-dev demo test check benchmark benchmark-quick lock clean

setup: $(VENV)/.runtime

setup-dev: $(VENV)/.dev

$(VENV)/.runtime: requirements.lock pyproject.toml
	@test -n "$(PYTHON)" || { echo "queuetail needs Python 3.11 or newer with venv and pip; none was found on the PATH"; exit 2; }
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --editable .
	@touch $@

$(VENV)/.dev: $(VENV)/.runtime requirements-dev.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-dev.lock
	@touch $@

demo: setup
	$(BIN)/queuetail run examples/flagger/flight.mp4 --telemetry examples/flagger/telemetry.csv \
	    --site examples/flagger/site.toml --out out/demo

test: setup-dev
	$(BIN)/python -m pytest --numprocesses 2 --dist loadfile

check: setup-dev
	$(BIN)/ruff check . && $(BIN)/ruff format --check . && $(BIN)/mypy

# Every scenario × every variant; goes on where it stopped, and rewrites the tables of docs/benchmarks.md.
benchmark: setup-dev
	$(BIN)/python benchmarks/suite.py --doc docs/benchmarks.md

# Four scenarios, under 10 minutes on two cores; prints its tables.
benchmark-quick: setup-dev
	$(BIN)/python benchmarks/suite.py --quick --no-speed --variants road paper

# Refresh the pinned versions; needs uv.
lock:
	uv pip compile --quiet --universal --generate-hashes --no-header --no-emit-index-url --python-version 3.11 --extra live --extra console --extra signs --extra evaluate pyproject.toml -o requirements.lock
	uv pip compile --quiet --universal --generate-hashes --no-header --no-emit-index-url --python-version 3.11 --all-extras --group dev pyproject.toml -c requirements.lock -o requirements-dev.lock

clean:
	rm -rf $(VENV) out
