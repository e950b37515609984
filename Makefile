PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
ORACLE := .venv-oracle

# Tests that draw are skipped where that is not possible; with DRAW=always they fail there.
DRAW ?= possible
# More than four processes repeat too much.
SHARED := --numprocesses auto --maxprocesses 4 --dist worksteal --durations 10 --draw $(DRAW)
STUDIES := $(subst _,-,$(patsubst studies/study_%.py,study-%,$(wildcard studies/study_*.py)))

.PHONY: setup validate demo test test-slow test-all test-without-drivers durations test-docs lint docs bench oracle studies $(STUDIES) teaching pictures constraints clean

validate: setup  ## set up, then the main job: simulate, identify, compare, verdict
	$(BIN)/tulip validate --out runs/validate-$$(date +%Y%m%d-%H%M%S)

demo: setup  ## a hidden effect: identified wrong, discovered, identified right, report and view (a minute or two)
	MUJOCO_GL=disable $(BIN)/python -m examples.demo

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

test: setup  ## the tests (some four minutes on two cores)
	$(BIN)/python -m pytest -q $(SHARED)

test-slow: setup  ## the slow tests alone
	$(BIN)/python -m pytest -q $(SHARED) -m slow

test-all: test test-slow  ## all tests (below forty minutes on two cores)

test-without-drivers: setup  ## the tests that draw, with every driver and browser out of reach: all are skipped
	$(BIN)/python -m pytest -q -rs -m draws --draw never

durations: setup  ## record the processor time of every test of `make test` (tests/durations.csv)
	$(BIN)/python -m pytest -q $(SHARED) -p tests.durations

test-docs: setup  ## every command of the tutorials, compared with what the page shows (three minutes)
	$(BIN)/python -m pytest -q tests/test_docs.py -m slow

lint: setup
	$(BIN)/ruff check . && $(BIN)/ruff format --check . && $(BIN)/pyrefly check && $(BIN)/python -m tests.plain_english

docs: setup  ## the documentation as a site: site/index.html
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict  # --quiet would hide warnings from --strict too

bench: setup  ## times and memory of commands against their rows, as ratios in one run
	$(BIN)/python -m studies size --size 0.25

# One BLAS thread: Pinocchio and FIGAROH call linear algebra without the library's own limit
# (base/threads.py); with more, products of small matrices wait for each other on a busy machine.
oracle: export OPENBLAS_NUM_THREADS = 1
oracle: $(ORACLE)/.done  ## ask Pinocchio and FIGAROH again (2 GB) and compare
	$(ORACLE)/bin/python -W ignore::RuntimeWarning -m tests.ask_oracles
	$(ORACLE)/bin/python -m pytest -q tests/test_base_parameters.py

$(ORACLE)/.done: constraints.txt pyproject.toml
	$(PYTHON) -m venv $(ORACLE)
	$(ORACLE)/bin/python -m pip install --quiet --disable-pip-version-check --require-hashes -r constraints.txt
	$(ORACLE)/bin/python -m pip install --quiet --disable-pip-version-check --no-build-isolation -e '.[oracle]'
	@touch $@

studies: setup  ## list the studies, each with the page that it is for and its time
	@$(BIN)/python -m studies --help

$(STUDIES): study-%: setup  ## make the tables of one study (`make studies` lists them)
	$(BIN)/python -m studies $*

teaching: setup  ## docs/pictures: the signatures of all effects (a minute)
	MUJOCO_GL=disable $(BIN)/python -m studies.teaching

pictures: teaching  ## the README's pictures too (needs libosmesa6, mesa-vulkan-drivers, chromium)
	MUJOCO_GL=disable $(BIN)/python -m studies.pictures
	if [ "$$TULIP_ICUB_YOGA" ]; then MUJOCO_GL=disable $(BIN)/python -m studies.real_robots; fi

constraints: setup  ## pin the dependencies anew
	$(BIN)/python -m pip install --quiet uv
	$(BIN)/uv pip compile pyproject.toml --extra dev --universal --no-strip-extras --generate-hashes --no-header \
	  --python-version 3.11 -o constraints.txt

clean:
	rm -rf $(VENV) $(ORACLE) build *.egg-info
