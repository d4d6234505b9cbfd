# Two commands for a newcomer: `make demo` and `make test`. Both work on a fresh clone with nothing
# but Python (3.11 or later), pip, git and make.

VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed

# A name may be there and fail when it is run, as pyenv's shims do, so each is run.
PYTHONS := python3.13 python3.12 python3.11 python3
RECENT := import sys; sys.exit(sys.version_info < (3, 11))
PYTHON ?= $(shell for name in $(PYTHONS); do \
	$$name -c '$(RECENT)' 2>/dev/null && echo $$name && break; done)

# The torch of pip's usual index brings gigabytes of CUDA; this index has the same versions as
# builds for the CPU. pip looks into both and takes 2.13.0+cpu before 2.13.0, since a local version
# sorts above the version without it (PEP 440). Where the index does not answer, or TORCH_INDEX is
# empty, torch comes from where pip is set up to look. The alarm also ends a slow look-up of the name.
TORCH_INDEX ?= https://download.pytorch.org/whl/cpu
ANSWERS := import signal, sys, urllib.request; signal.alarm(5); urllib.request.urlopen(sys.argv[1])

# Two OpenMP pools fighting over two cores run 10 to 80 times slower: one thread per process.
export OMP_NUM_THREADS := 1
# Some containers ask for no byte code to be kept: then every process of the tests, and every command
# that they start, would compile anew all that it imports.
unexport PYTHONDONTWRITEBYTECODE

# What is freed is kept: to have a field's memory back from the kernel costs as much as to compute it.
export MALLOC_TRIM_THRESHOLD_ := 268435456
export MALLOC_MMAP_THRESHOLD_ := 268435456

# Tests in as many processes as cores, or in twice as many where they wait for daemons a third of
# their time. A worker that is done takes over the last tests of another, so that tests of one file,
# which share what is slow to make, mostly stay together.
COMPUTING := $(BIN)/pytest -n 2 --dist worksteal
WAITING := $(BIN)/pytest -n 4 --dist worksteal

.PHONY: docs help demo serve bundles check test stress siege test-libcamera lint types layers fast pytest test-vm test-vm-arm64 mutants clean

help:
	@echo "make demo     simulated camera, real digits, changing masks; writes demo/report.png"
	@echo "make serve    a simulated camera that looks by itself: open http://127.0.0.1:8787"
	@echo "make check    lint, types, layers and the fast unit tests: before every commit"
	@echo "make test     the same with all tests: before every merge"
	@echo "make test-page   the page in a browser: needs Chromium, on Debian apt install chromium"
	@echo "make test-thorough   the tests that take longest, which make test leaves out: before every merge"
	@echo "make stress   fuzzing, soak and long fits: hours; before a release"
	@echo "make oracle   1,000 random plans against exact light: an hour or two; goes on where it stopped"
	@echo "make siege    attackers and faults against a simulated daemon: up to an hour; before a release"
	@echo "make test-processors   the numerical tests with SSE and with AVX2, on one thread and on two"
	@echo "make suite-SSE, suite-AVX2   all tests with the instructions of older processors"
	@echo "make test-libcamera   the camera driver on the real picamera2; builds libcamera, 10 minutes"
	@echo "make test-vm  the daemon under systemd in a virtual machine; needs root, see deploy/README.md"
	@echo "make test-vm-arm64  the same with the processor of a Raspberry Pi: hours"
	@echo "make deb      Debian packages in build/debian, for arm64 and amd64; see deploy/README.md"
	@echo "make test-deb  the package in a root of Debian 12; needs root, see deploy/README.md"
	@echo "make test-arm64  the same on an emulated processor, in Debian 12 and 13: an hour"
	@echo "make test-container   the container of a simulated daemon: builds, starts and asks it; needs root"
	@echo "make bundles  both shipped bundles again, from MNIST in the folder DATA"
	@echo "make test-clean-root  make demo in a root of Debian 13 with Python, git and make alone; needs root"
	@echo "make public-types   how much of the SDK's surface has known types, as pyright counts it"
	@echo "make accuracy  error against time of every way to compute light, drawn into build/accuracy"
	@echo "make mutants  would a room's tests notice a wrong module? 100 seeded edits, half an hour"
	@echo "make docs     the documentation as a site in build/site"
	@echo "make clean    remove what the others made"

$(INSTALLED): pyproject.toml
	@python='$(PYTHON)'; \
	if ! "$${python:-false}" -c '$(RECENT)' 2>/dev/null; then \
		echo "make: $${python:-each of $(PYTHONS)} is missing, fails or is older than Python 3.11:" \
			"install one, or say which to take with PYTHON=PATH" >&2; exit 1; \
	elif ! "$$python" -c 'import ensurepip, venv' 2>/dev/null; then \
		echo "make: $$python has no module venv, or no pip for it: on Debian and Ubuntu" \
			"install python3-venv, or say which Python to take with PYTHON=PATH" >&2; exit 1; \
	fi; \
	"$$python" -m venv $(VENV)
	@index='$(TORCH_INDEX)'; \
	if [ "$$index" ] && ! $(BIN)/python -c '$(ANSWERS)' "$$index/torch/" >/dev/null 2>&1; then \
		echo "make: no answer from $$index: torch comes from where pip looks otherwise"; index=; \
	fi; \
	$(BIN)/python -m pip install $${index:+--extra-index-url "$$index"} --editable '.[all,dev]'
	touch $@

demo: $(INSTALLED)
	$(BIN)/veilcamd demo --captures 250 --out demo

serve: $(INSTALLED)
	$(BIN)/veilcamd serve --simulate --scene-api --watch 2/s --port 8787 \
		--bundle server/veilcam_server/demo_data/fresh.veilcam

# Both shipped bundles again: DATA is the folder of MNIST. demo_data/README.md has minutes and digests.
DEMO := server/veilcam_server/demo_data
bundles: $(INSTALLED)
	$(BIN)/veilcam-train keyring --data $(DATA) --pairs 6 --config $(DEMO)/keyring.toml \
		--threads 1 --out $(DEMO)/keyring.veilcam
	$(BIN)/veilcam-train fit --data $(DATA) --config $(DEMO)/fresh.toml --threads 1 --out build/fresh
	cp build/fresh/model.veilcam $(DEMO)/fresh.veilcam

check: lint types layers fast

# Checks of the source take one core, and the tests begin on the other meanwhile.
test: lint
	$(MAKE) --jobs 2 pytest types layers

# The long form of what the tests do for seconds.
stress: $(INSTALLED)
	$(BIN)/python -m tests.siege api-fuzz bundle-fuzz picture-fuzz soak
	$(WAITING) --timeout 0 --long -m long

# The long form of what a test does for seconds, on a machine that does nothing else meanwhile.
siege: $(INSTALLED)
	$(BIN)/python -m tests.siege --figures benchmarks/results/siege.json

# The page in Chromium, Debian's. Not part of test, since who changes optics needs no browser; CI runs
# it. One browser and one daemon for all of it, so it runs in one process.
.PHONY: test-page
test-page: $(INSTALLED)
	$(BIN)/pytest -m page tests/page

# Not part of test: it needs Debian's package lists and its source of libcamera.
test-libcamera: $(INSTALLED)
	$(BIN)/python tests/system/real_picamera2/run.py

# Lint, types and unit tests with a second Python. It gets no torch, which comes as gigabytes of CUDA for
# most of them: the tests of client and bridge are run, and mypy checks all code for that version.
SECOND := 3.13
SECOND_ENV := build/python$(SECOND)
.PHONY: test-second-python
test-second-python: $(INSTALLED)
	@for each in python$(SECOND) $(HOME)/.pyenv/versions/$(SECOND)*/bin/python; do \
		if "$$each" -c 'import sys; sys.exit("%d.%d" % sys.version_info[:2] != "$(SECOND)")' 2>/dev/null; \
		then python="$$each"; break; fi; done; \
	if [ -z "$${python:-}" ]; then \
		echo "make: there is no Python $(SECOND) here: lint, types and tests ran with the first alone"; exit 0; \
	fi; \
	set -e; "$$python" -m venv $(SECOND_ENV); \
	$(SECOND_ENV)/bin/pip install --quiet '.[server,mqtt,discover]' ruff pytest pytest-timeout pytest-xdist hypothesis \
		pillow jsonschema; \
	$(SECOND_ENV)/bin/ruff check .; \
	$(BIN)/mypy --python-version $(SECOND); \
	$(SECOND_ENV)/bin/pytest -n 2 --dist worksteal -p no:cacheprovider tests/unit

lint: $(INSTALLED)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .

types: $(INSTALLED)
	$(BIN)/mypy

layers: $(INSTALLED)
	$(BIN)/lint-imports

# Not part of test: pyright brings Node.js along, which it fetches when it runs first.
.PHONY: public-types
public-types: $(INSTALLED)
	$(BIN)/python -m benchmarks.client.types

fast: $(INSTALLED)
	$(COMPUTING) -m "not slow and not thorough and not numerical" tests/unit

pytest: $(INSTALLED)
	$(WAITING) -m "not thorough and not system and not page"

# The tests that take most: two thirds of the time of all.
.PHONY: test-thorough
test-thorough: $(INSTALLED)
	$(WAITING) -m thorough

# Plans against exact light. Not part of test, which takes forty; it goes on where it stopped.
.PHONY: oracle
oracle: $(INSTALLED)
	$(BIN)/python -m tests.oracle.run --jobs 1000 --chart build/oracle.png

# The instructions of older processors; those of newer ones cannot be asked for. Threads that wait
# sleep, so that two of them get on on a busy machine.
SSE := OMP_WAIT_POLICY=PASSIVE ATEN_CPU_CAPABILITY=default MKL_CBWR=COMPATIBLE ONEDNN_MAX_CPU_ISA=SSE41 \
	OPENBLAS_CORETYPE=Nehalem NPY_DISABLE_CPU_FEATURES=X86_V3
AVX2 := OMP_WAIT_POLICY=PASSIVE ATEN_CPU_CAPABILITY=avx2 MKL_CBWR=AVX2 ONEDNN_MAX_CPU_ISA=AVX2 \
	OPENBLAS_CORETYPE=Haswell

.PHONY: test-processors
test-processors: numerical-SSE-1 numerical-SSE-2 numerical-AVX2-1 numerical-AVX2-2

numerical-SSE-%: $(INSTALLED)
	$(SSE) VEILCAM_TEST_THREADS=$* $(COMPUTING) -m numerical

numerical-AVX2-%: $(INSTALLED)
	$(AVX2) VEILCAM_TEST_THREADS=$* $(COMPUTING) -m numerical

# All tests; `python -m benchmarks.capabilities` runs those below the machine's best, and `test`.
.PHONY: suite-SSE suite-AVX2
suite-SSE: $(INSTALLED)
	$(SSE) $(WAITING) -m "not system and not page"

suite-AVX2: $(INSTALLED)
	$(AVX2) $(WAITING) -m "not system and not page"

# Root builds the image, so nothing of it may end up in the virtual environment.
test-vm: $(INSTALLED)
	PYTHONDONTWRITEBYTECODE=1 $(BIN)/python tests/system/virtual_machine/run.py

test-vm-arm64: $(INSTALLED)
	PYTHONDONTWRITEBYTECODE=1 $(BIN)/python tests/system/virtual_machine/run.py --architecture arm64

.PHONY: deb test-deb
deb: $(INSTALLED)
	$(BIN)/python -m deploy.debian.build

# Not part of test: it resolves a device's packages, and makes a root of Debian.
test-deb: $(INSTALLED)
	$(BIN)/python -m tests.system.debian_package

# The same on an emulated processor, in Debian 12 and 13: wants qemu-user-static and arch-test.
.PHONY: test-arm64
test-arm64: $(INSTALLED)
	$(BIN)/python -m tests.system.debian_package --architecture arm64
	$(BIN)/python -m tests.system.debian_package --architecture arm64 --suite trixie

# Not part of test: both download torch anew, for roots of Debian, and want root.
.PHONY: test-container test-clean-root
test-container: $(INSTALLED)
	$(BIN)/python -m tests.system.container

test-clean-root: $(INSTALLED)
	$(BIN)/python -m tests.system.clean_root demo

# Not part of test: error against time of every method, in minutes.
.PHONY: accuracy
accuracy: $(INSTALLED)
	$(BIN)/python -m benchmarks.accuracy --out build/accuracy

# Not part of test: the attacks of docs/privacy.md, in some 40 minutes, and the page.
.PHONY: privacy-page
DIGITS ?= data/mnist
privacy-page: $(INSTALLED)
	time -p $(BIN)/python -m benchmarks.privacy.listener --figures benchmarks/results/privacy.json
	time -p $(BIN)/python -m benchmarks.privacy.scores --data $(DIGITS) --figures benchmarks/results/privacy.json
	time -p $(BIN)/python -m benchmarks.privacy.memory --figures benchmarks/results/privacy.json
	$(BIN)/python -m benchmarks.tables

# Not part of test: it runs a room's tests for each mutant.
COUNT ?= 100
SEED ?= 1
mutants: $(INSTALLED)
	$(BIN)/python -m tests.mutants --count $(COUNT) --seed $(SEED) --out build/mutants.json

# The documentation as a site, for any browser; nothing is fetched while it is built or read.
docs: $(INSTALLED)
	$(BIN)/python docs/generate.py
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

clean:
	rm -rf $(VENV) demo build/mutants.json .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
