# make demo    one simulated sensor, live in a browser (Python only, never root)
# make check   format, lint, types, layers and the tests without a mark: 40 s on two cores
# make coverage   what part of each room the quick tests run; half as long again as make check
# make docs    the site of docs/, built strictly into out/site
# make deb     Debian packages for amd64 and arm64, of Debian 12 and 13, into dist/
# make apt KEY=FINGERPRINT   a signed apt repository of the packages in dist/, into dist/apt, by reprepro
# make dist   sdists and wheels of the last commit, checked by twine, into dist/
# make image   the container image tacshade-edge, by podman (IMAGE_TOOL=docker: by docker)
# make lock    newer wheels, on purpose: systemd/requirements.lock for boards, tools/ci/requirements.lock for tests
# make bill    the bill of materials of the wheels for boards, into dist/
# make test    everything, with the real broker and a guest with a real kernel's video devices
# make test ONE=tests/sensor/test_depth.py   one file, folder or test (FILE::NAME) with what it needs, its output shown
# make test-arm  a board's processor, emulated: both Pythons, instructions a frame; over an hour, root
# make test-container  the image, built on a base of Debian's packages; root
# make house   the rooms of the package: sizes, and who imports whom
# make faults  the tables of docs/results/faults.md: faults of a running daemon, and the suite's trials; 6 minutes
PYTHON ?= python3
PY := .venv/bin/python
# A version for processors alone: what else calls itself PyTorch brings 3 GB for GPUs. `--retries 0`: the index may be out of reach.
CPU_TORCH := --extra-index-url https://download.pytorch.org/whl/cpu 'torch==2.13.0+cpu' 'numba>=0.61,<1'

.PHONY: demo lint check coverage docs test test-arm test-container dist deb apt image lock bill faults house format clean
.DELETE_ON_ERROR:

# Three stamps: the demo installs only what a user needs, and 110 MB for the site only who builds it.
.venv/run.stamp: pyproject.toml
	$(PYTHON) -m venv .venv
	$(PY) -m pip install --quiet --disable-pip-version-check -e '.[demo]'
	touch $@

.venv/dev.stamp: .venv/run.stamp tools/ci/requirements.lock
	$(PY) -m pip install --quiet --disable-pip-version-check --require-hashes -r tools/ci/requirements.lock
	touch $@

.venv/docs.stamp: .venv/run.stamp
	$(PY) -m pip install --quiet --disable-pip-version-check -e '.[docs]'
	touch $@

demo: .venv/run.stamp
	$(PY) -m tacshade_edge demo

lint: .venv/dev.stamp
	.venv/bin/ruff format --check .
	.venv/bin/ruff check .
	$(PY) -m tools.ci.fence
	.venv/bin/mypy
	.venv/bin/lint-imports

check: .venv/dev.stamp
	$(PY) -m tools.ci.run_tests lint quick

coverage: .venv/dev.stamp
	$(PY) -m tools.ci.measure_coverage

house: .venv/dev.stamp
	$(PY) -m tools.ci.house

docs: .venv/docs.stamp
	NO_MKDOCS_2_WARNING=1 $(PY) -m mkdocs build

test: .venv/dev.stamp
	tools/ci/install_debian.sh
	$(PY) -m pip install --quiet --disable-pip-version-check --retries 0 $(CPU_TORCH) || \
	  echo "tests: PyTorch could not be installed: those of calibrate --fit will be skipped"
	$(PY) -m pip install --quiet --disable-pip-version-check --retries 0 'mujoco>=4,<5' || \
	  echo "tests: MuJoCo could not be installed: those of simulate --mjcf will be skipped"
	$(PY) -m pip install --quiet --disable-pip-version-check --retries 0 'systemd-python>=235' || \
	  echo "tests: systemd-python could not be built: those of the journal's fields will be skipped"
	$(PY) -m tools.ci.run_tests $(ONE)

test-arm: .venv/dev.stamp
	$(PY) -m tools.ci.run_arm

test-container: .venv/dev.stamp
	tools/ci/install_debian.sh mmdebstrap podman
	$(PY) -m pytest -m container -rs -s

deb: .venv/dev.stamp
	$(PY) -m tools.release.package_debian

DIST ?= dist
apt:
	ls $(DIST)/*.deb >/dev/null  # of make deb
	rm -rf $(DIST)/apt out/apt && mkdir -p $(DIST)/apt out/apt
	for suite in bookworm trixie; do printf '%s\n' "Codename: $$suite" "Suite: $$suite" 'Origin: tacshade-edge' \
	  'Label: tacshade-edge' 'Architectures: amd64 arm64' 'Components: main' 'SignWith: $(KEY)' ''; done >out/apt/distributions
	for suite in deb12:bookworm deb13:trixie; do for deb in $(DIST)/*+$${suite%:*}_*.deb; do [ ! -e "$$deb" ] || \
	  reprepro --silent --confdir $(CURDIR)/out/apt --dbdir $(CURDIR)/out/apt/db --outdir $(abspath $(DIST))/apt \
	  includedeb $${suite#*:} "$$deb" || exit; done; done
	gpg --batch --armor --export '$(KEY)' >$(DIST)/apt/tacshade-edge.asc

dist: .venv/dev.stamp
	$(PY) -m tools.release.distributions

IMAGE_TOOL ?= podman
image:
	$(IMAGE_TOOL) build --file Containerfile --build-arg TACSHADE_EDGE_VERSION=$$($(PYTHON) -m tools.release.version) --tag tacshade-edge .

UV := $(PY) -m uv
lock: .venv/dev.stamp
	$(PY) -c "import tomllib; print(*tomllib.load(open('pyproject.toml', 'rb'))['build-system']['requires'], sep='\n')" | \
	  UV_CUSTOM_COMPILE_COMMAND='make lock' $(UV) pip compile --quiet pyproject.toml - --universal --python-version 3.11 \
	  --extra dashboard --extra prometheus --upgrade --generate-hashes --only-binary :all: --emit-build-options --no-annotate \
	  --output-file systemd/requirements.lock
	UV_CUSTOM_COMPILE_COMMAND='make lock' $(UV) pip compile --quiet pyproject.toml --universal --python-version 3.11 \
	  --extra all --extra cluster --group dev --upgrade --generate-hashes --no-annotate \
	  --output-file tools/ci/requirements.lock

bill: .venv/dev.stamp
	$(PY) -m tools.release.bill --out $(DIST)

faults: .venv/dev.stamp
	$(PY) -m tools.faults table; table=$$?; $(PY) -m tools.faults trials && exit $$table

format: .venv/dev.stamp
	.venv/bin/ruff format .
	.venv/bin/ruff check --fix .

clean:
	rm -rf .venv .rig .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
