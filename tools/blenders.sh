#!/bin/sh
# Creates an environment per Blender that the extension is tested with, outside the clone, keyed by its requirements.
# It contains only bpy: the extension must bring the rest. A missing Python is reported and skipped.
set -eu
cd "$(dirname "$0")/.."
cache=${FACEMIME_CACHE:?}
python_of() {
    for candidate in "python$1" "$HOME/.pyenv/versions/$1"*/bin/python; do
        if "$candidate" -c "import sys; sys.exit('%d.%d' % sys.version_info[:2] != '$1')" 2>/dev/null; then
            echo "$candidate"
            return
        fi
    done
}
for pair in 4.2:3.11 4.5:3.11 5.0:3.11 5.2:3.13; do
    version=${pair%:*}
    key=$(sha256sum "tools/requirements/bpy-$version.txt" | cut -c1-12)
    place=$cache/bpy-$version-$key
    [ -e "$place/.ready" ] && continue
    python=$(python_of "${pair#*:}")
    if [ -z "$python" ]; then
        echo "No Python ${pair#*:}: the tests with Blender $version are skipped." >&2
        continue
    fi
    echo "Setting up Blender $version in $place" >&2
    "$python" -m venv --clear "$place"
    "$place/bin/pip" install --quiet --disable-pip-version-check --no-cache-dir --require-hashes -r "tools/requirements/bpy-$version.txt"
    touch "$place/.ready"
done
