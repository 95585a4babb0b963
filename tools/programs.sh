#!/bin/sh
# Installs programs from Debian that only tests use: the browser in which the viewer's page is tested, the compiler of the
# receiver in C#, and the relay's server. If one cannot be installed, it prints the reason in one line, which the tests
# repeat, and succeeds.
set -eu
cd "$(dirname "$0")/.."
PATH=$PATH:/usr/sbin
reasons=build/missing

installed() {
    [ "$(id -u)" = 0 ] || { echo "$1 is installed as root only."; return; }
    command -v apt-get >/dev/null || { echo "$1 is taken from Debian, and there is no apt-get here."; return; }
    echo "Installing $1" >&2
    { apt-get update --quiet=2 &&
        DEBIAN_FRONTEND=noninteractive apt-get install --yes --quiet=2 --no-install-recommends "$1" >&2; } ||
        echo "$1 could not be installed."
}
mkdir -p "$reasons"
for pair in chromium:chromium mcs:mono-mcs nats-server:nats-server; do
    program=${pair%:*}
    reason=$reasons/$program.txt
    rm -f "$reason"
    command -v "$program" >/dev/null && continue
    said=$(installed "${pair#*:}")
    [ -z "$said" ] || echo "$said" | tee "$reason" >&2
done
