# Two commands for a newcomer: `make demo` and `make test`. Both work on a fresh clone with nothing
# but Python 3.11, pip, git and make.

PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed

# Two OpenMP pools fighting over two cores run 10 to 80 times slower: one thread per process.
export OMP_NUM_THREADS := 1

.PHONY: help demo serve test test-libcamera lint types imports pytest test-vm mutants clean

help:
	@echo "make demo     simulated camera, real digits, changing masks; writes demo/report.png"
	@echo "make serve    the same daemon, left running on http://127.0.0.1:8787"
	@echo "make test     every check: lint, types, package arrows, tests"
	@echo "make test-libcamera   the camera driver on the real picamera2; builds libcamera, 10 minutes"
	@echo "make test-vm  the daemon under systemd in a virtual machine; needs root, see deploy/README.md"
	@echo "make mutants  would a room's tests notice a wrong module? 100 seeded edits, half an hour"
	@echo "make clean    remove what the others made"

$(INSTALLED): pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --editable '.[all,dev]'
	touch $@

demo: $(INSTALLED)
	$(BIN)/veilcamd demo --captures 250 --out demo

serve: $(INSTALLED)
	$(BIN)/veilcamd serve --simulate --port 8787

test: lint types imports pytest

# Not part of test: it needs Debian's package lists and its source of libcamera.
test-libcamera: $(INSTALLED)
	$(BIN)/python benchmarks/daemon_libcamera.py

lint: $(INSTALLED)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .

types: $(INSTALLED)
	$(BIN)/mypy

imports: $(INSTALLED)
	$(BIN)/lint-imports

pytest: $(INSTALLED)
	$(BIN)/pytest

# Root builds the image, so nothing of it may end up in the virtual environment.
test-vm: $(INSTALLED)
	PYTHONDONTWRITEBYTECODE=1 $(BIN)/python benchmarks/daemon_virtual_machine.py

# Not part of test: it runs tests a hundred times.
mutants: $(INSTALLED)
	$(BIN)/python -m tests.mutation --count 100 --seed 1 --figures benchmarks/results/house.json

clean:
	rm -rf $(VENV) demo build/mutants .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
