#!/bin/sh
# Installs Debian's Chromium, in which the viewer's page is tested. If that is not possible, it prints the reason in one
# line, which the tests repeat, and succeeds.
set -eu
cd "$(dirname "$0")/.."
reason=build/viewer/no-browser.txt

give_up() {
    echo "$1" | tee "$reason" >&2
    exit 0
}
mkdir -p build/viewer
rm -f "$reason"
command -v chromium >/dev/null && exit 0
[ "$(id -u)" = 0 ] || give_up "Chromium is installed as root only."
command -v apt-get >/dev/null || give_up "Chromium is taken from Debian, and there is no apt-get here."
echo "Installing Chromium" >&2
{ apt-get update --quiet=2 &&
    DEBIAN_FRONTEND=noninteractive apt-get install --yes --quiet=2 --no-install-recommends chromium >/dev/null; } ||
    give_up "Chromium could not be installed."
