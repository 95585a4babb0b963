"""The folder of the files that Facemime ships."""

from pathlib import Path

ASSETS = Path(__file__).resolve().parents[2] / "assets"
