#!/bin/sh
# Installs two of Debian's Blenders for tests on a virtual screen, each in a chroot outside the clone, keyed by its recipe.
# If that is not possible, it prints the reason in one line, which the tests repeat, and succeeds: without root or a
# Debian mirror, tests run without windows. With the argument "places" it only prints each suite and its folder.
set -eu
cd "$(dirname "$0")/.."
cache=${FACEMIME_CACHE:?}
reason=build/gui/no-windows.txt
suites="trixie sid"

packages=blender,python3-numpy,python3-scipy,xvfb,xauth,xdotool,imagemagick,libgl1-mesa-dri,libegl1,ca-certificates
recipe() {
    case $1 in
        trixie) echo "$packages" ;;
        sid) echo "$packages,python3-cattr,python3-requests" ;;
    esac
}
place_of() {
    echo "$cache/window-$1-$({ recipe "$1"; sed -n '/^build()/,/^}/p' tools/windows.sh; } | sha256sum | cut -c1-12)"
}
give_up() {
    echo "$1" | tee "$reason" >&2
    exit 0
}
mirror() {
    sed -n 's/^URIs: *\([^ ]*\).*/\1/p; s/^deb \(\[[^]]*\] \)\{0,1\}\([^ ]*\) .*/\2/p' \
        /etc/apt/sources.list.d/debian.sources /etc/apt/sources.list 2>/dev/null | head -n 1
}
build() {
    rm -rf "$2.part"
    mmdebstrap --quiet --variant=apt --mode=root --include="$(recipe "$1")" \
        --aptopt='Acquire::Check-Valid-Until "false"' --aptopt='Acquire::Languages "none"' \
        --dpkgopt='path-exclude=/usr/share/doc/*' --dpkgopt='path-exclude=/usr/share/man/*' \
        --dpkgopt='path-exclude=/usr/share/locale/*' --dpkgopt='path-include=/usr/share/locale/languages' \
        --dpkgopt='path-include=/usr/share/locale/zh_HANS/*' "$1" "$2.part" "$3"
    rm -rf "$2.part/var/cache/apt" "$2.part/var/lib/apt/lists"
    mv "$2.part" "$2"
}

if [ "${1:-}" = places ]; then
    for suite in $suites; do echo "$suite $(place_of "$suite")"; done
    exit 0
fi
mkdir -p "$cache" build/gui
rm -f "$reason"
missing=
for suite in $suites; do
    [ -e "$(place_of "$suite")" ] || missing="$missing $suite"
done
[ -z "$missing" ] && exit 0

[ "$(id -u)" = 0 ] || give_up "Blender's windows are set up as root only."
command -v apt-get >/dev/null || give_up "Blender's windows are taken from Debian, and there is no apt-get here."
[ -n "$(mirror)" ] || give_up "Blender's windows are taken from Debian, and no mirror of it is set up here."
if ! command -v mmdebstrap >/dev/null; then
    echo "Installing mmdebstrap" >&2
    { apt-get update --quiet=2 &&
        DEBIAN_FRONTEND=noninteractive apt-get install --yes --quiet=2 --no-install-recommends \
            mmdebstrap debian-archive-keyring >/dev/null; } || give_up "mmdebstrap could not be installed."
fi
for suite in $missing; do
    place=$(place_of "$suite")
    echo "Setting up Blender of Debian $suite in $place" >&2
    build "$suite" "$place" "$(mirror)" || give_up "Debian $suite could not be set up with Blender."
done
