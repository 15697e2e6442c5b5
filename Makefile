# make quickstart   finds a walker on rough ground, from a fresh clone, in minutes
# make compare      runs the paper's first experiment: stores, all samplers, figures; resumes where it was stopped
# make results      runs every experiment of the documents, on both engines; takes hours; resumes where it was stopped
# make test         runs all tests, and prints the slowest
# make test-fast    leaves out the tests marked `slow`: for daily work
# make test-campaign   runs the longest tests: 2,000 damaged inputs, dozens of kills
# make fuzz CASES=20000 SEED=7   gives every command damaged input of every format; keeps failures in out/fuzz
# make docs         builds the site, out/site/index.html: runs the notebooks, needs no network
# make dist         builds the distributions of a release into out/dist, the same bytes each time, and checks them
# make lint         checks style and types, as CI does
# make hooks        lets git run the lint before every commit
# Needs Python 3.11 to 3.14 and make; everything else goes into .venv.

PYTHON ?= python3
BIN := .venv/bin
PARALLEL := --numprocesses auto --dist loadfile
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile -c constraints.txt

.PHONY: quickstart compare sweep-limp sweep-exo sweep-speed results test test-fast test-campaign fuzz docs dist lint hooks store store-worlds store-stairs store-speed store-exo store-exo-hip store-exo-effort store-prosthesis

quickstart: .venv/installed
	$(BIN)/python tools/quickstart.py

STORES := store store-worlds
PAPER := rough8-smooth rough6-walking rough8-walking risers ramp-up ramp-up-gentle ramp-down stairs-down
STAIRS := stairs-up stairs-up-high
OUTSIDE := outside-bodies outside-weak outside-slippery outside-catches outside-gravel outside-limp outside-half-limp prosthesis prosthesis-known
SPEED := $(foreach speed,07 08 09 10 11 12 13 14 15 16 08-rough 12-rough 16-rough,speed-$(speed))
MUJOCO := $(foreach ground,level rough8 risers ramp-up ramp-down,$(foreach contact,soft middle hard,mujoco-$(ground)-$(contact)))

# Each store and each comparison has a target. `make compare-risers` first makes the stores that it needs. All targets resume.
$(STORES) store-stairs store-speed store-exo store-exo-hip store-exo-effort store-prosthesis: .venv/installed
	$(BIN)/python tools/precompute.py --config $@

compare-%: $(STORES)
	$(BIN)/python tools/compare.py --config $*

$(addprefix compare-,$(STAIRS)): store-stairs
$(addprefix compare-,$(SPEED)): store-speed
compare-exo: store-exo
compare-exo-hip: store-exo-hip
compare-exo-effort: store-exo-effort
compare-prosthesis-known: store-prosthesis

sweep-limp: $(STORES)
	$(BIN)/python tools/sweep.py --config outside-limp --over world.muscles.SOL_left=1:0:-0.1 --runs 10 --trials 30

sweep-exo: store-exo
	$(BIN)/python tools/sweep.py --config exo --over world.exoskeleton.power_w=10,25,50,100,200,400 --runs 10 --trials 15

sweep-speed: store-speed
	$(BIN)/python tools/sweep.py --config speed-12 --over objective.terms.mean_speed_mps.target=1,1.2,1.4 --runs 5 --trials 20

compare: $(STORES)
	$(BIN)/python tools/compare.py --config rough8-smooth
	$(BIN)/python tools/report.py out/compare/rough8-smooth

results: $(addprefix compare-,$(PAPER) $(STAIRS) $(OUTSIDE) $(MUJOCO) $(SPEED) exo exo-hip exo-effort) sweep-limp sweep-exo sweep-speed
	$(BIN)/python tools/report.py $(addprefix out/compare/,$(PAPER) $(STAIRS) $(OUTSIDE) $(MUJOCO) $(SPEED) exo exo-hip exo-effort) --out out/results

test: .venv/test-compiled
	$(BIN)/python -m pytest $(PARALLEL) --durations=25

test-fast: .venv/test-compiled
	$(BIN)/python -m pytest $(PARALLEL) -m "not slow and not campaign"

test-campaign: .venv/test-compiled
	$(BIN)/python -m pytest $(PARALLEL) -m campaign

CASES ?= 2000
SEED ?= 1
fuzz: .venv/test-installed
	$(BIN)/python -m tests.fuzz.campaign --cases $(CASES) --seed $(SEED)

# The variable hides a notice of the theme about its successor: the versions are pinned.
docs: .venv/docs-installed
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build

# Setuptools writes the time of the build into the archive of sources, which is therefore packed again.
dist: export SOURCE_DATE_EPOCH = $(shell git log -1 --format=%ct)
dist: .venv/dist-installed
	rm -rf out/dist build study/hub/build study/hub/*.egg-info
	$(BIN)/python -m build --outdir out/dist
	$(BIN)/python -m build --wheel --outdir out/dist study/hub
	cd out/dist && tar -xzf *.tar.gz && rm *.tar.gz && for name in */; do tar --sort=name --mtime=@$$SOURCE_DATE_EPOCH --owner=0 \
		--group=0 --numeric-owner -c $${name%/} | gzip -n > $${name%/}.tar.gz && rm -r $$name; done
	rm -rf build study/hub/build study/hub/*.egg-info
	$(BIN)/twine check --strict out/dist/*
	$(BIN)/check-wheel-contents out/dist

lint: .venv/lint-installed
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

hooks: .venv/lint-installed
	$(BIN)/pre-commit install

# Each set of packages has a stamp file. `make quickstart` installs the package and the explorer; it needs no packages of tests,
# documents or lint.
.venv/installed: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 15) and "error: Python 3.11 to 3.14 is needed: make PYTHON=python3.12")'
	$(PYTHON) -m venv .venv
	@echo "Installing the pinned packages into .venv (half a minute) ..."
	$(INSTALL) -e '.[explore]'
	@touch $@

.venv/test-installed: .venv/installed
	@echo "Installing what the tests need ..."
	$(INSTALL) -e '.[test]'
	@touch $@

# Tests start hundreds of processes. Each of them compiles all that it imports where PYTHONDONTWRITEBYTECODE is set, as in many
# containers: half of its time. So this is done once, for all commands and what they import later.
COMPILED := $(subst /,.,$(basename $(wildcard study/commands/*.py))) alembic.command bokeh.server.server cma distributed gymnasium \
	mujoco optuna.storages._rdb.models optuna_dashboard pandas playwright.sync_api psycopg ribs.emitters scipy.stats \
	sklearn.gaussian_process sqlalchemy.dialects.sqlite sqlalchemy.orm storage.search study.experiment.live_study taichi_nmm.simulator
.venv/test-compiled: .venv/test-installed
	PYTHONDONTWRITEBYTECODE= $(BIN)/python -c 'import sys; [*map(__import__, sys.argv[1:])]' $(COMPILED)
	@touch $@

.venv/docs-installed: .venv/installed
	$(INSTALL) -e '.[docs]'
	@touch $@

.venv/dist-installed: .venv/installed
	$(INSTALL) -e '.[dist]'
	@touch $@

.venv/lint-installed: .venv/installed
	$(INSTALL) -e '.[test,docs,dev]'
	@touch $@ .venv/test-installed .venv/docs-installed
