# Every target does its own set-up in .venv; it needs Python >= 3.11, make and a C++ compiler.
#
#   make demo         the whole chain on sample_data, and three pages of what it finds
#   make test         the quick tests, about three minutes on two cores
#   make test-all     these and the slow ones: the paper, fuzz, wheel, cluster, store, browser
#   make interop      OpenSim, movement, ezc3d, bvhio and trimesh read what is written for them (installs 1.7 GB)
#   make check        format, lint, types, quick tests
#   make coverage     the quick tests, and which lines they do not run; fails below the share in pyproject.toml
#   make wheel        a wheel of the compiled package in dist
#   make test-levels  the solvers' tests with every instruction set of this processor, and with none
#   make sanitize     the solvers' tests under the address and undefined-behaviour sanitizers (GCC)
#   make arm64        compile the kernels for arm64 (needs g++-aarch64-linux-gnu)
#   make fuzz         50,000 damaged files, configs and options, each in a separate process
#   make mutants      300 small changes of the code, each with the tests that reach it; lists what survives
#   make faults       every writing call fails with every error, and 200 kills; outputs stay whole
#   make pictures     every picture of README, docs and gallery (needs chromium; DATA=FOLDER as below)
#   make docs         write the generated pages of docs/
#   make site         the pages as a site with search, in build/site/html; every link is checked
#   make recovery     the paper's figure of exact recovery on planted instances
#   make paper        every table and figure of the paper, with an index (DATA=FOLDER as below)
#   make bench        speed relative to the previous release and other solvers; fails below a floor
#                     (DATA=FOLDER motion capture, CARS=FOLDER cars, BENCH_OPTIONS='--only CASE --quick')
#   make mocap-table  the paper's table on motion capture data, in two minutes (DATA=FOLDER takes
#                     the data from elsewhere)
#   make people       the dictionary of the package, learned anew from motion capture (DATA=FOLDER)
#   make footage      people before a camera at rest, as a detector finds them (DATA=FOLDER as above)
#   make detected     landmarks that networks detected, against their 3D truth (DATA=FOLDER as above)
#   make cars         real cars: report, meshes, a sheet of pictures, outliers (DATA=FOLDER as above)

PYTHON ?= python3
DATA ?=
PYTEST_OPTIONS ?= -n 2 --dist worksteal

# Without compiled modules on disk each process of the tests compiles its libraries anew.
unexport PYTHONDONTWRITEBYTECODE

VENV := .venv
BIN := $(VENV)/bin
TOOLS := $(VENV)/tools
RUNS := $(VENV)/runs
READY := $(VENV)/ready
SITE_READY := $(VENV)/site-ready
ALL_READY := $(VENV)/all-ready
INTEROP := $(VENV)/interop
CORE := $(wildcard shapefit/core/CMakeLists.txt $(addprefix shapefit/core/,*.?pp */*.?pp))
SHAPEFIT := $(BIN)/shapefit

# `pip install .` into this environment takes the place of what make installed there, and what runs
# in the clone then misses the compiled core: it is installed again.
ifeq ($(wildcard $(VENV)/lib/python*/site-packages/_editable_skbc_shapefit.py),)
$(shell rm -f $(RUNS) $(READY) $(ALL_READY) $(SITE_READY))
endif
SET_DATA = $(if $(DATA),--set 'data=$(DATA)')

.PHONY: demo test test-all coverage interop fuzz mutants faults test-levels sanitize arm64 wheel site pictures check format-check lint types docs mocap-table recovery paper people footage detected from-2d cars bench clean

demo: $(RUNS)
	$(SHAPEFIT) fit sample_data/openpose --frame-rate 25 --image-size 1280x720 --focal 1100 \
	    -o results/demo/walk.h5
	$(SHAPEFIT) view results/demo/walk.h5 -o results/demo/walk.html
	$(call chain,demo)
	$(SHAPEFIT) learn-dict -c configs/demo/cars/learn-dict.yaml
	$(SHAPEFIT) fit -c configs/demo/cars/fit.yaml
	$(SHAPEFIT) eval -c configs/demo/cars/eval.yaml
	@echo "Meshes of cars are in results/demo/cars/meshes, a report in results/demo/cars/report."
	$(SHAPEFIT) view results/demo/result.h5 --truth sample_data/people_test.h5 \
	    -o results/demo/people.html
	$(SHAPEFIT) view results/demo/cars/result.h5 -d results/demo/cars/dictionary.h5 \
	    --truth sample_data/cars.h5 --match true_model -o results/demo/cars.html
	@echo
	@echo "Open these first, in a browser:"
	@echo "  $(CURDIR)/results/demo/walk.html    two people who walk, from a detector's files"
	@echo "  $(CURDIR)/results/demo/people.html  people from all sides, beside their true shapes"
	@echo "  $(CURDIR)/results/demo/cars.html    cars with their meshes, beside the true models"

# $(call name_figures,FOLDER): the page of a report, and which of its figures are the paper's.
define name_figures
@echo
@echo "Open this in a browser:"
@echo "  $(CURDIR)/$(1)/report.html"
@echo "It has the paper's bars of sequences (also sequences.svg beside it) and its box plots (errors.svg)."
endef

# $(call paper_fits,NAMES): a fit in which single items fail (exit code 1) lists them; the others are used.
paper_fits = for fit in $(1); do \
    $(SHAPEFIT) fit -c configs/paper/fit-$$fit.yaml || [ $$? -eq 1 ] || exit; done

TABLE_FITS := convex alternate alternate-plus pmp

mocap-table: $(RUNS)
	$(SHAPEFIT) learn-dict -c configs/mocap/learn-dict.yaml $(SET_DATA)
	$(SHAPEFIT) learn-dict -c configs/paper/learn-pmp.yaml $(SET_DATA)
	$(SHAPEFIT) project -c configs/mocap/project.yaml $(SET_DATA)
	$(call paper_fits,$(TABLE_FITS))
	$(SHAPEFIT) eval -c configs/mocap/eval.yaml $(SET_DATA) || [ $$? -eq 1 ]
	@echo
	@$(BIN)/python -m experiments published mocap results/mocap/report
	@echo
	$(call name_figures,results/mocap/report)

recovery: $(RUNS)
	$(BIN)/python -m experiments recovery results/recovery

FURTHER_FITS := alternate-six-views alternate-nonnegative refine global mean-shape

paper: mocap-table
	$(call paper_fits,$(FURTHER_FITS))
	$(SHAPEFIT) learn-dict -c configs/people/learn-dict.yaml $(SET_DATA)
	$(SHAPEFIT) fit -c configs/people/fit.yaml
	$(SHAPEFIT) fit -c configs/mocap/fit-sequences.yaml
	$(SHAPEFIT) eval -c configs/paper/eval.yaml $(SET_DATA) || [ $$? -eq 1 ]
	$(BIN)/python -m experiments published mocap results/paper/mocap
	$(BIN)/python -m experiments recovery results/paper/recovery
	$(BIN)/python -m experiments sensitivity results/paper $(if $(DATA),--data '$(DATA)')
	$(BIN)/python -m experiments index results/paper
	$(call name_figures,results/paper/mocap)

people: $(RUNS)
	$(SHAPEFIT) learn-dict -c configs/people/learn-box.yaml $(SET_DATA)
	$(BIN)/python -m experiments.people.further_joints results/people/box.h5 \
	    $(or $(DATA),../shared/data/mocap)/bodies31_24fps.h5 results/people/whole.h5 '13_*'
	$(BIN)/python -m experiments.people.ship_dictionary results/people/whole.h5 shapefit/data/people.h5

footage: $(RUNS)
	$(BIN)/python -m benchmarks.footage $(if $(DATA),--data '$(DATA)')

detected: $(RUNS)
	$(BIN)/python -m benchmarks.detected $(if $(DATA),--data '$(DATA)')

from-2d: $(RUNS)
	$(BIN)/python -m benchmarks.from_2d $(if $(DATA),--data '$(DATA)')

CAR_METHODS := $(basename $(notdir $(wildcard configs/cars/methods/*.yaml)))

cars: $(RUNS)
	$(SHAPEFIT) learn-dict -c configs/cars/learn-dict.yaml $(SET_DATA)
	$(SHAPEFIT) fit -c configs/cars/fit.yaml $(SET_DATA) || [ $$? -eq 1 ]
	for method in $(CAR_METHODS); do \
	    $(SHAPEFIT) fit -c configs/cars/methods/$$method.yaml $(SET_DATA) || [ $$? -eq 1 ] || exit; done
	$(SHAPEFIT) eval -c configs/cars/eval.yaml $(SET_DATA) || [ $$? -eq 1 ]
	$(BIN)/python -m experiments published cars results/cars/report
	$(BIN)/python -m experiments bodies results/cars/bodies $(if $(DATA),--data '$(DATA)')
	$(BIN)/python -m experiments cars results/cars $(if $(DATA),--data '$(DATA)')
	$(SHAPEFIT) view results/cars/result.h5 -d results/cars/dictionary.h5 -o results/cars/sheet.png
	@echo "The report, meshes, outliers and sheet.png are in results/cars, sedan, SUV and pick-up in results/cars/bodies."

test: $(READY)
	$(BIN)/python -m pytest -m 'not slow' $(PYTEST_OPTIONS)

# The tests of the page need these packages; without them, they are skipped.
BROWSER_PACKAGES := chromium chromium-driver nodejs
test-all: test $(ALL_READY)
	@command -v chromium >/dev/null && command -v chromedriver >/dev/null && command -v node >/dev/null \
	    || echo "No browser: its tests are skipped. To run them: apt-get install $(BROWSER_PACKAGES)"
	$(BIN)/python -m pytest -m slow $(PYTEST_OPTIONS)

# In one process: some of those that tests start must import, or write, nothing else.
coverage: $(READY)
	$(BIN)/coverage run -m pytest -m 'not slow' -n 0
	$(BIN)/coverage report

interop: $(READY) $(INTEROP)/ready
	SHAPEFIT_REQUIRE_INTEROP=1 $(BIN)/python -m pytest -m interop $(PYTEST_OPTIONS) tests/interop

wheel: $(READY)
	SHAPEFIT_LEVELS=all $(BIN)/python -m pip wheel --quiet --disable-pip-version-check --no-deps \
	    --no-build-isolation -C 'build-dir=build/{wheel_tag}' --wheel-dir dist .
	@echo "The wheel is in dist."

# That of the shipped dictionary needs the experiments, which are not installed.
SOLVER_TESTS := tests/convex tests/lifting tests/dictionary --ignore=tests/dictionary/test_people.py
# $(call second_install,NAME,DEFINITION): the core with its own setting, in build/NAME.
second_install = $(BIN)/python tools/second_install.py build/$(1) . \
    -C build-dir=build/$(1)/cmake -C install.strip=false -C cmake.define.$(2)

test-levels: $(ALL_READY)
	$(call second_install,plain,SHAPEFIT_LEVELS=plain)
	build/plain/bin/python -P -m pytest $(PYTEST_OPTIONS) $(SOLVER_TESTS)
	$(call second_install,levels,SHAPEFIT_LEVELS=all)
	for level in $$(build/levels/bin/python -P -c 'from shapefit import core; print(*core.LEVELS)'); do \
	    SHAPEFIT_LEVEL=$$level build/levels/bin/python -P -m pytest $(PYTEST_OPTIONS) $(SOLVER_TESTS) \
	        || exit; done

# Quick tests that reach each kernel. Python itself never frees all of its memory, so leaks are not
# checked. -s shows the report.
SANITIZED_TESTS := tests/core/test_core.py tests/convex tests/lifting/test_methods.py tests/io/test_csv_cells.py \
    $(addprefix tests/dictionary/,test_learning.py test_mixture.py from_2d/test_model.py) \
    $(addprefix tests/lifting/,test_global_optimum.py test_consensus.py perspective posterior sequences shared_rotation)
SANITIZERS = $(shell for library in libasan.so libubsan.so libstdc++.so.6; do \
    $(CXX) -print-file-name=$$library; done)
sanitize: $(ALL_READY)
	$(call second_install,sanitized,SHAPEFIT_SANITIZE=ON)
	LD_PRELOAD='$(SANITIZERS)' ASAN_OPTIONS=detect_leaks=0 UBSAN_OPTIONS=print_stacktrace=1 \
	    PYTHONMALLOC=malloc build/sanitized/bin/python -P -m pytest -q -s -n 0 -m 'not slow' $(SANITIZED_TESTS)

arm64: $(READY)
	$(BIN)/cmake -S shapefit/core -B build/arm64 -G Ninja -DCMAKE_MAKE_PROGRAM='$(CURDIR)/$(BIN)/ninja' \
	    -DCMAKE_TOOLCHAIN_FILE='$(CURDIR)/tools/arm64.cmake' \
	    -DPython_EXECUTABLE='$(CURDIR)/$(BIN)/python' \
	    -Dnanobind_DIR="$$($(BIN)/python -m nanobind --cmake_dir)"
	$(BIN)/cmake --build build/arm64 --target plain

check: format-check lint types test

FORMATTED := $(shell find shapefit/core shapefit/viewer/scripts -name '*.[ch]pp' -o -name '*.js')

format-check: $(READY)
	$(BIN)/ruff format --check .
	$(BIN)/clang-format --dry-run -Werror $(FORMATTED)

lint: $(READY)
	$(BIN)/ruff check .

types: $(READY)
	$(BIN)/mypy shapefit cli benchmarks experiments tools

fuzz: $(READY)
	$(BIN)/python -m tests.fuzz --past
	$(BIN)/python -m tests.fuzz --cases 50000

mutants: $(READY)
	$(BIN)/python tools/mutants.py $(MUTANTS_OPTIONS)

faults: $(ALL_READY)
	$(BIN)/python -m tests.fuzz.faults
	$(BIN)/python -m tests.fuzz.faults --kill 200

# The figures of motion capture are drawn anew where its data are.
MOCAP := $(or $(DATA),../shared/data/mocap)
pictures: demo recovery $(if $(wildcard $(MOCAP)/subject13_24fps.h5),mocap-table) $(ALL_READY)
	$(BIN)/python -m tools.page_pictures

docs: $(READY)
	$(BIN)/python tools/generate.py

site: $(SITE_READY)
	@$(BIN)/python tools/site.py
	@echo "The site is in build/site/html; open index.html there. Its search needs a server:"
	@echo "  $(BIN)/python -m http.server --directory build/site/html"

bench: $(ALL_READY)
	$(BIN)/python -m benchmarks.bench $(if $(DATA),--data '$(DATA)') $(if $(CARS),--cars '$(CARS)') $(BENCH_OPTIONS)

clean:
	rm -rf $(VENV) build dist results

# $(call chain,NAME): learn, project, fit and evaluate with configs/NAME into results/NAME.
define chain
$(SHAPEFIT) learn-dict -c configs/$(1)/learn-dict.yaml $(SET_DATA)
$(SHAPEFIT) project -c configs/$(1)/project.yaml $(SET_DATA)
$(SHAPEFIT) fit -c configs/$(1)/fit.yaml $(SET_DATA)
$(SHAPEFIT) eval -c configs/$(1)/eval.yaml $(SET_DATA)
@echo "The results are in results/$(1), the report with tables and figures is results/$(1)/report/report.html."
endef

INSTALL = $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile --constraint constraints.txt
INSTALL_SHAPEFIT = $(INSTALL) --no-build-isolation --editable

# The programs that read our files, in an environment of their own.
$(INTEROP)/ready: $(TOOLS)
	@echo "Installing OpenSim, movement, ezc3d, bvhio and trimesh into $(INTEROP), 1.7 GB."
	@$(PYTHON) -m venv $(INTEROP)
	@$(INTEROP)/bin/python -m pip install --quiet --disable-pip-version-check opensim ezc3d bvhio trimesh movement h5netcdf
	@touch $@

# What the slow tests and the benchmarks need besides: independent solvers, a cluster, a store.
$(ALL_READY): $(READY)
	@echo "Installing what the slow tests need into $(VENV), about a minute."
	@$(INSTALL_SHAPEFIT) '.[dev,test-all]'
	@touch $@

# Rebuilt when the dependencies or the sources of the compiled core change, not otherwise.
$(READY): $(TOOLS) $(CORE)
	@echo "Installing shapefit with the developers' tools into $(VENV), a minute or two."
	@$(INSTALL_SHAPEFIT) '.[dev]'
	@touch $(RUNS) $@

$(SITE_READY): $(RUNS)
	@$(INSTALL_SHAPEFIT) '.[plots,site]'
	@touch $@

# Everything that a run needs, without the developers' tools. Python compiles modules at first use.
$(RUNS): $(TOOLS) $(CORE)
	@echo "Installing shapefit into $(VENV), about half a minute."
	@$(INSTALL_SHAPEFIT) '.[plots]'
	@touch $@

# The tools that build the core stay installed, so that only changed sources are compiled.
$(TOOLS): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	    { echo "shapefit needs Python >= 3.11; name one: make $(MAKECMDGOALS) PYTHON=python3.12" >&2; exit 1; }
	@echo "Making a Python environment in $(VENV), a few seconds."
	@$(PYTHON) -m venv $(VENV)
	@$(INSTALL) cmake ninja nanobind scikit-build-core
	@touch $@
