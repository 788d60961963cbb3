# make demo          build, install into .venv, collect episodes of PickCuboid with the scripted FR3, and say where the report is
# make test          build, install, run the tests of C++ and Python, on all cores; a few minutes
# make test-all      the same with the tests that take more than ten seconds and with the coverage; test-extras
# make test-extras   the tests that need torch, Stable-Baselines3, Ray, Pinocchio, OMPL, OpenCV, mujoco-menagerie or a browser;
#                    test-wheel. As in .ci/run
# make test-wheel    build a wheel, install it into an environment of its own, and run it there
# make test-interop  open our exports with the readers of LeRobot and others, and serve tiny policies of other projects; each
#                    gets an environment of its own (first time: about 10 GB and 20 minutes)
# make sims          environments of the simulators LIBERO, ManiSkill and Meta-World, and of vla-eval (first time: about 6 GB and
#                    10 minutes); part of test-interop
# make test-wires    policies over openpi's wire, asked and served by its own client and layout; part of test-interop
# make test-hardware the drivers, over their vendors' libraries, against virtual robots; about six minutes. As in .ci/run
# make test-hardware-all the same with the contracts of arms and grippers; a quarter of an hour
# make test-cluster  Ray clusters of two machines on this one, parts of which are killed; 3 to 5 minutes
# make test-sanitize the C++ tests, and the Python tests of what uses the core, under the sanitizers of addresses and undefined
#                    behaviour; the C++ tests under that of threads. Any finding ends it. About 15 minutes; FUZZ=300000 has the
#                    fuzzer make that many calls besides
# make check         format, lint, types, import layers, stubs
# make docs          build the documents as a site, with a reference of all public names, in build/docs; warnings are errors
# make bench         every benchmark: one line of JSON each; installs what test-extras and test-hardware do
# make format        format Python and C++;   make stubs   write the stubs of the extension anew
# make clean         remove build products; .venv and datasets stay
#
# PYTHON=python3.12 make test   uses another interpreter than the first suitable one on the path, if there is no .venv yet.

SHELL := /bin/sh
.SUFFIXES:
.NOTPARALLEL:
.DEFAULT_GOAL := help
MAKEFLAGS += --no-print-directory

VENV := .venv
BIN := $(VENV)/bin
# Twice quiet: warnings about a machine's own package index are no news. Errors are shown.
PIP := $(BIN)/python -m pip -qq --disable-pip-version-check
JOBS := $(shell nproc 2>/dev/null || echo 2)

# These build the extension. Build isolation is off: an isolated build would fetch these anew each time and compile from nothing.
BUILD_TOOLS := scikit-build-core nanobind mujoco-core ruckig cmake ninja
# Folders too: a file that is gone changes nothing but its folder's time.
CORE := CMakeLists.txt $(shell find cmake core -not -path '*/tests*' -not -path '*/examples*')
CXX_FILES = $(shell find core tests -name '*.cpp' -o -name '*.hpp')
STUB := src/rcs/_core.pyi
STUBGEN = $(BIN)/python -m nanobind.stubgen --quiet --module rcs._core --output-file

.PHONY: help build gl demo docs test test-all test-cpp test-sanitize test-extras test-hardware test-hardware-all test-cluster test-wheel test-interop check bench format stubs clean

help:
	@sed '/^$$/q; s/^# \{0,1\}//' Makefile

# --- Build and install -----------------------------------------------------------------------------------------------

build: $(VENV)/.stamp-built

# An environment keeps the Python that made it.
.PHONY: same-python
same-python:
	@[ -z '$(PYTHON)' ] || [ ! -e $(BIN)/python ] || { version='import sys; print("%d.%d" % sys.version_info[:2])' && \
	  has=$$($(BIN)/python -c "$$version") && { [ "$$($(PYTHON) -c "$$version")" = "$$has" ] || { \
	  echo "PYTHON is $(PYTHON), but $(VENV) has Python $$has. Remove $(VENV), or leave PYTHON out." >&2; exit 1; }; }; }

$(VENV)/.stamp-venv: | same-python
	@python=$$(PYTHON='$(PYTHON)' tools/system_packages build) && \
	  echo "==> Making $(VENV) with $$($$python --version)" && \
	  { $(BIN)/python -m pip --version >/dev/null 2>&1 || $$python -m venv --clear $(VENV); }
	@touch $@

$(VENV)/.stamp-tools: $(VENV)/.stamp-venv constraints.txt
	@echo "==> Installing what builds the extension (first time: about 150 MB)"
	@$(PIP) install -c constraints.txt $(BUILD_TOOLS)
	@touch $@

$(VENV)/.stamp-built: $(VENV)/.stamp-tools pyproject.toml packages/rcs-data/pyproject.toml packages/vlagents/pyproject.toml $(CORE)
	@echo "==> Compiling the core and installing rcs with its dependencies (first time: a minute or two)"
	@$(PIP) install -c constraints.txt -e 'packages/rcs-data[rlds]' -e packages/vlagents # tfrecord has no wheel: isolated, too
	@$(PIP) install --no-build-isolation -c constraints.txt -e '.[dev]'
	@touch $@

# Without OpenGL everything but cameras works; so a library that cannot be installed is told, and no more.
gl: build
	@tools/system_packages gl $(BIN)/python

# --- Use -------------------------------------------------------------------------------------------------------------

DEMO := datasets/demo

demo: build gl
	@echo "==> Collecting 20 episodes into $(DEMO); stop with Ctrl-C at any time, the next run goes on"
	@$(BIN)/rcs collect PickCuboid --robot fr3 --episodes 20 --out $(DEMO) --seed 1 --cameras wrist side
	@test -f $(DEMO)/report.html && echo "==> The report is $(CURDIR)/$(DEMO)/report.html: open it in a browser"

bench: $(VENV)/.stamp-extras $(VENV)/.stamp-drivers gl
	@failed=; for file in benchmarks/*.py; do $(BIN)/python "$$file" || failed="$$failed $$file"; done; \
	  [ -z "$$failed" ] || { echo "==> Failed:$$failed" >&2; exit 1; }

# --- Documents -------------------------------------------------------------------------------------------------------

$(VENV)/.stamp-docs: $(VENV)/.stamp-built
	@echo "==> Installing what builds the site (first time: about 60 MB)"
	@$(PIP) install -c constraints.txt mkdocs mkdocs-material 'mkdocstrings[python]'
	@touch $@

# Some pages are written from the code, and are committed; tests/test_docs.py tells when they are stale.
docs: $(VENV)/.stamp-docs
	@$(BIN)/python tools/reference_pages.py >/dev/null
	@NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --quiet --clean
	@echo "==> The start page is $(CURDIR)/build/docs/index.html"

# --- Tests -----------------------------------------------------------------------------------------------------------

# On all cores, though no more than eight: each process imports everything. A file's tests share what is made once for them, and
# so stay in one process, in the order of conftest.py. NumPy and torch would start a thread per core in each process.
PYTEST := OMP_NUM_THREADS=1 $(BIN)/python -m pytest --numprocesses=$(JOBS) --maxprocesses=8 --dist=loadfile --no-loadscope-reorder \
  --durations=10

# Runs the tests that $(2) selects by the command $(1). Tests that fail are run once more, by themselves, and have to pass then: other
# work on a machine makes tests in real time late. The first failures are printed all the same. Only after status 1: then every test
# has run, and the cache has those of $(2) that failed. With any other status the run itself is broken.
TESTED = $(1) $(2) || { [ $$? -eq 1 ] && echo "==> Testing once more what failed" && \
  OMP_NUM_THREADS=1 $(BIN)/python -m pytest $(2) --last-failed --last-failed-no-failures none; }

test: test-cpp gl
	@echo "==> Testing Python"
	@$(call TESTED,$(PYTEST))

test-all: test-cpp gl
	@echo "==> Testing Python, with what is slow"
	@$(PYTEST) -m "not extras and not cluster and not interop and not hardware" \
	  --cov --cov-report=html:build/coverage --cov-fail-under=90
	@$(MAKE) test-extras

test-cpp: build
	@echo "==> Compiling and testing C++"
	@$(BIN)/cmake -S . -B build/tests -G Ninja -DRCS_BUILD_PYTHON=OFF -DRCS_BUILD_TESTS=ON --log-level=WARNING \
	  -DPython_EXECUTABLE=$(CURDIR)/$(BIN)/python -DCMAKE_MAKE_PROGRAM=$(CURDIR)/$(BIN)/ninja >/dev/null
	@$(BIN)/cmake --build build/tests -j $(JOBS) -- --quiet
	@$(BIN)/ctest --test-dir build/tests --output-on-failure -j $(JOBS)

# A build of its own per set of sanitizers, in build/sanitize; the installed extension stays as it is. Every Python of a run
# loads the sanitized one (tools/sanitized), and has the sanitizers loaded before anything else.
SANITIZE := build/sanitize
# Sanitized code is three times as slow; how long a frame takes is no question here.
SANITIZED_TESTS := --deselect tests/sim/test_tactile.py::test_a_frame_is_ready_in_time_for_the_sensors_rate \
  tests/core tests/sim tests/envs tests/devices tests/kinematics \
  tests/fuzz/test_fuzz_core.py
LIBRARY_OF_GCC = $(shell gcc -print-file-name=$(1))
# Leaks: Python keeps what it allocates to the end. Handlers of the tests would hide a crash from the sanitizer.
RUN_SANITIZED = env LD_PRELOAD="$(call LIBRARY_OF_GCC,libasan.so) $(call LIBRARY_OF_GCC,libubsan.so)" \
  ASAN_OPTIONS=detect_leaks=0:abort_on_error=1 UBSAN_OPTIONS=print_stacktrace=1 PYTHONPATH=tools/sanitized \
  RCS_SANITIZED_CORE=$(CURDIR)/$(firstword $(wildcard $(SANITIZE)/address/_core.*.so)) $(BIN)/python

test-sanitize: build gl
	@echo "==> Compiling the core with the sanitizers of addresses and undefined behaviour"
	@$(BIN)/cmake -S . -B $(SANITIZE)/address -G Ninja -DRCS_SANITIZE=address,undefined -DRCS_BUILD_TESTS=ON --log-level=WARNING \
	  -DPython_EXECUTABLE=$(CURDIR)/$(BIN)/python -DCMAKE_MAKE_PROGRAM=$(CURDIR)/$(BIN)/ninja >/dev/null
	@$(BIN)/cmake --build $(SANITIZE)/address -j $(JOBS) -- --quiet
	@echo "==> Compiling the core with the sanitizer of threads"
	@$(BIN)/cmake -S . -B $(SANITIZE)/thread -G Ninja -DRCS_SANITIZE=thread -DRCS_BUILD_TESTS=ON -DRCS_BUILD_PYTHON=OFF \
	  -DPython_EXECUTABLE=$(CURDIR)/$(BIN)/python -DCMAKE_MAKE_PROGRAM=$(CURDIR)/$(BIN)/ninja --log-level=WARNING >/dev/null
	@$(BIN)/cmake --build $(SANITIZE)/thread -j $(JOBS) -- --quiet
	@$(MAKE) test-sanitized FUZZ=$(FUZZ)

# By itself, because it looks for the extension that the target above has built.
.PHONY: test-sanitized
test-sanitized:
	@echo "==> C++ under the sanitizers of addresses and undefined behaviour"
	@UBSAN_OPTIONS=print_stacktrace=1 $(BIN)/ctest --test-dir $(SANITIZE)/address --output-on-failure --no-label-summary -Q
	@echo "==> C++ under the sanitizer of threads"
	@TSAN_OPTIONS="suppressions=$(CURDIR)/tools/sanitized/threads.supp halt_on_error=1" \
	  $(BIN)/ctest --test-dir $(SANITIZE)/thread --output-on-failure --no-label-summary -Q
	@echo "==> Python under the sanitizers of addresses and undefined behaviour"
	@$(RUN_SANITIZED) -m pytest -q -p no:faulthandler $(SANITIZED_TESTS)
	@[ -z "$(FUZZ)" ] || $(RUN_SANITIZED) tests/fuzz/fuzz_core.py --calls $(FUZZ)

# torch by itself and first: what depends on it then takes this version, and never looks for another.
$(VENV)/.stamp-extras: $(VENV)/.stamp-built
	@echo "==> Installing torch, Stable-Baselines3, Ray, Pinocchio and OMPL (first time: about 2 GB)"
	@$(PIP) install -c constraints.txt torch
	@$(PIP) install -c constraints.txt stable-baselines3 mujoco-menagerie ray pin ompl
	@$(PIP) install -c constraints.txt opencv-python-headless pupil-apriltags scipy pyzmq matplotlib huggingface_hub mcap-protobuf-support foxglove-schemas-protobuf
	@$(PIP) install -c constraints.txt websockets cryptography pygame-ce openvr
	@touch $@

# A headset in JavaScript, by Meta, for a browser without one.
IWER := build/npm/package/build/iwer.min.js

test-extras: test-wheel $(VENV)/.stamp-extras gl
	@tools/system_packages browser
	@tools/system_packages inputs
	@[ -e $(IWER) ] || ! command -v npm >/dev/null || { echo "==> Fetching the headset for tests of its page" && mkdir -p build/npm && \
	  (cd build/npm && npm pack --silent iwer@2.5.0 && tar xzf iwer-2.5.0.tgz) >/dev/null; }
	@echo "==> Testing what needs extras"
	@$(call TESTED,$(PYTEST),-m "extras or browser")

# The extras that bring the vendors' libraries.
DRIVERS := digit franka leader pylibfranka realsense robotiq so101 tilburg ur webcam xarm

$(VENV)/.stamp-drivers: $(VENV)/.stamp-built pyproject.toml Makefile
	@echo "==> Installing the vendors' libraries of $(DRIVERS)"
	@$(BIN)/python -c "import sys, tomllib; extras = tomllib.load(open('pyproject.toml', 'rb'))['project']['optional-dependencies']; \
	  print(*sorted({one for name in sys.argv[1:] for one in extras[name]}), sep='\n')" $(DRIVERS) | \
	  xargs -d '\n' $(PIP) install -c constraints.txt
	@tools/system_packages usb $(BIN)/python
	@touch $@

# Two files at a time: a virtual robot keeps real time, and so does its driver.
test-hardware: $(VENV)/.stamp-drivers
	@echo "==> Testing drivers against virtual robots"
	@$(call TESTED,$(PYTEST) --numprocesses=2,-m "hardware and not slow")

# The contracts of all devices, too, in a quarter of an hour.
test-hardware-all: $(VENV)/.stamp-drivers
	@echo "==> Testing drivers against virtual robots, with their contracts"
	@OMP_NUM_THREADS=1 $(BIN)/python -m pytest -m hardware --durations=10

# Minutes in which processes start, are killed and are waited for: by itself, on a machine that does nothing else.
test-cluster: $(VENV)/.stamp-extras gl
	@echo "==> Testing Ray clusters"
	@$(BIN)/python -m pytest -m cluster --durations=10

# With the tools that are installed; the environment has what a user's has, and nothing of this folder.
WHEEL := build/wheel

test-wheel: build
	@echo "==> Building a wheel and running it in an environment of its own"
	@rm -rf $(WHEEL) packages/*/build && $(PIP) wheel --no-build-isolation --no-deps --wheel-dir $(WHEEL) .
	@$(PIP) wheel --no-deps --wheel-dir $(WHEEL) packages/rcs-data
	@$(BIN)/python -m venv $(WHEEL)/venv
	@$(WHEEL)/venv/bin/python -m pip -qq --disable-pip-version-check install -c constraints.txt $(WHEEL)/*.whl
	@$(WHEEL)/venv/bin/python -I tools/smoke.py
	@echo "==> Running the wheel of rcs-data by itself: with the oldest Python at hand and the oldest packages that it takes"
	@oldest=$$(sed -n 's/^  "\([a-z0-9-]*\)>=\([0-9.]*\)".*/\1==\2/p' packages/rcs-data/pyproject.toml) && \
	  for python in python3.10 python3.11; do $$python -m venv $(WHEEL)/data 2>/dev/null && break; done || \
	  { $(BIN)/python -m venv $(WHEEL)/data && oldest=; echo "    No Python 3.10 or 3.11: with this one, and the newest packages"; }; \
	  $(WHEEL)/data/bin/python -m pip -qq --disable-pip-version-check install $(WHEEL)/rcs_data-*.whl $$oldest && \
	  $(WHEEL)/data/bin/python -I tools/smoke_data.py

# A line per reader: its environment, the program that reads, what it reads. Left where they are: environments, data.
INTEROP := build/interop
READERS := \
  lerobot-0.4.4:read_lerobot_v3.py:lerobot-v3 \
  lerobot-0.4.4:read_lerobot_v3.py:lerobot-v3-av1 \
  lerobot-0.3.3:read_lerobot_v21.py:lerobot-v2.1 \
  lerobot-0.3.3:read_lerobot_v21.py:gr00t \
  tfds:read_rlds.py:rlds \
  tfds:read_rlds.py:varied/rlds \
  robomimic:read_robomimic.py:robomimic \
  robomimic:read_robomimic.py:varied/robomimic

# π0 is served where there is a Python 3.12, which LeRobot 0.5 wants; PYTHON312 names one that is not on the path.
PYTHON312 ?= python3.12

# A line per wire of somebody else: its environment, the program that asks and serves both ways.
WIRES := openpi:ask_through_wires.py

$(INTEROP)/%/.stamp: tests/interop/requirements-%.txt
	@echo "==> Making $(INTEROP)/$*"
	@tools/reader_environment $(BIN)/python $*

$(INTEROP)/lerobot-0.5.1/.stamp: tests/interop/requirements-lerobot-0.5.1.txt
	@$(PYTHON312) -c '' 2>/dev/null || echo "==> There is no $(PYTHON312); the test of π0 is skipped"
	@! $(PYTHON312) -c '' 2>/dev/null || { echo "==> Making $(INTEROP)/lerobot-0.5.1"; \
	  tools/reader_environment $(PYTHON312) lerobot-0.5.1; }

test-interop: build gl $(foreach r,$(READERS),$(INTEROP)/$(firstword $(subst :, ,$(r)))/.stamp) test-wires sims
	@echo "==> Collecting and exporting"
	@mkdir -p $(INTEROP)/data && $(BIN)/python tests/interop/make_exports.py $(INTEROP)/data \
	  $(filter-out varied/%,$(sort $(foreach r,$(READERS),$(lastword $(subst :, ,$(r))))))
	@$(BIN)/python tests/interop/make_varied.py $(INTEROP)/data/varied
	@set -e; for reader in $(READERS); do \
	  name=$${reader%%:*}; rest=$${reader#*:}; program=$${rest%%:*}; format=$${rest#*:}; \
	  echo "==> Reading $$format with $$name"; \
	  export=$(INTEROP)/data/$$format; \
	  $(INTEROP)/$$name/bin/python tests/interop/$$program $$export $$(dirname $$export)/expected \
	    >$$export.log 2>&1 || { cat $$export.log; exit 1; }; \
	  tail -n 1 $$export.log; \
	done
	@echo "==> Reading a dataset with Hugging Face's datasets, as docs/layout.md does"
	@{ sed -n '/^import datasets/,/^```/p' docs/layout.md | sed '/^```/d; s|datasets/plain|$(INTEROP)/data/source|'; \
	  echo 'assert set(steps["episode"]) == {"000000", "000001", "000002"}, steps'; } | \
	  HF_HOME=$(INTEROP)/data/hf $(INTEROP)/lerobot-0.4.4/bin/python -
	@echo "==> Importing what TensorFlow Datasets writes"
	@rm -rf $(INTEROP)/data/tfds && mkdir -p $(INTEROP)/data/tfds
	@$(INTEROP)/tfds/bin/python tests/interop/write_rlds.py $(INTEROP)/data/tfds >$(INTEROP)/data/tfds.log 2>&1 || \
	  { cat $(INTEROP)/data/tfds.log; exit 1; }
	@$(BIN)/python tests/interop/import_rlds.py $(INTEROP)/data/tfds
	@echo "==> Importing what LeRobot writes"
	@set -e; for name in lerobot-0.4.4 lerobot-0.3.3; do \
	  data=$(INTEROP)/data/by-$$name; rm -rf $$data; \
	  $(INTEROP)/$$name/bin/python tests/interop/write_lerobot.py $$data >$$data.log 2>&1 || { cat $$data.log; exit 1; }; \
	  $(BIN)/python tests/interop/import_lerobot.py $$data; \
	  $(INTEROP)/$$name/bin/python tests/interop/read_lerobot_again.py $$data-again 2>$$data.log || { cat $$data.log; exit 1; }; \
	done
	@$(MAKE) $(INTEROP)/lerobot-0.5.1/.stamp
	@echo "==> Serving policies of other projects, and running policies in their simulators"
	@$(BIN)/python -m pytest tests/interop -m interop --durations=5

# Simulators exclude each other's MuJoCo, and need no more than vlagents beside them.
SIMULATORS := libero maniskill metaworld vla-eval

# ManiSkill needs a Vulkan driver; where Debian's packages have none that is new enough, its tests are skipped.
.PHONY: sims
sims: build $(foreach s,$(SIMULATORS),$(INTEROP)/$(s)/.stamp)
	@for name in $(SIMULATORS); do \
	  $(INTEROP)/$$name/bin/python -m pip -qq --disable-pip-version-check install --no-deps -e packages/vlagents || exit 1; \
	done
	@[ -e $(INTEROP)/maniskill/vulkan/lvp_icd.json ] || tools/vulkan_driver $(INTEROP)/maniskill/vulkan || true

.PHONY: test-wires
test-wires: build $(foreach w,$(WIRES),$(INTEROP)/$(firstword $(subst :, ,$(w)))/.stamp)
	@set -e; for wire in $(WIRES); do \
	  name=$${wire%%:*}; program=$${wire#*:}; \
	  echo "==> Asking and serving over the wire of $$name"; \
	  $(BIN)/python tests/interop/$$program $(INTEROP)/$$name/bin/python; \
	done

# --- Checks ----------------------------------------------------------------------------------------------------------

check: build
	@echo "==> Format of Python";  $(BIN)/ruff format --quiet --diff .
	@echo "==> Lint";              $(BIN)/ruff check --quiet .
	@echo "==> Types";             $(BIN)/basedpyright --warnings
	@echo "==> Import layers";     $(BIN)/lint-imports --no-logo 2>&1 || exit 1
	@echo "==> Format of C++";     $(BIN)/clang-format --dry-run -Werror $(CXX_FILES)
	@echo "==> Stubs";             $(STUBGEN) build/_core.pyi && \
	  { diff -u $(STUB) build/_core.pyi || { echo "$(STUB) is stale; run: make stubs"; exit 1; }; }
	@echo "==> All checks passed"

format: build
	@$(BIN)/ruff check --quiet --select I --fix . ; $(BIN)/ruff format --quiet .
	@$(BIN)/clang-format -i $(CXX_FILES)

stubs: build
	@$(STUBGEN) $(STUB)

clean:
	@rm -rf build dist packages/*/build packages/*/dist .ruff_cache .import_linter_cache .hypothesis .coverage .coverage.*
	@rm -rf __pycache__ .pytest_cache packages/*/.pytest_cache
	@find core src tests examples tools benchmarks packages -name __pycache__ -type d -exec rm -rf {} +
	@rm -f $(VENV)/.stamp-built
