# make run | test | test-full | docs | interop | experiments | evaluation | lint | clean. Everything is set up in .venv on first use.
PYTHON ?= python3
VENV := .venv
INTEROP := .venv-interop
BIN := $(VENV)/bin
RAW := benchmarks/raw
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet

.PHONY: run test docs test-full interop experiments evaluation lint docs-tables format clean

run: $(VENV)/.run
	$(BIN)/retune run pendulum
	$(BIN)/retune run quadrotor

test: $(VENV)/.test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/python -m pytest

test-full: $(VENV)/.test
	FUZZ_MUTANTS=400 $(BIN)/python -m pytest -m 'full and not slow'

interop: $(VENV)/.test $(INTEROP)/cofmupy/.installed $(INTEROP)/gemseo/.installed
	$(BIN)/python -m pytest -m interop

experiments: $(VENV)/.test
	$(BIN)/python -m pytest -m slow -n 0 -s

evaluation: $(VENV)/.test
	mkdir -p $(RAW) && rm -rf $(RAW)/figures
	$(BIN)/retune study benchmarks/studies/evaluation.toml --jobs 2 --out $(RAW)/evaluation
	$(BIN)/retune study benchmarks/studies/late.toml --jobs 2 --out $(RAW)/late
	$(BIN)/retune study benchmarks/studies/paper.toml --jobs 2 --out $(RAW)/paper
	$(BIN)/python -m benchmarks.frozen quadrotor --at 5.0 --window 10 --stride 5 --evaluations 30 --seeds 20 \
		--estimators target least-squares closed-form bo-scalar --out $(RAW)/frozen-quadrotor.json
	$(BIN)/python -m benchmarks.frozen stiction --at 4.0 --window 100 --evaluations 30 45 60 120 --seeds 20 \
		--estimators target least-squares multi-start bo-scalar --out $(RAW)/frozen-stiction.json
	$(BIN)/python -m benchmarks.frozen rigid-body --at 2.6 --window 10 --stride 5 --evaluations 30 45 60 100 --seeds 20 \
		--estimators target least-squares multi-start bo-scalar --out $(RAW)/frozen-rigid-body.json
	$(BIN)/retune figures --jobs 1 --out $(RAW)/figures
	$(BIN)/python -m benchmarks.evaluation $(RAW)
	$(BIN)/retune study benchmarks/studies/coverage.toml --out $(RAW)/coverage
	$(BIN)/python -m benchmarks.coverage $(RAW)/coverage --frozen pendulum quadrotor stiction rigid-body
	for name in guard guard-filtered guard-roll-outs; do \
		$(BIN)/retune study benchmarks/studies/$$name.toml --out $(RAW)/$$name || exit 1; done
	$(BIN)/python -m benchmarks.guard $(RAW)/guard $(RAW)/guard-filtered $(RAW)/guard-roll-outs \
		--commit $$(git rev-parse --short HEAD)

lint: $(VENV)/.test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

docs: $(VENV)/.test
	$(BIN)/python -m sphinx -W --keep-going -b html docs build/docs

docs-tables: $(VENV)/.run
	$(BIN)/python -m cosim.scenarios.reference docs/scenario.md docs/estimators.md
	$(BIN)/retune schema > docs/scenario.schema.json

format: $(VENV)/.test
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

$(VENV)/.python:
	@$(PYTHON) -c 'import sys; v = sys.version_info; sys.exit(0 if (3, 11) <= v < (3, 14) else "Python must be 3.11 to 3.13, got %d.%d; set PYTHON=/path/to/python3.12" % v[:2])'
	$(PYTHON) -m venv $(VENV)
	@touch $@

$(VENV)/.run: $(VENV)/.python pyproject.toml
	$(PIP) install --editable .
	@touch $@

$(VENV)/.test: $(VENV)/.python pyproject.toml
	$(PIP) install --editable '.[test]'
	@touch $(VENV)/.run $@

# Importers that pin what we do not: an environment each, 1 GB each.
$(INTEROP)/cofmupy/.installed: PACKAGE := cofmupy==1.0.0
$(INTEROP)/gemseo/.installed: PACKAGE := gemseo-fmu==3.1.1
$(INTEROP)/%/.installed: $(VENV)/.python
	$(PYTHON) -m venv $(INTEROP)/$*
	$(INTEROP)/$*/bin/python -m pip --disable-pip-version-check --quiet install '$(PACKAGE)'
	@touch $@

clean:
	rm -rf $(VENV) $(INTEROP) build *.egg-info .pytest_cache .ruff_cache .hypothesis
