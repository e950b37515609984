PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
ORACLE := .venv-oracle

.PHONY: setup validate demo test test-all lint bench oracle study-contact study-equilibrium study-montecarlo study-estimators study-check \
  study-improve study-plan study-sequential study-atlas study-discover study-foreign study-verdict study-fuzz study-kill pictures constraints clean

validate: setup  ## set up, then the main job: simulate, identify, compare, verdict
	$(BIN)/tulip validate --out runs/validate-$$(date +%Y%m%d-%H%M%S)

demo: setup  ## a hidden effect: identified wrong, discovered, identified right, report and view (a minute or two)
	MUJOCO_GL=disable OPENBLAS_NUM_THREADS=1 $(BIN)/python -m examples.demo

setup: $(VENV)/.done  ## the environment alone, once

$(VENV)/.done: constraints.txt pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "Python 3.11 or later is needed, found $$($(PYTHON) --version)"; exit 2; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || \
	  { echo "Python's venv module is missing; on Debian: apt-get install python3-venv"; exit 2; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r constraints.txt
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	@touch $@

test: setup  ## the tests (some 8 minutes on two cores)
	$(BIN)/python -m pytest -q

test-all: setup  ## the tests that take ten seconds and more too
	$(BIN)/python -m pytest -q -m 'slow or not slow'

lint: setup
	$(BIN)/ruff check . && $(BIN)/ruff format --check . && $(BIN)/pyrefly check

bench: setup  ## ratios of times, in one run
	$(BIN)/python -m pytest -q -s tests/benchmarks -o addopts= --benchmark-only

# One BLAS thread: with more, products of small matrices wait for each other on a busy machine.
oracle: export OPENBLAS_NUM_THREADS = 1
oracle: $(ORACLE)/.done  ## ask Pinocchio and FIGAROH anew (2 GB), compare, time against FIGAROH
	$(ORACLE)/bin/python -W ignore::RuntimeWarning -m studies.ask_oracles
	$(ORACLE)/bin/python -m pytest -q tests/test_oracle.py
	$(ORACLE)/bin/python -m pytest -q -s tests/benchmarks/test_figaroh.py -o addopts= --benchmark-only

$(ORACLE)/.done: constraints.txt pyproject.toml
	$(PYTHON) -m venv $(ORACLE)
	$(ORACLE)/bin/python -m pip install --quiet --disable-pip-version-check --require-hashes -r constraints.txt
	$(ORACLE)/bin/python -m pip install --quiet --disable-pip-version-check --no-build-isolation -e '.[oracle]'
	@touch $@

study-contact: setup  ## docs/contact-study.md's table: contact and gate settings against accuracy
	$(BIN)/python -m studies.study_contact

study-sequential: setup  ## docs/planning.md's table: ten postures chosen next against ten random ones
	$(BIN)/python -m studies.study_sequential

study-fuzz: setup  ## docs/reliability.md's table: 1,000 broken folders, 200 broken robots
	$(BIN)/python -m studies.study_fuzz

study-kill: setup  ## docs/reliability.md's table: fifty kills while writing and before
	$(BIN)/python -m studies.study_kill

study-equilibrium: setup  ## docs/equilibrium.md's tables: statics against the full dynamics
	$(BIN)/python -m studies.study_equilibrium

study-montecarlo: setup  ## docs/calibration.md's tables: calibration, wrong data sheets, statics beside dynamics
	$(BIN)/python -m studies.study_montecarlo

study-estimators: setup  ## docs/estimators.md's table: is each estimator right about its own errors?
	$(BIN)/python -m studies.study_estimators

study-improve: setup  ## docs/improve.md's tables and figures: the paper's ways to improve (some seventeen minutes of one core)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m studies.study_improve

study-atlas: setup  ## docs/atlas.md's table: from which angle on two effects are told apart (some minutes of one core)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m studies.study_atlas

study-foreign: setup  ## docs/discovery-benchmark.md's table of data from outside (a quarter of an hour)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m studies.study_foreign

study-verdict: setup  ## docs/verdict.md's tables: how often the verdict fails a true laboratory (an hour of one core)
	$(BIN)/python -m studies.study_verdict

study-discover: setup  ## docs/discovery-benchmark.md's tables: the honest test of `tulip discover` (hours)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m studies.study_discover

study-check: setup  ## docs/check.md's tables: false alarms and planted faults of `tulip check`
	$(BIN)/python -m studies.study_check

study-plan: setup  ## docs/planning.md's Table I: six trials of optimal postures
	$(BIN)/tulip plan --table1 --out runs/plan-$$(date +%Y%m%d-%H%M%S)

pictures: setup  ## the README's pictures (needs libosmesa6, mesa-vulkan-drivers, chromium)
	MUJOCO_GL=disable OPENBLAS_NUM_THREADS=1 $(BIN)/python -m studies.pictures

constraints: setup  ## pin the dependencies anew
	$(BIN)/python -m pip install --quiet uv
	$(BIN)/uv pip compile pyproject.toml --extra dev --universal --generate-hashes --no-header \
	  --python-version 3.11 -o constraints.txt

clean:
	rm -rf $(VENV) $(ORACLE) build *.egg-info
