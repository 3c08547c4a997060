# Two commands are enough: `make demo` and `make test`. `make help` lists the others.
# Needs: python3 >= 3.11, make, and network access to a package index (as pip is configured).

PYTHON ?= python3
JOBS ?= auto
DEMO_ARGS ?=
# --compile: all modules at once; --no-compile: each when it is first imported
COMPILE ?= --compile
PYTEST_ARGS ?=
BITS_ARGS ?=
CLUSTER_PORT ?= 8786

# An environment that keeps Python from writing compiled modules would compile them for every process.
unexport PYTHONDONTWRITEBYTECODE

VENV := .venv
PY := $(VENV)/bin/python
PIP := $(PY) -m pip --quiet --disable-pip-version-check
CREATED := $(VENV)/.created
INSTALLED := $(VENV)/.installed
INSTALLED_DEV := $(VENV)/.installed-dev
INSTALLED_APP := $(VENV)/.installed-app

# One BLAS thread per test worker: more only fight for the same cores.
PYTEST := MPLBACKEND=Agg OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 \
	$(PY) -m pytest -n $(JOBS) --maxprocesses=8 --dist=worksteal

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
FUZZ_SECONDS ?= 300
.PHONY: help demo app test test-all durations fuzz check ci docs browser kernels lint format bench bits cluster clean clean-all FORCE

help: ## show this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-10s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

demo: $(INSTALLED) ## install, then identify the aircraft record that ships in the package
	@$(VENV)/bin/tridentify demo $(DEMO_ARGS)

app: $(INSTALLED_APP) ## install, then open the workbench in the browser on the record that ships
	@mkdir -p build/workbench && cp src/tridentify/data/short_period.csv build/workbench
	@$(VENV)/bin/tridentify app build/workbench/short_period.csv $(APP_ARGS)

test: $(INSTALLED_DEV) ## install, then run the fast tests and the docstring examples
	@HYPOTHESIS_PROFILE=$${HYPOTHESIS_PROFILE:-quick} $(PYTEST) $(ASSERT) -m "not slow" $(PYTEST_ARGS) $(AGAIN)

test-all: $(INSTALLED_DEV) ## the same with the long statistical tests
	@$(PYTEST) $(PYTEST_ARGS)

durations: $(INSTALLED_DEV) ## run the fast tests in one process and list the slowest of them
	@HYPOTHESIS_PROFILE=quick $(PYTEST) -n 0 -q -m "not slow" --durations=80 --durations-min=1 $(PYTEST_ARGS)

fuzz: $(INSTALLED_DEV) ## run the fuzzers on new seeds, FUZZ_SECONDS each (about an hour in all)
	@TRIDENTIFY_FUZZ_SECONDS=$(FUZZ_SECONDS) HYPOTHESIS_PROFILE=explore $(PYTEST) \
		--timeout=$$(($(FUZZ_SECONDS) + 300)) tests/fuzz $(PYTEST_ARGS)

check: lint docs test ## all that has to pass before a change goes in

ci: check

# The loops are compiled once, beside lint, before the several processes of docs and test need them.
ifneq ($(filter ci,$(MAKECMDGOALS)),)
docs test: | kernels
test: | lint browser
# In a fresh clone each worker would rewrite every assertion; what fails is run again with its values.
ASSERT := --assert=plain
AGAIN = || { $(PYTEST) --last-failed -m "not slow"; exit 1; }
endif

lint: $(INSTALLED_DEV) ## formatting, lint, types, layers
	@$(PY) -m ruff format --check .
	@$(PY) -m ruff check .
	@$(PY) -m mypy
	@$(VENV)/bin/lint-imports --no-logo

format: $(INSTALLED_DEV) ## format the sources and apply the safe lint fixes
	@$(PY) -m ruff check --fix .
	@$(PY) -m ruff format .

# -E: a page shows what the package does now, so none is kept from an earlier build. One process:
# with several a page that fails may leave the others waiting for good.
docs: $(INSTALLED_DEV) ## build the documentation into build/docs, running every example in it
	@MPLBACKEND=Agg OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 $(PY) -m sphinx -q -E -n -W --keep-going -b html \
		docs build/docs
	@echo "build/docs/index.html"

kernels: $(INSTALLED) ## compile the sample loops before several processes need them at once
	@OPENBLAS_NUM_THREADS=1 $(VENV)/bin/tridentify warm

browser: ## install Chromium for the tests of the report, where apt-get is allowed to
	@command -v chromium chromium-browser google-chrome >/dev/null || { \
		$(SUDO) apt-get update -qq >/dev/null 2>&1; \
		$(SUDO) env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends \
			chromium >/dev/null 2>&1 \
		|| echo "make: found no way to install Chromium; the tests of the report in a browser are skipped"; }

bench: $(INSTALLED_DEV) ## run every script of benchmarks/ (an hour and more; by hand only)
	@set -e; for script in $(sort $(wildcard benchmarks/[a-z]*.py)); do \
		echo "== $$script"; $(PY) "$$script"; \
	done
	@echo "== benchmarks/peers/run.py"; $(PY) benchmarks/peers/run.py --draws 5 --limit 20

bits: $(INSTALLED_DEV) ## hashes of estimates, states and files, compared with the stored ones
	@$(PY) benchmarks/bits.py $(BITS_ARGS)

# One thread a worker: each has a child process beside it, which does the work on one core.
cluster: $(INSTALLED_DEV) ## start a Dask scheduler and two workers on this machine, until Ctrl-C
	@echo "in another terminal: tridentify fleet|study ... --scheduler tcp://127.0.0.1:$(CLUSTER_PORT)"
	@trap 'trap - INT TERM EXIT; kill 0' INT TERM EXIT; \
	$(PY) -m distributed.cli.dask_scheduler --host 127.0.0.1 --port $(CLUSTER_PORT) --no-dashboard & \
	for worker in 1 2; do \
		$(PY) -m distributed.cli.dask_worker tcp://127.0.0.1:$(CLUSTER_PORT) --nthreads 1 \
			--no-dashboard --death-timeout 60 --local-directory build/dask & \
	done; wait

clean: ## remove caches and builds
	@rm -rf build dist .hypothesis .import_linter_cache .mypy_cache .pytest_cache .ruff_cache
	@for folder in $(wildcard src tests benchmarks examples); do \
		find $$folder -type d -name __pycache__ -prune -exec rm -rf {} +; \
	done

clean-all: clean ## the same and the virtual environment
	@rm -rf $(VENV)

# ---------------------------------------------------------------------------------- environment
SUDO := $(shell [ "$$(id -u)" = 0 ] || echo sudo -n)
APT := command -v apt-get >/dev/null && echo "Installing python3-venv with apt-get" \
	&& $(SUDO) apt-get update -qq >/dev/null 2>&1 \
	&& $(SUDO) env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq python3-venv >/dev/null 2>&1

# The environment notes its folder, so that a copied or moved checkout does not run the sources
# of the old place.
ifneq ($(shell cat $(VENV)/.folder 2>/dev/null),$(CURDIR))
$(CREATED): FORCE
endif

# An environment made by hand is kept if its own pip runs. Debian without python3-venv has no
# ensurepip: then the system's pip or virtualenv fills an empty environment, and where there is
# neither, python3-venv is installed, as far as the user may.
$(CREATED):
	@command -v "$(PYTHON)" >/dev/null || { \
		echo "make: found no '$(PYTHON)'; expected Python 3.11 or newer; install python3 or give PYTHON=..." >&2; exit 1; }
	@"$(PYTHON)" -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
		echo "make: found $$("$(PYTHON)" --version 2>&1); expected Python 3.11 or newer; install one or give PYTHON=..." >&2; exit 1; }
	@test -w . || { \
		echo "make: found a folder that cannot be written; expected to create $(VENV) in it; copy the checkout to your own folder" >&2; exit 1; }
	@if $(VENV)/bin/pip --version 2>/dev/null | grep -qF "$(CURDIR)/$(VENV)/"; then \
		:; \
	else \
		echo "Creating $(VENV) with $$("$(PYTHON)" --version)"; \
		rm -rf $(VENV); \
		"$(PYTHON)" -m venv $(VENV) >/dev/null 2>&1 \
		|| { rm -rf $(VENV); "$(PYTHON)" -m virtualenv --quiet $(VENV) >/dev/null 2>&1; } \
		|| { rm -rf $(VENV); "$(PYTHON)" -m venv --without-pip $(VENV) >/dev/null 2>&1 \
			&& "$(PYTHON)" -m pip --quiet --python $(PY) install pip >/dev/null 2>&1; } \
		|| { rm -rf $(VENV); $(APT) && "$(PYTHON)" -m venv $(VENV) >/dev/null 2>&1; } \
		|| { rm -rf $(VENV); \
			echo "make: found a Python that cannot create virtual environments; expected the venv module; run: apt install python3-venv" >&2; \
			exit 1; }; \
	fi
	@printf '%s\n' "$(CURDIR)" > $(VENV)/.folder
	@touch $@

$(INSTALLED): $(CREATED) pyproject.toml constraints.txt
	@echo "Installing tridentify (a minute or two the first time)"
	@$(PIP) install $(COMPILE) --constraint constraints.txt --editable .
	@$(PY) -m compileall -q src/tridentify
	@touch $@

# Of the package that is installed, what an extra needs: nothing is taken away while it is in use.
$(INSTALLED_APP): $(INSTALLED)
	@echo "Installing what the workbench is built on (half a minute the first time)"
	@$(PIP) install $(COMPILE) --constraint constraints.txt "tridentify[app]"
	@touch $@

$(INSTALLED_DEV): $(INSTALLED)
	@echo "Installing the development tools (a minute or two the first time)"
	@$(PIP) install $(COMPILE) --constraint constraints.txt "tridentify[dev]"
	@touch $(INSTALLED_APP) $@
