#!/bin/sh
# Builds numpy as Blender does, without BLAS and LAPACK, outside the clone, keyed by its requirements; prints its folder.
set -eu
cd "$(dirname "$0")/.."
key=$(cat tools/requirements/plain.txt tools/requirements/plain-build.txt tools/plain_numpy.sh | sha256sum | cut -c1-12)
place=${FACEMIME_CACHE:?}/numpy-plain-$key
if [ ! -e "$place/.ready" ]; then
    if ! command -v cc >/dev/null 2>&1 || ! command -v c++ >/dev/null 2>&1; then
        echo "A C++ compiler is missing. Install g++ and the headers of Python 3.11, then run make again." >&2
        exit 1
    fi
    echo "Building numpy without BLAS in $place; this takes some minutes" >&2
    rm -rf "$place"
    "${PYTHON:-python3.11}" -m venv "$place/build"
    "$place/build/bin/pip" install --quiet --disable-pip-version-check --require-hashes -r tools/requirements/plain-build.txt >&2
    PATH="$place/build/bin:$PATH" "$place/build/bin/pip" install --quiet --disable-pip-version-check --no-deps \
        --no-build-isolation --no-binary numpy --require-hashes -r tools/requirements/plain.txt --target "$place/packages" \
        --config-settings=setup-args=-Dallow-noblas=true --config-settings=setup-args=-Dblas=none \
        --config-settings=setup-args=-Dlapack=none >&2
    rm -rf "$place/build"
    touch "$place/.ready"
fi
echo "$place/packages"
