"""`python -m lab.training.head` builds assets/head; with --check it only reports whether assets/head is up to date."""

from __future__ import annotations

import argparse
import sys

from ..data import ROOT
from .build import build_files
from .source import open_source

ASSETS = ROOT / "assets" / "head"


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m lab.training.head", description=__doc__)
    parser.add_argument("--check", action="store_true", help="build, compare with assets/head, write nothing")
    arguments = parser.parse_args()
    files = build_files(open_source())
    if arguments.check:
        differing = [name for name, content in files.items() if (ASSETS / name).read_bytes() != content]
        print("differs: " + ", ".join(differing) if differing else "assets/head is what this builds")
        return 1 if differing else 0
    ASSETS.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        (ASSETS / name).write_bytes(content)
        print(f"{name}: {len(content) / 1024:.0f} KB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
