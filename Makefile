# Needs only make and Python 3.11 or newer with venv. `make` alone lists the targets.

PYTHON ?= python3
BIN = .venv/bin
ARGS =
OUT = paper-results
WORKERS = 2
# -qq silences pip's chatter; errors are still shown.
INSTALL = $(BIN)/python -m pip install -qq --disable-pip-version-check --editable

export MPLBACKEND = Agg

.DEFAULT_GOAL := help
.PHONY: help paper test slow deep cluster dask mutations lint format types doctest docs bench dist first-hour clean

help: ## list the targets
	@echo 'Usage: make TARGET [ARGS="..."] [PYTHON=python3.12]'
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  %-12s%s\n", $$1, $$2 }' Makefile

paper: .venv/core.stamp ## the paper's figures and verdicts, into paper-results/ (ARGS="--seeds 5")
	$(BIN)/curricle paper --out "$(OUT)" $(ARGS)

test: .venv/test.stamp ## the fast tests (ARGS="-k pursuit")
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadfile $(ARGS)

slow: .venv/test.stamp ## the statistical and long tests
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadfile -m slow --timeout 3600 $(ARGS)
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadfile tests/property --hypothesis-profile explore --timeout 3600

deep: .venv/deep.stamp ## the tests and examples of deep learners (installs torch)
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadfile tests/deep $(ARGS)
	$(BIN)/python -m pytest --doctest-modules --doctest-glob '*.md' src/curricle/deep docs/howto/your_own_network.md

cluster: .venv/cluster.stamp ## the tests of Dask, Ray and S3 (installs them)
	$(BIN)/python -m pytest -n0 tests/cluster $(ARGS)

dask: .venv/dask.stamp ## the shortest tests of Dask alone (installs it)
	$(BIN)/python -m pytest -n0 tests/cluster/test_dask.py -k changes_nothing $(ARGS)

mutations: .venv/deep.stamp ## make mistakes in a copy; the tests must catch each (installs torch; ARGS="lock")
	$(BIN)/python tests/mutations.py --jobs $(WORKERS) $(ARGS)

lint: .venv/dev.stamp ## ruff: rules and layout
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

format: .venv/dev.stamp ## let ruff fix what it can
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

types: .venv/dev.stamp ## mypy, strict
	$(BIN)/mypy

doctest: .venv/dev.stamp ## every example in src/, docs/ and README.md
	$(BIN)/python -m pytest -n $(WORKERS) --doctest-modules --doctest-glob '*.md' src/curricle README.md $(wildcard docs) $(ARGS)

docs: .venv/dev.stamp ## the documentation, into docs/_build (open index.html there)
	rm -rf docs/_build docs/api/generated docs/api/*.rst
	$(BIN)/python -m sphinx -W --keep-going -q docs docs/_build
	$(BIN)/python -m pytest -n0 -m slow tests/site

bench: .venv/test.stamp ## time every benchmarks/bench_*.py
	@set -e; for script in $(sort $(wildcard benchmarks/bench_*.py)); do \
	  echo "$$script"; $(BIN)/python $$script $(ARGS); done

dist: .venv/dist.stamp ## build sdist and wheel into dist/, and try the wheel alone on every Python here
	$(BIN)/python tests/release.py $(ARGS)

first-hour: ## README and tutorial word for word, timed, in fresh clones with an empty HOME
	tests/first_hour.sh $(ARGS)

clean: ## remove .venv, caches and builds (results stay)
	rm -rf .venv build dist docs/_build docs/api/generated docs/api/*.rst .pytest_cache .ruff_cache .mypy_cache .hypothesis
	find src tests -type d -name __pycache__ -prune -exec rm -rf {} +

# Each stamp says that .venv holds that much: the library, then its test tools, then all tools.
.venv/core.stamp: pyproject.toml src/curricle/__init__.py
	@$(PYTHON) -c 'import sys; sys.version_info >= (3, 11) or sys.exit("Curricle needs Python 3.11 or newer, and $(PYTHON) is %d.%d: name a newer one, as in make PYTHON=python3.12." % sys.version_info[:2])'
	@echo 'Installing into .venv ...'
	@$(PYTHON) -m venv .venv
	@$(INSTALL) .
	@touch $@

.venv/test.stamp: .venv/core.stamp
	@$(INSTALL) '.[test]'
	@touch $@

.venv/dev.stamp: .venv/test.stamp
	@$(INSTALL) '.[dev]'
	@touch $@

.venv/deep.stamp: .venv/test.stamp
	@$(INSTALL) '.[deep]'
	@touch $@

.venv/dask.stamp: .venv/test.stamp
	@$(INSTALL) '.[dask]'
	@touch $@

.venv/cluster.stamp: .venv/test.stamp
	@$(INSTALL) '.[dask,url]' 'ray>=2.40' s3fs 'moto[server]>=5'
	@touch $@

.venv/dist.stamp: .venv/test.stamp
	@$(BIN)/python -m pip install -qq --disable-pip-version-check 'build>=1.2' 'twine>=6' 'check-wheel-contents>=0.6'
	@touch $@
