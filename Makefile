# The two main targets: `make train` and `make test`.
# They take a Python that has wheels of PyBullet if there is one, else the newest; `make PYTHON=python3.12` names one.
PYTHONS := python3.14 python3.13 python3.12 python3.11 python3 python
PREFERRED := $(if $(filter Linux-x86_64,$(shell uname -s)-$(shell uname -m)),python3.11)
IS_SUPPORTED := -c "import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 14))"
first_of = $(shell for name in $(1); do $$name $(IS_SUPPORTED) 2>/dev/null && echo $$name && break; done)
PYTHON ?= $(call first_of,$(PREFERRED) $(PYTHONS))
VENV := .venv
ROS2 := .venv-ros2
LOWEST := .venv-lowest
NEWEST := .venv-newest
ON_NEWEST = VENV=$(NEWEST) PYTHON="$(call first_of,$(PYTHONS))"
BIN := $(VENV)/$(if $(filter Windows_NT,$(OS)),Scripts,bin)
# Folder of packages in an environment, such as lib/python3.11/site-packages.
SITE = $(shell $(BIN)/python -c "import sysconfig; print(sysconfig.get_path('purelib', vars={'base': '.'}))")

.PHONY: train test newest install-newest check slow docs ros lowest clean

train: $(VENV)/installed  ## set up, train the default agent, evaluate it
	$(BIN)/python -m tb2rl.train --agent qlearn

test: $(VENV)/installed  ## set up, run the fast tests
	$(BIN)/python -m pytest -n 2

newest: install-newest  ## run the fast tests on the newest Python, in its own environment
	$(MAKE) test $(ON_NEWEST)

install-newest:
	$(MAKE) $(NEWEST)/installed $(ON_NEWEST)

slow: $(VENV)/installed  ## run the slow tests
	$(BIN)/python -m pytest -m slow -n 2 --dist worksteal --durations 20

check: $(VENV)/installed  ## format, lint, import contract, types, fast tests
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/lint-imports
	$(BIN)/mypy
	$(BIN)/python -m pytest -n 2

$(VENV)/installed: pyproject.toml constraints.txt
	@test -x $(BIN)/pip || $(PYTHON) $(IS_SUPPORTED) 2>/dev/null || { echo "error: make needs Python 3.11 to 3.14, as in 'make PYTHON=/path/to/python train'; see 'Other systems and newer Pythons' in docs/how-to/install.md" >&2; exit 2; }
	test -x $(BIN)/pip || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt torch
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable ".[dev]"
	touch $@

docs: $(VENV)/installed  ## build the site, with its notebooks, into build/docs
	$(BIN)/sphinx-build --quiet --fail-on-warning --keep-going -b html -c docs -d build/doctrees . build/docs
	@echo "open build/docs/index.html"

ros: $(ROS2)/installed  ## ROS 2 for its tests, in its own environment because its wheels start every Python twice

$(ROS2)/installed: $(VENV)/installed
	$(BIN)/python -m venv --without-pip $(ROS2)
	echo "import site; site.addsitedir('$(abspath $(VENV))/$(SITE)')" > $(ROS2)/$(SITE)/ours.pth
	$(ROS2)/bin/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable ".[ros2]"
	touch $@

lowest: $(LOWEST)/installed  ## test the pages with the lowest versions that pyproject.toml allows
	NUMBA_CACHE_DIR=$(abspath $(LOWEST))/compiled $(LOWEST)/bin/python -m pytest -W default -m "" tests/test_readme.py

# Packages that it does not pin, such as torch, come from $(VENV).
$(LOWEST)/installed: $(VENV)/installed tests/lowest_versions.py
	$(BIN)/python -m venv --without-pip $(LOWEST)
	echo "import site; site.addsitedir('$(abspath $(VENV))/$(SITE)')" > $(LOWEST)/$(SITE)/ours.pth
	$(BIN)/python tests/lowest_versions.py > $(LOWEST)/constraints.txt
	$(LOWEST)/bin/python -m pip install --quiet --disable-pip-version-check --constraint $(LOWEST)/constraints.txt --editable ".[bags,contrib,export,hub,meshes,mlflow,notebook,ray,tune,wandb]"
	touch $@

clean:
	rm -rf $(VENV) $(ROS2) $(LOWEST) $(NEWEST) build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .import_linter_cache
