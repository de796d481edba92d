# make setup   virtual environment in .venv, pinned packages, native core; then .venv/bin/svrgs is ready.
#              Installs Debian packages where something is missing: tools/setup.sh names them.
# make demo    renders a scene with Blender, trains it, prunes it, writes a report
# make test    quick tests, and a short run of each slow kind;  make test-slow  the rest: Blender, kills, fuzz, ...
# make lint    style and types;  make format  formats the sources
# make zip     the Blender extension for this platform and this Python, in dist/
# make lpips   fetches the weights of LPIPS (64 MB), which eval, compare and reports then measure
# make package the extension for all platforms and Blenders, wheels for pip, a static extension repository, in dist/
# make test-blender   the extension's tests in other Blenders too, BLENDERS="4.2.23 ..."
# make sanitize       native tests under sanitizers;  make fuzz  libFuzzer on the C interface (clang++)
PYTHON ?= $(shell tools/find_python.sh 3.11 3.13 3.12)
VENV := .venv
PY := $(VENV)/bin/python
DEMO := build/demo
unexport PYTHONDONTWRITEBYTECODE # tests start hundreds of processes, each of which would compile all modules anew

.PHONY: setup native wheels demo test test-slow test-blender lint format sanitize fuzz lpips zip package clean

setup: $(VENV)/.ready native
	@$(PY) -m compileall -q svrgs_addon
$(VENV)/.ready: requirements.txt requirements-dev.txt pyproject.toml tools/setup.sh
	@tools/setup.sh $(VENV) "$(PYTHON)"
	@touch $@
native: $(VENV)/.ready
	@tools/build_native.sh $(VENV)
wheels: $(VENV)/.ready
	@$(PY) tools/fetch_wheels.py && $(PY) tools/fetch_web_modules.py

demo: setup
	@$(PY) -m tests.demo_scene $(DEMO)/scene
	$(VENV)/bin/svrgs train --data $(DEMO)/scene --iterations 2500 --densify-until 1500 --out $(DEMO)/trained.ply
	$(VENV)/bin/svrgs prune $(DEMO)/trained.ply --data $(DEMO)/scene --recovery 2500 \
	  --out $(DEMO)/pruned.ply --report $(DEMO)/report
	@echo "report: $(DEMO)/report/index.html"
test: setup wheels; $(PY) -m pytest -n auto --dist loadfile -m "not slow"
test-slow: setup wheels; $(PY) -m pytest -n auto --dist loadfile --no-loadscope-reorder -m slow
test-blender: setup wheels
	@tools/test_blenders.sh $(VENV)
lint: $(VENV)/.ready
	@tools/lint.sh $(VENV)
format: $(VENV)/.ready
	@tools/lint.sh $(VENV) --fix
sanitize: setup; @tools/sanitize.sh $(VENV)
fuzz: ; @tools/fuzz.sh
lpips: setup; @$(PY) tools/fetch_lpips.py
zip: setup wheels; @$(PY) tools/build_extension.py
package: setup
	@tools/package.sh $(VENV)
clean:
	rm -rf build dist $(VENV) svrgs_addon/libsvrgs.so
