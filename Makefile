# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0

# Another Python or ROS 2, each with an environment of its own: make test PYTHON=python3.12 ROS_DISTRO=kilted
PYTHON ?= python3
ROS_DISTRO ?= jazzy
VENV ?= .venv$(patsubst python3%,%,$(notdir $(PYTHON)))$(patsubst %,-%,$(filter-out jazzy,$(ROS_DISTRO)))
BIN := $(VENV)/bin
PYTEST_ARGS ?=
SHELL := bash
.SHELLFLAGS := -o pipefail -c

# Nodes of tests and demos stay on this machine.
export ROS_AUTOMATIC_DISCOVERY_RANGE ?= LOCALHOST

.DEFAULT_GOAL := help
.PHONY: help demo test venv lint bench config docs clean

help: ## list the targets
	@sed -n 's/^\([a-z]*\):.*## \(.*\)/make \1\t\2/p' Makefile

demo: $(VENV)/demo ## play the sample bag through the live graph; prints a table, writes a bag and an image
	$(BIN)/stereo-depth demo --overwrite

# Three processes on two cores: the one of the graph mostly waits. The hundreds that they start load bytecode, also where
# the environment says to write none.
test: export PYTHONDONTWRITEBYTECODE :=
# Threads of OpenBLAS wait actively, which on small matrices costs twice the time of all cores.
test: export OPENBLAS_NUM_THREADS ?= 1
test: $(VENV)/test ## run every test; those of the graph one after the other, the others beside them
	$(BIN)/python -m pytest -n 3 $(PYTEST_ARGS)

lint: $(VENV)/lint ## check style and types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

bench: $(VENV)/demo ## measure the graph beside the bare kernels
	$(BIN)/python benchmarks/graph.py

config: $(VENV)/demo ## write everything generated: the parameter file, the tables of README and docs, the drawing
	$(BIN)/python tools/documentation.py

docs: config ## the same as make config

clean: ## remove environments and everything built
	rm -rf .venv* build install log out .mypy_cache .ruff_cache .pytest_cache *.egg-info
	find . -name __pycache__ -prune -exec rm -rf {} +

venv: $(VENV)/test ## set up the environment with everything; the others set up what they need

# What the targets need, and how much pip downloads for them. An environment with everything serves all of them.
$(VENV)/demo: EXTRAS := ros
$(VENV)/demo: MEGABYTES := 200
$(VENV)/lint: EXTRAS := lint
$(VENV)/lint: MEGABYTES := 190
$(VENV)/test: EXTRAS := ros test lint
$(VENV)/test: MEGABYTES := 280
$(VENV)/test: SERVES := $(VENV)/demo $(VENV)/lint
ROS_WHEELS := $(patsubst ros-jazzy,ros,ros-$(ROS_DISTRO))

# Prints the version of numpy where ROS 2 is sourced; an rclpy inside an active virtual environment is not the system's.
SYSTEM_ROS := import sys, numpy, rclpy, stereo_msgs.msg; \
  own = sys.prefix != sys.base_prefix and rclpy.__file__.startswith(sys.prefix); \
  print(numpy.__version__); sys.exit(own)

# Of what pip prints, the downloads of megabytes and the last step; errors are not filtered.
SHORTER := sed -un -e '/^ *\(Downloading\|Using cached\).* MB)/p' -e 's/^\(Installing collected packages\).*/\1/p'

# Bytecode is written on all cores, and not for the tests of other packages; files that no Python can read are left out.
# Where ROS 2 is sourced its rclpy is used, with the numpy it was built for; elsewhere the wheels of an extra.
$(VENV)/demo $(VENV)/lint $(VENV)/test: setup.py setup.cfg pyproject.toml package.xml
	@command -v $(PYTHON) >/dev/null || { echo "$(PYTHON) is missing: install it, or make ... PYTHON=python3.x" >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 13))' \
	  || { echo "$$($(PYTHON) -V) is not among Python 3.10 to 3.13: make ... PYTHON=python3.12" >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null \
	  || { echo "$(PYTHON) has no venv: on Debian and Ubuntu, sudo apt install python3-venv" >&2; exit 1; }
	@if numpy=$$($(PYTHON) -c '$(SYSTEM_ROS)' 2>/dev/null); then \
	  system=--system-site-packages; numpy="numpy==$$numpy"; extras=($(filter-out ros,$(EXTRAS))); \
	else \
	  [[ " jazzy kilted " == *" $(ROS_DISTRO) "* ]] \
	    || { echo "ROS 2 $(ROS_DISTRO) is not sourced and has no wheels: make ... ROS_DISTRO=jazzy" >&2; exit 1; }; \
	  numpy=; extras=($(patsubst ros,$(ROS_WHEELS),$(EXTRAS))); \
	fi; \
	IFS=,; package=".$${extras:+[$${extras[*]}]}"; \
	echo "Installing $$package into $(VENV): about $(MEGABYTES) MB to download"; \
	$(PYTHON) -m venv $$system $(VENV) \
	  && $(BIN)/python -m pip install --no-compile --editable "$$package" $$numpy | $(SHORTER) \
	  && { $(BIN)/python -m compileall -qq -j 0 -x /tests/ $(VENV)/lib || true; }
	@touch $@ $(SERVES)
