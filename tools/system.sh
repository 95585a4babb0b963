#!/bin/sh
# Installs missing system libraries that Blender's module needs, and venv (Debian, Ubuntu).
set -eu
python=${PYTHON:-python3.11}
packages="libxrender1 libxfixes3 libxi6 libxkbcommon0 libsm6 libgl1 libegl1 libgomp1"

if ! command -v "$python" >/dev/null 2>&1; then
    echo "Python 3.11 was not found as $python. Install it, or set its path: make PYTHON=/path/to/python3.11" >&2
    exit 1
fi
complete() {
    "$python" - <<'PYTHON'
import ctypes, importlib.util, sys
missing = [m for m in ("venv", "ensurepip") if importlib.util.find_spec(m) is None]
for name in ("Xrender.so.1", "Xfixes.so.3", "Xi.so.6", "xkbcommon.so.0", "SM.so.6", "GL.so.1", "EGL.so.1", "gomp.so.1"):
    try:
        ctypes.CDLL("lib" + name)
    except OSError:
        missing.append(name)
sys.exit(bool(missing))
PYTHON
}
complete && exit 0

case $("$python" -c 'import sys; print(sys.executable)') in
    /usr/bin/*) packages="$packages $(basename "$(readlink -f "$(command -v "$python")")")-venv" ;;
esac
install="apt-get install --yes --no-install-recommends $packages"
if [ "$(id -u)" = 0 ]; then
    sudo=
elif sudo -n true 2>/dev/null; then
    sudo="sudo -n"
else
    echo "Some system libraries are missing. Install them with this command, then run make again:" >&2
    echo "    sudo $install" >&2
    exit 1
fi
echo "Installing system libraries: $packages" >&2
$sudo env DEBIAN_FRONTEND=noninteractive apt-get update --quiet=2
$sudo env DEBIAN_FRONTEND=noninteractive $install --quiet=2 >/dev/null
complete || { echo "Some system libraries are still missing after: $install" >&2; exit 1; }
