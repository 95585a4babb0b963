"""Location of the photos and heads that models are learnt from and benchmarks run on."""

from __future__ import annotations

import argparse
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT.parent / "shared" / "data"
ICT_FILE = Path("heads") / "ict_facekit_light.npz"
"""Path within the folder of data."""


def add_data_option(command: argparse.ArgumentParser) -> None:
    """Add `--data`, the folder of photos, heads and models."""
    command.add_argument("--data", type=Path, default=DATA, help="folder of photos, heads and models")


def has_heads(data: Path) -> bool:
    """Whether the folder contains ICT-FaceKit's head."""
    return (data / ICT_FILE).is_file()
