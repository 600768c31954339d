# photoreg: `make run` starts the app; `make` lists the rest.
# Needs only make and Python >= 3.11; everything else goes into .venv.

PYTHON ?= python3
BIN := .venv/bin
DATA ?=
# Of small systems OpenBLAS's threads mostly wait for each other, most of all where tests
# run side by side: see keep_blas_to_one_thread.
export OPENBLAS_NUM_THREADS ?= 1

.DEFAULT_GOAL := help
.PHONY: help run test test-shapes test-slow test-oldest test-cluster test-interop crash fuzz lying-input load check format bench rooms licences docs screenshots release clean

help: ## List the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  %-12s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

run: .venv/.stamp-app ## Start the app on 127.0.0.1:8080 with the demo open
	@$(BIN)/photoreg

test: .venv/.stamp-dev ## Run all tests that are not marked slow, the browser's included
	@$(BIN)/python tests/browser/ensure_chromium.py
	@$(BIN)/python -m tests.compile_kernels
	$(BIN)/pytest -n 2 --dist loadfile --no-loadscope-reorder
	NUMBA_THREADING_LAYER=workqueue $(BIN)/pytest -n 2 -m "workqueue and not slow"

test-slow: .venv/.stamp-dev ## Run the tests marked slow (minutes)
	@$(BIN)/python tests/browser/ensure_chromium.py
	$(BIN)/pytest -m slow --ignore tests/interop

test-shapes: .venv/.stamp-dev ## Run the tests of the arithmetic with every shape and type checked at every call
	PHOTOREG_CHECK_SHAPES=1 $(BIN)/pytest -n 2 -m "not slow and not wrong_types" tests/geometry tests/imaging tests/parameters tests/resection

test-cluster: .venv/.stamp-dev ## Run the tests of batches on Dask, those with killed workers and two hosts too (minutes; two hosts need root)
	@$(BIN)/python tests/browser/ensure_chromium.py
	$(BIN)/pytest -m cluster

test-interop: .venv/.stamp-interop ## Let COLMAP, MeshLab, Open3D, Blender and three.js read our files
	@$(BIN)/python tests/browser/ensure_chromium.py
	PHOTOREG_BLENDER=.venv/blender/bin/python .venv/interop/bin/pytest -m slow -p no:dash tests/interop

crash: .venv/.stamp-dev ## Kill server and worker 200 times at random moments and look for what is lost (15 minutes); ARGS="--kills 20"
	@$(BIN)/python -m tests.compile_kernels
	$(BIN)/python -m tests.robustness.crash $(ARGS)

load: .venv/.stamp-dev ## Ten browsers at once watch runs for ten minutes, drawing nothing, then two in Chromium; ARGS="--minutes 1 --pages 0"
	@$(BIN)/python tests/browser/ensure_chromium.py
	$(BIN)/python -m tests.bench.load $(ARGS)

fuzz: .venv/.stamp-dev ## Feed damaged files to every reader, a minute each; ARGS="300 ply" picks
	$(BIN)/python -m tests.robustness.fuzz $(ARGS)

lying-input: .venv/.stamp-dev ## Write the table of lying inputs and what each gets, to build/lying-input
	$(BIN)/pytest -q -m "slow or not slow" tests/robustness/test_lying_input.py

check: .venv/.stamp-dev ## Lint, formatting, types, import layers
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright
	$(BIN)/lint-imports --no-logo

format: .venv/.stamp-dev ## Format the code and mend what ruff can
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: .venv/.stamp-dev ## Measure speed and accuracy (15 minutes); DATA=folder adds real sets, ARGS="kernel --gate" picks
	$(BIN)/python -m tests.bench $(if $(DATA),--data $(DATA)) $(ARGS)

rooms: .venv/.stamp-dev ## Draw the rooms of the code anew into docs/architecture.md
	$(BIN)/python -m tests.rooms

docs: .venv/.stamp-docs ## Build the documentation into build/docs; a warning or a dead link fails
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet
	$(BIN)/python -m docs.check_site build/docs

licences: .venv/.stamp-dev ## Write the licences of what is installed into docs/licences.md
	$(BIN)/python -m tests.licences

screenshots: .venv/.stamp-dev ## Take the README's pictures from the running app
	@$(BIN)/python tests/browser/ensure_chromium.py
	$(BIN)/python -m tests.browser.screenshots

test-oldest: .venv/.stamp-oldest ## Run the tests, the browser's excepted, with the oldest versions that pyproject.toml permits
	@.venv/oldest/bin/python -m tests.compile_kernels
	.venv/oldest/bin/pytest -n 2 --dist loadfile --no-loadscope-reorder --ignore tests/browser --ignore tests/bench

release: .venv/.stamp-dev ## Build wheel and sdist of the last commit into dist, and try both in empty environments (minutes)
	$(BIN)/python -m tests.release

clean: ## Remove the environment and what tools left behind
	rm -rf .venv build dist .pytest_cache .ruff_cache .hypothesis
	find photoreg app tests -name __pycache__ -prune -exec rm -rf {} +

.venv/.stamp-venv:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "photoreg needs Python 3.11 or newer; this is $$($(PYTHON) --version 2>&1). Try: make PYTHON=python3.12 $(MAKECMDGOALS)"; exit 2; }
	@$(PYTHON) -m venv .venv || \
	  { echo "Python could not make a virtual environment. On Debian or Ubuntu: apt install python3-venv"; exit 2; }
	@touch $@

.venv/.stamp-app: .venv/.stamp-venv pyproject.toml
	@echo "Installing photoreg into .venv (once; about a minute) ..."
	@$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[app]'
	@touch $@

.venv/.stamp-dev: .venv/.stamp-app pyproject.toml
	@echo "Installing the test tools into .venv (once) ..."
	@$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $@

# uv, because pip always takes the newest.
.venv/.stamp-oldest: .venv/.stamp-dev pyproject.toml
	@echo "Installing the oldest versions into .venv/oldest (once) ..."
	@$(PYTHON) -m venv .venv/oldest
	@$(BIN)/uv pip install --quiet --python .venv/oldest --resolution lowest-direct --editable '.[dev]'
	@touch $@

.venv/.stamp-docs: .venv/.stamp-dev pyproject.toml
	@echo "Installing MkDocs into .venv (once) ..."
	@$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[docs]'
	@touch $@

# MeshLab projects photos with OpenGL, and Open3D looks for cameras at USB. On Debian or
# Ubuntu they need, beside a display or xvfb: apt install xvfb xauth libgl1 libopengl0
# libegl1 libglu1-mesa libxkbcommon-x11-0 libxcb-icccm4 libxcb-keysyms1 libxcb-xinerama0
# libusb-1.0-0.
# Environments of their own: Open3D brings a web server and a pytest plugin that breaks
# ours, Blender another numpy.
.venv/.stamp-interop: .venv/.stamp-dev pyproject.toml
	@echo "Installing COLMAP, MeshLab, Open3D, Blender and three.js for the tests (once; 2 GB) ..."
	@$(PYTHON) -m venv .venv/interop
	@.venv/interop/bin/pip install --quiet --disable-pip-version-check --editable '.[dev,interop]'
	@$(PYTHON) -m venv .venv/blender
	@.venv/blender/bin/pip install --quiet --disable-pip-version-check bpy
	@if command -v npm >/dev/null; then \
	  npm install --silent --no-audit --no-fund --no-save --prefix .venv/three three@0.180.0; \
	else echo "There is no npm, so three.js is left out."; fi
	@touch $@
