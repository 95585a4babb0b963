#!/bin/sh
# Pins the packages in tools/requirements/*.in, with hashes.
set -eu
cd "$(dirname "$0")/requirements"
uv() { ../../.venv/bin/uv pip compile --quiet --no-header --generate-hashes "$@"; }
../../.venv/bin/pip install --quiet uv
uv --universal --python-version 3.11 dev.in -o dev.txt
uv --universal --python-version 3.11 farm.in -o farm.txt
uv --python-version 3.11 training.in -o training.txt
uv --python-version 3.11 --no-deps node.in -o node.txt
uv --python-version 3.11 --allow-unsafe peers.in -o peers.txt
uv --universal --python-version 3.11 docs.in -o docs.txt
uv --universal --python-version 3.11 --no-deps wheels.in -o wheels.txt
uv --universal --python-version 3.11 --no-deps oracles.in -o oracles.txt  # their dependencies are not needed to read files
uv --python-platform windows --python-version 3.11 wine.in -o wine.txt
for version in 4.2 4.5 5.0; do
    uv --python-version 3.11 "bpy-$version.in" -o "bpy-$version.txt"
done
uv --python-version 3.13 bpy-5.2.in -o bpy-5.2.txt
(cd viewer && npm install --package-lock-only --ignore-scripts --omit-lockfile-registry-resolved --no-audit --no-fund)
