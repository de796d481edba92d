# make setup   virtual environment, pinned packages, native core; .venv/bin/svrgs stands ready
# make demo    generates a scene, trains it, prunes it, leaves a report
# make test    all tests
# make zip     the Blender extension, dist/svrgs-VERSION.zip, built and checked by Blender's own builder
PYTHON ?= python3.11
VENV := .venv
PY := $(VENV)/bin/python
DEMO := build/demo
# What Blender as a module links against; installed where it does not load yet.
BLENDER_LIBRARIES := libx11-6 libxrender1 libxfixes3 libxi6 libxkbcommon0 libsm6 libgl1 libegl1 libxxf86vm1 libgomp1
SUDO := $(shell test "$$(id -u)" = 0 || echo sudo)
INSTALL := $(SUDO) apt-get update -qq && $(SUDO) apt-get install -y -qq --no-install-recommends
PIP := $(PY) -m pip install --quiet --disable-pip-version-check

.PHONY: setup native demo test zip clean

setup: $(VENV)/.ready native
	$(PY) -m compileall -q svrgs_addon

$(VENV)/.ready: requirements.txt requirements-dev.txt pyproject.toml
	$(PYTHON) -m venv $(VENV) || { $(INSTALL) $(PYTHON)-venv && $(PYTHON) -m venv $(VENV); }
	$(PIP) -r requirements-dev.txt
	$(PIP) --no-deps --editable .
	$(PY) -c "import bpy" 2>/dev/null || { $(INSTALL) $(BLENDER_LIBRARIES) && $(PY) -c "import bpy"; }
	command -v valgrind >/dev/null || { $(INSTALL) valgrind; } || echo "without valgrind, tests/test_instruction_counts.py is skipped"
	touch $@

native:
	$(MAKE) --no-print-directory -C native

demo: setup
	$(PY) -m tests.demo_scene $(DEMO)/scene
	$(VENV)/bin/svrgs train --colmap $(DEMO)/scene --iterations 2500 --densify-until 1500 --out $(DEMO)/trained.ply
	$(VENV)/bin/svrgs prune $(DEMO)/trained.ply --colmap $(DEMO)/scene --recovery 2500 --out $(DEMO)/pruned.ply --report $(DEMO)/report
	@echo "report: $(DEMO)/report/index.html"

test: setup
	$(PY) -m pytest

# Blender's builder is a script inside the bpy package; it runs without starting Blender.
EXTENSION = $(PY) $(shell $(PY) -c "import importlib.util as u, pathlib as p; print(next(p.Path(u.find_spec('bpy').origin).parent.glob('*/scripts/addons_core/bl_pkg/cli/blender_ext.py')))")

zip: setup
	mkdir -p dist && rm -f dist/*.zip
	$(EXTENSION) build --source-dir . --output-dir dist
	$(EXTENSION) validate dist/*.zip

clean:
	$(MAKE) -C native clean
	rm -rf build dist $(VENV)
