# make setup   virtual environment, pinned packages, native core; .venv/bin/svrgs stands ready
# make demo    generates a scene, trains it, prunes it, leaves a report
# make test    all tests
# make test-blender  the extension's tests in other Blenders too, BLENDERS="4.2.23 ..."
# make sanitize  native tests under ASan and UBSan, pool and kernels under TSan;  make fuzz  libFuzzer on the C interface (clang++)
# make zip     the Blender extension, dist/svrgs-VERSION.zip, built and checked by Blender's own builder
PYTHON ?= python3.11
PYTHON313 ?= python3.13
BLENDERS ?= 4.2.23 4.5.15 5.2.3
VENV := .venv
PY := $(VENV)/bin/python
DEMO := build/demo
# What Blender as a module links against; installed where it does not load yet.
BLENDER_LIBRARIES := libx11-6 libxrender1 libxfixes3 libxi6 libxkbcommon0 libsm6 libgl1 libegl1 libxxf86vm1 libgomp1
SUDO := $(shell test "$$(id -u)" = 0 || echo sudo)
INSTALL := $(SUDO) apt-get update -qq && $(SUDO) apt-get install -y -qq --no-install-recommends
PIP := $(PY) -m pip install --quiet --disable-pip-version-check

# What travels in the extension, by its manifest.
WHEELS := $(shell sed -n 's|.*"./\(wheels/.*[.]whl\)".*|\1|p' blender_manifest.toml)

.PHONY: setup native demo test test-blender sanitize fuzz zip clean

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

test: setup $(WHEELS)
	$(PY) -m pytest

# The address sanitizer's runtime comes first in Python's process; leaks are not looked for, since Python keeps memory to its end.
SAFE := build/sanitize
SANITIZED := tests/test_native_training_kernels.py tests/test_native_stress.py tests/test_native_invariants.py tests/test_native_update.py tests/test_native_removal.py
ASAN_RUNTIME = $(shell $(CXX) -print-file-name=libasan.so) $(shell $(CXX) -print-file-name=libstdc++.so)
CORPUS := tests/fuzz/corpus
CLANG ?= clang++-16
FUZZ_SECONDS ?= 300
SAFE_NATIVE = $(MAKE) --no-print-directory -C native

sanitize: setup
	mkdir -p $(SAFE)
	$(SAFE_NATIVE) BUILD=build/asan OUT=../$(SAFE)/libsvrgs-asan.so EXTRA="-O1 -g -fsanitize=address,undefined -fno-sanitize-recover=all"
	SVRGS_LIBRARY=$(CURDIR)/$(SAFE)/libsvrgs-asan.so LD_PRELOAD="$(ASAN_RUNTIME)" ASAN_OPTIONS=detect_leaks=0 UBSAN_OPTIONS=print_stacktrace=1 PYTHONMALLOC=malloc $(PY) -m pytest $(SANITIZED)
	$(CXX) -std=c++20 $(FUZZ_FLAGS) -pthread -Inative/include tests/sanitizers/fuzz.cc tests/sanitizers/replay.cc $(SAFE)/libsvrgs-asan.so -Wl,-rpath,$(CURDIR)/$(SAFE) -o $(SAFE)/replay
	$(SAFE)/replay $(CORPUS)/*
	$(SAFE_NATIVE) BUILD=build/tsan OUT=../$(SAFE)/libsvrgs-tsan.so EXTRA="-O1 -g -fsanitize=thread"
	$(CXX) -std=c++20 -O1 -g -fsanitize=thread -pthread -Inative/include tests/sanitizers/threads.cc $(SAFE)/libsvrgs-tsan.so -Wl,-rpath,$(CURDIR)/$(SAFE) -o $(SAFE)/threads
	TSAN_OPTIONS=halt_on_error=1 $(SAFE)/threads

FUZZ_FLAGS := -O1 -g -fsanitize=address,undefined -fno-sanitize-recover=all
fuzz:
	mkdir -p $(SAFE)/corpus
	$(SAFE_NATIVE) CXX=$(CLANG) BUILD=build/fuzz OUT=../$(SAFE)/libsvrgs-fuzz.so LINK="-shared -pthread" EXTRA="$(FUZZ_FLAGS) -fsanitize=fuzzer-no-link"
	$(CLANG) -std=c++20 $(FUZZ_FLAGS) -fsanitize=fuzzer -pthread -Inative/include tests/sanitizers/fuzz.cc $(SAFE)/libsvrgs-fuzz.so -Wl,-rpath,$(CURDIR)/$(SAFE) -o $(SAFE)/fuzz
	$(SAFE)/fuzz -max_total_time=$(FUZZ_SECONDS) -max_len=8192 -len_control=0 -print_final_stats=1 -artifact_prefix=$(SAFE)/ $(SAFE)/corpus $(CORPUS)

# Blender's builder is a script inside the bpy package; it runs without starting Blender.
EXTENSION = $(PY) $(shell $(PY) -c "import importlib.util as u, pathlib as p; print(next(p.Path(u.find_spec('bpy').origin).parent.glob('*/scripts/addons_core/bl_pkg/cli/blender_ext.py')))")

zip: setup $(WHEELS)
	mkdir -p dist && rm -f dist/*.zip
	$(EXTENSION) build --source-dir . --output-dir dist
	$(EXTENSION) validate dist/*.zip

# NAME-VERSION-PYTHON-ABI-PLATFORM[.PLATFORM].whl
wheels/%.whl: | $(VENV)/.ready
	name=$(basename $(@F)); IFS=-; set -- $$name; unset IFS; $(PY) -m pip download --quiet --disable-pip-version-check --no-deps --only-binary=:all: --dest wheels --python-version $${3#cp} --platform $${5##*.} $$1==$$2

# Blender 4.2, 4.5 and 5.2 beside the 5.0 of the development environment: about 1 GB each.
test-blender: setup $(WHEELS) $(BLENDERS:%=build/bpy-%/.ready)
	SVRGS_BLENDER_PYTHONS=$(subst $(eval ) ,:,$(BLENDERS:%=$(CURDIR)/build/bpy-%/bin/python)) $(PY) -m pytest tests/test_extension.py

build/bpy-%/.ready:
	$(if $(filter 5.2%,$*),$(PYTHON313),$(PYTHON)) -m venv build/bpy-$*
	build/bpy-$*/bin/python -m pip install --quiet --disable-pip-version-check bpy==$* pytest $(if $(filter 5.2%,$*),OpenImageIO,"numpy<2")
	touch $@

clean:
	$(MAKE) -C native clean
	rm -rf build dist $(VENV)
