"""Where the photos and heads lie from which models are learnt, and on which the benchmarks run."""

from __future__ import annotations

import argparse
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT.parent / "shared" / "data"


def add_data_option(command: argparse.ArgumentParser) -> None:
    """Add `--data`, the folder of photos, heads and models."""
    command.add_argument("--data", type=Path, default=DATA, help="folder of photos, heads and models")


def require_heads(command: argparse.ArgumentParser, data: Path) -> None:
    """End the command with a message if a folder lacks ICT-FaceKit's head."""
    if not (data / "heads").is_dir():
        command.error(f"{data} has no heads/ict_facekit_light.npz; say with --data where ICT-FaceKit lies")
