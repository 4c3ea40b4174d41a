# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0

# Another Python, with an environment of its own: make test PYTHON=python3.12
PYTHON ?= python3
VENV ?= .venv$(patsubst python3%,%,$(notdir $(PYTHON)))
BIN := $(VENV)/bin
STAMP := $(VENV)/installed
PYTEST_ARGS ?=

# Nodes of tests and demos stay on this machine.
export ROS_AUTOMATIC_DISCOVERY_RANGE ?= LOCALHOST

.DEFAULT_GOAL := help
.PHONY: help demo test venv lint bench config docs clean

help: ## list the targets
	@sed -n 's/^\([a-z]*\):.*## \(.*\)/make \1\t\2/p' Makefile

demo: venv ## play the sample bag through the live graph; prints a table, writes a bag and an image
	$(BIN)/stereo-depth demo --overwrite

test: venv ## run every test; those of the graph one after the other, the others beside them
	$(BIN)/python -m pytest -n 2 --dist loadgroup $(PYTEST_ARGS)

lint: venv ## check style and types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

bench: venv ## measure the graph beside the bare kernels
	$(BIN)/python benchmarks/graph.py

config: venv ## write everything generated: the parameter file, the tables of README and docs, the drawing
	$(BIN)/python tools/documentation.py

docs: config ## the same as make config

clean: ## remove environments and everything built
	rm -rf .venv* build install log out .mypy_cache .ruff_cache .pytest_cache *.egg-info
	find . -name __pycache__ -prune -exec rm -rf {} +

venv: $(STAMP) ## set up the Python environment (the others do so too)

# Prints the version of numpy where ROS 2 is sourced; an rclpy inside an active virtual environment is not the system's.
SYSTEM_ROS := import sys, numpy, rclpy, stereo_msgs.msg; \
  own = sys.prefix != sys.base_prefix and rclpy.__file__.startswith(sys.prefix); \
  print(numpy.__version__); sys.exit(own)

# Where ROS 2 is sourced its rclpy is used, with the numpy it was built for; elsewhere the wheels of the extra [ros].
$(STAMP): setup.py setup.cfg package.xml
	@command -v $(PYTHON) >/dev/null || { echo "$(PYTHON) is missing: install it, or make ... PYTHON=python3.x" >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 13))' \
	  || { echo "$$($(PYTHON) -V) is not among Python 3.10 to 3.13: make ... PYTHON=python3.12" >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null \
	  || { echo "$(PYTHON) has no venv: on Debian and Ubuntu, sudo apt install python3-venv" >&2; exit 1; }
	@if numpy=$$($(PYTHON) -c '$(SYSTEM_ROS)' 2>/dev/null); then \
	  set -x && $(PYTHON) -m venv --system-site-packages $(VENV) \
	  && $(BIN)/python -m pip install --quiet --editable '.[test]' "numpy==$$numpy"; \
	else \
	  set -x && $(PYTHON) -m venv $(VENV) \
	  && $(BIN)/python -m pip install --quiet --editable '.[ros,test]'; \
	fi
	@touch $@
