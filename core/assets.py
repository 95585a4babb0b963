"""The folder of the files that are shipped with Facemime."""

from pathlib import Path

ASSETS = Path(__file__).resolve().parents[1] / "assets"
