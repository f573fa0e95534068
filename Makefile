# make demo    a simulated hand, live in a browser (Python only, never root)
# make check   format, lint, types, layers and the quick tests: under a minute
# make test    everything, with the real broker and a guest with a real kernel's video devices
PYTHON ?= python3
PY := .venv/bin/python

.PHONY: demo lint check test format clean
.DELETE_ON_ERROR:

# Two stamps, so that the demo installs only what a user needs.
.venv/run.stamp: pyproject.toml
	$(PYTHON) -m venv .venv
	$(PY) -m pip install --quiet --disable-pip-version-check -e '.[demo]'
	touch $@

.venv/dev.stamp: .venv/run.stamp
	$(PY) -m pip install --quiet --disable-pip-version-check -e '.[dev]'
	touch $@

demo: .venv/run.stamp
	$(PY) -m tacshade_edge demo

lint: .venv/dev.stamp
	.venv/bin/ruff format --check .
	.venv/bin/ruff check .
	.venv/bin/mypy
	.venv/bin/lint-imports

check: .venv/dev.stamp
	$(PY) tools/run_tests.py lint quick

test: .venv/dev.stamp
	tools/install_debian.sh
	$(PY) -m pip install --quiet --disable-pip-version-check -e '.[dev,systemd]' || \
	  echo "tests: systemd-python could not be built: the service's tests will be skipped"
	$(PY) tools/run_tests.py

format: .venv/dev.stamp
	.venv/bin/ruff format .
	.venv/bin/ruff check --fix .

clean:
	rm -rf .venv .rig .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
