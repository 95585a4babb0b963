#!/bin/sh
# Starts an installed Blender with this extension in a temporary profile, which is removed afterwards.
set -eu
cd "$(dirname "$0")/.."
blender=${BLENDER:-blender}
if ! command -v "$blender" >/dev/null 2>&1; then
    echo "Blender was not found as '$blender'. Set its path: make try BLENDER=/path/to/blender" >&2
    exit 1
fi
profile=$(mktemp -d)
trap 'rm -rf "$profile"' EXIT
python=$("$blender" --background --python-expr "import sys; print('Python', *sys.version_info[:2])" | sed -n 's/^Python 3 //p')
first=$([ "$python" -ge 13 ] && echo 5.1 || echo 4.2)
zip=$(ls dist/*-blender_"$first"-*linux_x64.zip dist/*-blender_"$first"-*"$(uname -s | tr '[:upper:]' '[:lower:]')"*.zip 2>/dev/null | head -n 1)
export BLENDER_USER_RESOURCES="$profile"
"$blender" --command extension install-file --repo user_default --enable "$zip"
"$blender" --python-expr "import bpy; bpy.ops.facemime.add_head()"
