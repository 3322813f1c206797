# coflight: `make swarm` flies, `make test` tests; each does all of its own set-up.
# interpreter of the environment; none: python3.11
PYTHON ?=
VENV := .venv
BIN := $(VENV)/bin
ENVIRONMENT := $(VENV)/.python
STAMP := $(VENV)/.set-up
DEV := $(VENV)/.set-up-dev
VIEW := $(VENV)/.set-up-view
CLIENTS := $(VENV)/.set-up-clients
DOCS := $(VENV)/.set-up-docs
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check
LOCKED := $(PIP) --require-hashes --requirement
ARGS ?=
# each process would compile every module again
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help setup swarm view wheel test test-clients validate validate-radio validate-antenna codesign campaign article antenna bench bench-radio ns3-references docs lock lint format clean
help:
	@echo "make swarm [ARGS='--duration 20 --seed 3']   fly scenarios/article.toml"
	@echo "make view  [ARGS='--duration 20']            the same flight in the viewer Rerun (docs/how-to/view.md)"
	@echo "make test  [ARGS='-k radio']                 run the tests"
	@echo "make test-clients                            MAVSDK and MAVProxy fly swarms at the clock's pace (docs/how-to/ground-control.md)"
	@echo "make validate [ARGS='--quick | --out docs/results']   measure how well one vehicle flies (docs/results/validation.md)"
	@echo "make validate-radio [ARGS='--quick | --out docs/results']   compare the radio with ns-3 (docs/results/radio-validation.md)"
	@echo "make validate-antenna [ARGS='--quick | --out docs/results']   hold the antenna's solvers against each other (docs/results/antenna-validation.md)"
	@echo "make codesign [ARGS='--quick | --out docs/results']   measure what ranging does for the formation (docs/concepts/ranging-and-localisation.md)"
	@echo "make article [ARGS='--quick | --out docs/results']    fly the article's cases and judge its statements (docs/results/article.md)"
	@echo "make campaign ARGS='CAMPAIGN.toml --out DIR'  many flights, one table (docs/how-to/campaigns.md)"
	@echo "make antenna ARGS='pattern --wavelength 10'   the antenna alone: pattern, statistics, benchmark (docs/concepts/antenna.md)"
	@echo "make bench [ARGS='--quick | --agents 8 --json']   measure what flying costs (docs/results/performance.md)"
	@echo "make bench-radio [ARGS='--peer COMMAND']      measure what the radio costs"
	@echo "make ns3-references [ARGS='--only ns3_range']   make the tables of ns-3 again, needs libns3-dev (studies/ns3/README.md)"
	@echo "make docs                                    build the documentation site into build/site"
	@echo "make wheel                                   build the wheel, install it elsewhere, fly with it, test the examples"
	@echo "make lock [ARGS=--upgrade]                   write the lock files with the hashes of all packages"
	@echo "make setup [PYTHON=/path/to/python3.11]      make the environment .venv; the targets above do it too"
	@echo "make lint | format | clean"

setup: $(DEV)

# looks at the interpreters each time, and writes the file only if the environment is new
$(ENVIRONMENT): ALWAYS
	@sh scripts/make_environment.sh $(VENV) '$(PYTHON)'
ALWAYS:

$(STAMP): pyproject.toml requirements.lock $(ENVIRONMENT)
	$(LOCKED) requirements.lock
	$(PIP) --no-deps --no-build-isolation --editable '.[nec2,env]'
	@touch $@

$(DEV): requirements-dev.lock $(STAMP)
	$(LOCKED) requirements-dev.lock --no-deps
	@touch $@

swarm: $(STAMP)
	$(BIN)/coflight fly article $(ARGS)

$(VIEW): requirements-view.lock $(STAMP)
	$(LOCKED) requirements-view.lock --no-deps
	@touch $@

view: $(VIEW)
	$(BIN)/coflight fly article --view $(ARGS)

# builds the wheel, installs it into a new environment, flies and tests the examples outside the checkout
wheel: $(DEV)
	$(BIN)/python scripts/try_wheel.py

test: $(DEV) $(VIEW)
	$(BIN)/python -m pytest -n auto --maxprocesses 4 --dist loadfile --no-loadscope-reorder $(ARGS)

$(CLIENTS): requirements-clients.lock $(DEV)
	$(LOCKED) requirements-clients.lock --no-deps
	@touch $@

# one after the other, as each keeps pace with the wall clock; in all no longer than this
CLIENTS_LIMIT_S := 900
test-clients: $(CLIENTS)
	COFLIGHT_CLIENTS=required $(BIN)/python -m pytest -m clients --session-timeout=$(CLIENTS_LIMIT_S) tests/clients $(ARGS)

validate: $(STAMP)
	$(BIN)/python scripts/validate_vehicle.py $(ARGS)

validate-radio: $(STAMP)
	$(BIN)/python scripts/validate_radio.py $(ARGS)

validate-antenna: $(STAMP)
	$(BIN)/python scripts/validate_antenna.py $(ARGS)

codesign: $(STAMP)
	$(BIN)/python scripts/experiment_codesign.py $(ARGS)

article: $(STAMP)
	$(BIN)/python scripts/reproduce_article.py $(ARGS)

campaign: $(STAMP)
	$(BIN)/python scripts/campaign.py $(ARGS)

antenna: $(STAMP)
	$(BIN)/python scripts/antenna_lab.py $(ARGS)

bench: $(STAMP)
	$(BIN)/python scripts/bench.py $(ARGS)

bench-radio: $(STAMP)
	$(BIN)/python scripts/bench_radio.py $(ARGS)

# built outside of the source tree; ends with CMake's message if libns3-dev is absent
ns3-references: $(STAMP)
	cmake -S studies/ns3 -B build/ns3
	cmake --build build/ns3
	$(BIN)/python scripts/ns3_references.py $(ARGS)

$(DOCS): requirements-docs.lock $(STAMP)
	$(LOCKED) requirements-docs.lock --no-deps
	@touch $@

docs: $(DOCS)
	$(BIN)/python scripts/write_reference.py --check
	$(BIN)/mkdocs build --strict

lock: $(ENVIRONMENT)
	$(BIN)/python scripts/refresh_locks.py $(ARGS)

# paths that are checked for words kept for people; none: all
PLAIN :=
lint: $(DEV) $(VIEW)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python scripts/lint_prose.py $(PLAIN)

format: $(DEV)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean:
	rm -rf $(VENV) .mypy_cache .pytest_cache .ruff_cache .import_linter_cache build *.egg-info
