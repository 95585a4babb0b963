"""Links in the documents lead somewhere, on a forge as on the site; `make docs` checks links between pages."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from facemime.core.bake.bake_settings import BakeSettings
from facemime.core.drive.drive_settings import DriveSettings, PosingSettings
from facemime.core.drive.driver import HeadDriver
from facemime.core.heads.rig import built_in_head
from facemime.core.puppet.puppet_settings import PuppetSettings
from facemime.core.takes.neutral import calibrate
from tests.helpers.takes import performance

ROOT = Path(__file__).resolve().parents[2]
DOCUMENTS = sorted(
    [*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), *ROOT.glob("docs/*/*.md"), ROOT / "assets" / "MODEL_CARD.md"]
)
_LINK = re.compile(r"\]\((?![a-z]+:)([^)#\s]*)(?:#([^)\s]+))?\)")
_SOURCE = re.compile(r"`((?:bench|blender|cli|core|farm|operators|sessions|settings|tests|tools|training|ui)/[\w/.]*)`")
_CALL = re.compile(r"`([A-Z]\w+\([^`]*\))`")
"""A call of one of Facemime's classes."""
_FENCE = re.compile(r"^```.*?^```$", re.DOTALL | re.MULTILINE)


def anchors(path: Path) -> set[str]:
    """Return the anchors that a forge gives to the headings of a document."""
    headings = re.findall(r"^#+ (.+)$", _FENCE.sub("", path.read_text(encoding="utf-8")), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.replace("`", "")).strip().lower().replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_links_lead_to_files_and_headings(path):
    for target, anchor in _LINK.findall(_FENCE.sub("", path.read_text(encoding="utf-8"))):
        file = (path.parent / target).resolve() if target else path
        assert file.exists(), f"{target} is missing"
        assert not anchor or anchor in anchors(file), f"{file.name} has no heading #{anchor}"


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_source_files_named_in_documents_exist(path):
    named = _SOURCE.findall(path.read_text(encoding="utf-8"))
    assert [name for name in named if not (ROOT / name).exists()] == []


def test_the_pictures_of_the_tutorials_are_all_used_and_small():
    pictures = sorted((ROOT / "docs" / "tutorials" / "images").iterdir())
    text = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "docs" / "tutorials").glob("*.md"))
    assert [picture.name for picture in pictures if f"images/{picture.name}" not in text] == []
    assert sum(picture.stat().st_size for picture in pictures) < 3_000_000


DOCUMENTED = sorted({call for path in DOCUMENTS for call in _CALL.findall(path.read_text(encoding="utf-8"))})


@pytest.mark.parametrize("call", DOCUMENTED)
def test_calls_in_documents_run_and_their_settings_drive_a_head(call):
    known = {group.__name__: group for group in (DriveSettings, PosingSettings, PuppetSettings, BakeSettings)}
    made = eval(call.replace("...", "1.0"), dict(known))
    options = made if isinstance(made, DriveSettings) else DriveSettings()
    take = performance()
    frame = HeadDriver(built_in_head(), calibrate(take), options).frame(take.result(50))
    assert np.isfinite(frame.vertices).all()


def test_documents_contain_calls():
    assert any(call.startswith("DriveSettings(") for call in DOCUMENTED)
