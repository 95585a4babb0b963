"""Where the files that ship with Facemime are."""

from pathlib import Path

ASSETS = Path(__file__).resolve().parents[1] / "assets"
