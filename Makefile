# `make demo` and `make test` set up everything in .venv; they need Python 3.11 or newer and make.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV := .venv
BIN := $(VENV)/bin
# Most modules that are installed are never imported: those that are compile then.
INSTALL := $(BIN)/python -m pip install --quiet --no-compile --editable
# Where the environment forbids to keep them, as in containers, each process would compile them anew.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test tests test-rounding test-thorough test-slow lint validate paper beyond benchmark leaderboard learned docs release clean

demo: $(VENV)/installed
	$(BIN)/periscopy demo --out out/demo

# Types are checked beside the tests: both on one core first would leave the others idle.
test: $(VENV)/installed-dev
	$(MAKE) --no-print-directory --jobs lint tests

tests: $(VENV)/installed-dev
	$(BIN)/python -m pytest -q -n auto --maxprocesses 4 --dist worksteal

# The tests of `test` on the kernels of an old processor, which round otherwise: no fused
# multiply-adds, no wide vectors. NumPy warns of the features that it or the machine does not have.
test-rounding: $(VENV)/installed-dev
	OPENBLAS_CORETYPE=Nehalem NUMBA_CPU_NAME=nehalem NUMBA_CPU_FEATURES= \
	NPY_DISABLE_CPU_FEATURES="X86_V3 X86_V4 AVX512_ICL AVX512_SPR AVX2 FMA3" \
	$(BIN)/python -m pytest -q -n auto --maxprocesses 4 --dist worksteal -W ignore::ImportWarning

# What takes seconds a test, as statistics over many draws and the commands' longer ways.
test-thorough: $(VENV)/installed-dev
	$(BIN)/python -m pytest -q -m thorough -n auto --maxprocesses 4 --dist worksteal

# Minutes of rendering: every claim about accuracy at full size.
test-slow: $(VENV)/installed-dev
	$(BIN)/python -m pytest -q -m slow

lint: $(VENV)/installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# The numbers that prove the rendering and the solver, as one table.
validate: $(VENV)/installed-experiments
	$(BIN)/python -m experiments.validation --out out/validation

# Every figure and table of the paper as one page: out/paper/index.html.
paper: $(VENV)/installed-experiments
	$(BIN)/python -m experiments.paper --out out/paper

# What goes beyond the paper, as another: out/beyond/index.html. It reads what the paper rendered.
beyond: $(VENV)/installed-experiments
	$(BIN)/python -m experiments.beyond --out out/beyond --rendered out/paper/rendered

# What fine grids cost, seconds and memory: out/benchmark/index.html.
benchmark: $(VENV)/installed-experiments
	$(BIN)/python -m experiments.benchmarks --out out/benchmark

# Every method on the frozen suites: out/leaderboard/index.html; about half an hour on two cores.
leaderboard: $(VENV)/installed-leaderboard
	$(BIN)/python -m benchmarks run --out out/leaderboard

# Weights of your own for experiments/learned/unrolled.py: out/learned/trained/unrolled.npz.
# PHOTOGRAPHS=FOLDER to learn from, too.
learned: $(VENV)/installed-experiments
	$(INSTALL) '.[learned]'
	mkdir -p out/learned
	cp experiments/learned/training.yaml out/learned
	$(BIN)/python -m experiments.learned.pictures --out out/learned/pictures $(if $(PHOTOGRAPHS),--also $(PHOTOGRAPHS))
	$(BIN)/periscopy dataset out/learned/training.yaml --out out/learned/photographs.zarr
	$(BIN)/python -m experiments.learned.samples out/learned/photographs.zarr --out out/learned/samples
	$(BIN)/python -m experiments.learned.train out/learned/samples --out out/learned/trained

# The pages and the gallery, whose scripts run: out/docs/index.html. A warning is an error.
docs: $(VENV)/installed-docs
	$(BIN)/python -m sphinx -W --keep-going -q -b html -d out/docs/.doctrees docs out/docs

# Wheel and source distribution, each used where it is installed alone.
release:
	$(PYTHON) release/check.py

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/installed: pyproject.toml | $(BIN)/python
	$(INSTALL) '.[llvm]'
	touch $@

# Each installs all it needs at once: to build and resolve twice takes longer.
$(VENV)/installed-dev: pyproject.toml | $(BIN)/python
	$(INSTALL) '.[dev]'
	touch $(VENV)/installed $@

$(VENV)/installed-experiments: pyproject.toml | $(BIN)/python
	$(INSTALL) '.[experiments]'
	touch $(VENV)/installed $@

$(VENV)/installed-leaderboard: pyproject.toml | $(BIN)/python
	$(INSTALL) '.[leaderboard]'
	touch $(VENV)/installed $(VENV)/installed-experiments $@

$(VENV)/installed-docs: pyproject.toml | $(BIN)/python
	$(INSTALL) '.[docs]'
	touch $(VENV)/installed $@

clean:
	rm -rf docs/gallery docs/repository docs/api/names docs/api/examples
	rm -rf $(VENV) out .pytest_cache .mypy_cache .ruff_cache
