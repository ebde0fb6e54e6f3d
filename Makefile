# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
#
# Everything here runs in a virtual environment, .venv, that is made at the first call.
#   make demo     a simulated robot maps an office floor: results/latest/map.png
#   make view     the same in a browser, live
#   make test     the tests
#   make lint     ruff and mypy
#   make docs     docs/parameters.md, config/default.yaml and the generated parts of docs/
#   make clean    remove .venv and what .ci/run made beside it
# Another Python: make PYTHON=/path/to/python3.12 demo (after make clean)

VENV := .venv
BIN := $(VENV)/bin
RUN := $(VENV)/.installed
COMPILED := $(VENV)/.compiled
VIEW := $(VENV)/.installed-view
DEV := $(VENV)/.installed-dev

export PIP_DISABLE_PIP_VERSION_CHECK := 1

.PHONY: demo view test lint docs clean
.DELETE_ON_ERROR:

demo: $(COMPILED)
	$(BIN)/ratslam demo
	@echo "(the command is in $(BIN): source $(BIN)/activate)"

view: $(VIEW) $(COMPILED)
	$(BIN)/ratslam demo --view

# Three workers for two cores, because tests of processes often wait.
test: $(DEV)
	$(BIN)/python -m pytest --numprocesses 3 --dist loadfile --no-loadscope-reorder $(PYTEST_ARGS)

lint: $(DEV)
	$(BIN)/ruff check .
	$(BIN)/mypy

docs: $(RUN)
	$(BIN)/python tools/write_docs.py

clean:
	rm -rf $(VENV) $(VENV)-jazzy

$(BIN)/python:
	@python=$$(PYTHON='$(PYTHON)' .ci/find_python) || exit 1; \
	echo "making $(VENV) with $$python"; \
	rm -rf $(VENV) && "$$python" -m venv $(VENV)

$(RUN): setup.py setup.cfg pyproject.toml | $(BIN)/python
	@echo 'installing what ratslam_ros needs into $(VENV): once, a few minutes at most'
	$(BIN)/python -m pip install --quiet --editable .
	@touch $@

# On all cores; what is out of date or missing otherwise is compiled when it is used.
$(COMPILED): $(RUN)
	$(BIN)/ratslam warm-up mapping simulator
	@touch $@

$(VIEW): $(RUN)
	$(BIN)/python -m pip install --quiet --editable '.[view]'
	@touch $@

$(DEV): $(RUN)
	@echo 'installing the tools for tests into $(VENV)'
	$(BIN)/python -m pip install --quiet --editable '.[dev]'
	@touch $@
