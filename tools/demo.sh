#!/bin/sh
# Drives the built-in head by a video and writes build/demo/demo.{mp4,png,blend}; does nothing if neither the video nor
# the code nor the assets have changed. What `make test` downloads for the viewer does not matter here.
set -eu
video=$1
out=build/demo
made_from() {
    { find . -maxdepth 1 -name "*.py"; find cli core blender assets -type f ! -name "*.pyc" ! -path "assets/viewer/built/*"; } | sort | tr "\n" "\0" | xargs -0 cat -- "$video" "$out"/demo.* 2>/dev/null | sha256sum
}
mkdir -p "$out"
if [ "$(made_from)" = "$(cat "$out/.made-from" 2>/dev/null)" ]; then
    echo "$out is up to date."
else
    .venv/bin/facemime puppet "$video" -o "$out/demo.blend" --preview "$out/demo.mp4" --sheet "$out/demo.png"
    made_from >"$out/.made-from"
fi
echo "See $out/demo.mp4 and $out/demo.png, or open $out/demo.blend in Blender."
