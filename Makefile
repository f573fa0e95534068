# make demo    a simulated hand, live in a browser (Python only, never root)
# make check   format, lint, types, layers and the quick tests: 80 s on two cores
# make docs    the site of docs/, built strictly into out/site
# make deb     Debian packages for amd64 and arm64, of Debian 12 and 13, into dist/
# make apt KEY=FINGERPRINT   a signed apt repository of the packages in dist/, into dist/apt
# make dist   sdists and wheels of the last commit, checked by twine, into dist/
# make image   the container image tacshade-edge, by podman (IMAGE_TOOL=docker: by docker)
# make lock    newer wheels for boards, on purpose: systemd/requirements.lock and the bill of what is in them
# make test    everything, with the real broker and a guest with a real kernel's video devices
# make test-arm  a board's processor, emulated: both Pythons, a minute of the daemon, instructions a frame; over an hour, root
# make test-container  the image, built on a base of Debian's packages, run on a virtual camera; 5 minutes, root
# make first-map  apt install and pip install in a bare Debian, each to a published height map; minutes, root
# make faults  the table of docs/explanation/reliability.md; 9 minutes
PYTHON ?= python3
PY := .venv/bin/python
# A version for processors alone: what else calls itself PyTorch brings 3 GB for GPUs. `--retries 0`: the index may be out of reach.
CPU_TORCH := --extra-index-url https://download.pytorch.org/whl/cpu 'torch==2.13.0+cpu'

.PHONY: demo lint check docs test test-arm test-container first-map dist deb apt image lock faults format clean
.DELETE_ON_ERROR:

# Three stamps: the demo installs only what a user needs, and 110 MB for the site only who builds it.
.venv/run.stamp: pyproject.toml
	$(PYTHON) -m venv .venv
	$(PY) -m pip install --quiet --disable-pip-version-check -e '.[demo]'
	touch $@

.venv/dev.stamp: .venv/run.stamp
	$(PY) -m pip install --quiet --disable-pip-version-check -e '.[dev]'
	touch $@

.venv/docs.stamp: .venv/run.stamp
	$(PY) -m pip install --quiet --disable-pip-version-check -e '.[docs]'
	touch $@

demo: .venv/run.stamp
	$(PY) -m tacshade_edge demo

lint: .venv/dev.stamp
	.venv/bin/ruff format --check .
	.venv/bin/ruff check .
	.venv/bin/mypy
	.venv/bin/lint-imports

check: .venv/dev.stamp
	$(PY) -m tools.ci.run_tests lint quick

docs: .venv/docs.stamp
	NO_MKDOCS_2_WARNING=1 $(PY) -m mkdocs build

test: .venv/dev.stamp
	tools/ci/install_debian.sh
	$(PY) -m pip install --quiet --disable-pip-version-check --retries 0 $(CPU_TORCH) || \
	  echo "tests: PyTorch could not be installed: those of calibrate --fit will be skipped"
	$(PY) -m tools.ci.run_tests

test-arm: .venv/dev.stamp
	$(PY) -m tools.ci.run_arm

test-container: .venv/dev.stamp
	tools/ci/install_debian.sh mmdebstrap podman
	$(PY) -m pytest -m container -rs -s

first-map: .venv/dev.stamp
	tools/ci/install_debian.sh debootstrap gpg
	$(PY) -m tools.ci.first_map apt pip --native

deb: .venv/dev.stamp
	$(PY) -m tools.release.package_debian

apt:
	$(PYTHON) -m tools.release.apt_repository --key '$(KEY)'

dist: .venv/dev.stamp
	$(PY) -m tools.release.distributions

IMAGE_TOOL ?= podman
image:
	$(IMAGE_TOOL) build --file Containerfile --build-arg TACSHADE_EDGE_VERSION=$$($(PYTHON) -m tools.release.version) --tag tacshade-edge .

lock: .venv/dev.stamp
	$(PY) -m tools.release.lock

faults: .venv/dev.stamp
	$(PY) -m tools.faults table

format: .venv/dev.stamp
	.venv/bin/ruff format .
	.venv/bin/ruff check --fix .

clean:
	rm -rf .venv .rig .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
