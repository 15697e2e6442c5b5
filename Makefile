# make quickstart   a walker found on rough ground, from a fresh clone, in minutes
# make compare      the paper's first experiment: stores, all samplers, figures; resumes where it was stopped
# make results      every experiment of the documents, on both engines; hours; resumes where it was stopped
# make test         all tests, and which took longest
# make test-fast    those that take no long: for daily work
# make test-campaign   2,000 damaged inputs, dozens of kills: what takes long and has kin in `make test`
# make fuzz CASES=20000 SEED=7   damaged input of every format to every command; failures go to out/fuzz
# make docs         the site, out/site/index.html: runs the notebooks, needs no network
# make lint         style and types, as CI checks them
# make hooks        run the lint before every commit
# Needs Python 3.11 to 3.13 and make; everything else goes into .venv.

PYTHON ?= python3
BIN := .venv/bin
PARALLEL := --numprocesses auto --dist loadfile
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt

.PHONY: quickstart compare results test test-fast test-campaign fuzz docs lint hooks store store-diverse store-worlds store-torso store-stairs

quickstart: .venv/installed
	$(BIN)/python tools/quickstart.py

STORES := store store-diverse store-worlds
PAPER := rough8-smooth rough6-walking rough8-walking risers $(foreach way,up down,ramp-$(way) ramp-$(way)-gentle) stairs-down
STAIRS := stairs-up stairs-up-high stairs-up-short
TORSO := $(foreach way,up down,ramp-$(way)-torso stairs-$(way)-torso)
OUTSIDE := outside-bodies outside-weak outside-slippery
MUJOCO := $(foreach ground,level rough8 risers ramp-up ramp-down,$(foreach contact,soft middle hard,mujoco-$(ground)-$(contact)))

# One target a store and a comparison: `make compare-risers` makes what it needs; all go on where they were stopped.
$(STORES) store-torso store-stairs: .venv/installed
	$(BIN)/python tools/precompute.py --config $@

compare-%: $(STORES)
	$(BIN)/python tools/compare.py --config $* --no-artifacts

$(addprefix compare-,$(TORSO)): store-torso
$(addprefix compare-,$(STAIRS)): store-stairs

compare: $(STORES)
	$(BIN)/python tools/compare.py --config rough8-smooth
	$(BIN)/python tools/report.py out/compare/rough8-smooth

results: $(addprefix compare-,$(PAPER) $(STAIRS) $(TORSO) $(OUTSIDE) $(MUJOCO))
	$(BIN)/python tools/report.py $(addprefix out/compare/,$(PAPER) $(STAIRS) $(TORSO) $(OUTSIDE) $(MUJOCO)) --out out/results

test: .venv/test-installed
	$(BIN)/python -m pytest $(PARALLEL) --durations=25

test-fast: .venv/test-installed
	$(BIN)/python -m pytest $(PARALLEL) -m "not slow and not campaign"

test-campaign: .venv/test-installed
	$(BIN)/python -m pytest $(PARALLEL) -m campaign

CASES ?= 2000
SEED ?= 1
fuzz: .venv/test-installed
	$(BIN)/python -m tests.fuzz.campaign --cases $(CASES) --seed $(SEED)

# Without the theme's notice of its successor: the versions are pinned.
docs: .venv/docs-installed
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build

lint: .venv/lint-installed
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

hooks: .venv/lint-installed
	$(BIN)/pre-commit install

# A stamp for each set of packages: `make quickstart` installs the package and the explorer, which it ends by naming; no test,
# document or lint packages.
.venv/installed: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 14) and "error: Python 3.11 to 3.13 is needed: make PYTHON=python3.12")'
	$(PYTHON) -m venv .venv
	@echo "Installing the pinned packages into .venv (half a minute) ..."
	$(INSTALL) -e '.[explore]'
	@touch $@

.venv/test-installed: .venv/installed
	@echo "Installing what the tests need ..."
	$(INSTALL) -e '.[test]'
	@touch $@

.venv/docs-installed: .venv/installed
	$(INSTALL) -e '.[docs]'
	@touch $@

.venv/lint-installed: .venv/installed
	$(INSTALL) -e '.[test,docs,dev]'
	@touch $@ .venv/test-installed .venv/docs-installed
