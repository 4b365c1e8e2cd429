# make          install into .venv          make demo      the whole job on the embedded world
# make test     the tests (< 15 minutes)    make test-all  the slow ones too

PYTHON ?= $(shell for p in python3.11 python3 python; do \
	$$p -c 'import sys; raise SystemExit(sys.version_info[:2] != (3, 11))' 2>/dev/null && echo $$p && break; done)
VENV := .venv
BIN := $(VENV)/bin
PIP_FLAGS ?=

.PHONY: install install-test demo test test-all clean
install: $(VENV)/.installed

$(VENV)/.installed: pyproject.toml constraints.txt
	@test -n "$(PYTHON)" || { echo "scene2skill needs Python 3.11 (PyBullet has no wheel above it): install it, or say make PYTHON=/path/to/python3.11"; exit 2; }
	@$(PYTHON) -c 'import ensurepip' 2>/dev/null || sh .ci/system-packages python3.11-venv
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check $(PIP_FLAGS) -c constraints.txt -e .
	@$(BIN)/python -c 'import open3d' 2>/dev/null || sh .ci/system-packages libusb-1.0-0 libgl1 libegl1 libx11-6 libidn2-0
	@touch $@

install-test: $(VENV)/.installed-test

$(VENV)/.installed-test: $(VENV)/.installed
	@test -x /usr/bin/chromium || sh .ci/system-packages chromium
	@command -v node >/dev/null || sh .ci/system-packages nodejs
	$(BIN)/python -m pip install --quiet --disable-pip-version-check $(PIP_FLAGS) -c constraints.txt -e '.[test]'
	@touch $@

demo: install
	$(BIN)/scene2skill

test: install-test
	$(BIN)/python -m pytest -n 2 --dist loadfile

test-all: install-test
	$(BIN)/python -m pytest -n 2 --dist loadfile -m ''

clean:
	rm -rf $(VENV) build dist .pytest_cache .hypothesis
