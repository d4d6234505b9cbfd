# Two commands for a newcomer: `make demo` and `make test`. Both work on a fresh clone with nothing
# but Python 3.11, pip, git and make.

PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed

# Two OpenMP pools fighting over two cores run 10 to 80 times slower: one thread per process.
export OMP_NUM_THREADS := 1

.PHONY: help demo serve test test-libcamera lint types imports pytest test-vm clean

help:
	@echo "make demo     simulated camera, real digits, changing masks; writes demo/report.png"
	@echo "make serve    the same daemon, left running on http://127.0.0.1:8787"
	@echo "make test     every check: lint, types, package arrows, tests"
	@echo "make test-processors   the numerical tests with SSE and with AVX2, on one thread and on two"
	@echo "make test-libcamera   the camera driver on the real picamera2; builds libcamera, 10 minutes"
	@echo "make test-vm  the daemon under systemd in a virtual machine; needs root, see deploy/README.md"
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

# The instructions of older processors; those of newer ones cannot be asked for. Threads that wait
# sleep, so that two of them get on on a busy machine.
SSE := OMP_WAIT_POLICY=PASSIVE ATEN_CPU_CAPABILITY=default MKL_CBWR=COMPATIBLE ONEDNN_MAX_CPU_ISA=SSE41 \
	OPENBLAS_CORETYPE=Nehalem NPY_DISABLE_CPU_FEATURES=X86_V3
AVX2 := OMP_WAIT_POLICY=PASSIVE ATEN_CPU_CAPABILITY=avx2 MKL_CBWR=AVX2 ONEDNN_MAX_CPU_ISA=AVX2 \
	OPENBLAS_CORETYPE=Haswell

.PHONY: test-processors
test-processors: numerical-SSE-1 numerical-SSE-2 numerical-AVX2-1 numerical-AVX2-2

numerical-SSE-%: $(INSTALLED)
	$(SSE) VEILCAM_TEST_THREADS=$* $(BIN)/pytest -m numerical

numerical-AVX2-%: $(INSTALLED)
	$(AVX2) VEILCAM_TEST_THREADS=$* $(BIN)/pytest -m numerical

# Root builds the image, so nothing of it may end up in the virtual environment.
test-vm: $(INSTALLED)
	PYTHONDONTWRITEBYTECODE=1 $(BIN)/python benchmarks/daemon_virtual_machine.py

clean:
	rm -rf $(VENV) demo .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
