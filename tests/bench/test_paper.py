"""docs/accuracy/paper.md contains the results of `make paper`, and its tables hold for the shipped head."""

from __future__ import annotations

import json
import re
from pathlib import Path

import cv2
import pytest

from facemime.core.heads.rig import built_in_head
from lab.bench import docs
from lab.bench.deformation import judge
from lab.bench.deformers import Method, regions
from lab.bench.heads import AREAS, TrueHead, true_built_in_head
from lab.bench.paper import paper_settings, region_table
from lab.bench.paper_claims import cell, claims
from lab.bench.report import Table

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "accuracy" / "paper.md"
MEASURED = {
    title: Table(title, table["columns"], table["rows"])
    for title, table in json.loads((ROOT / "docs" / "accuracy" / "paper.json").read_text(encoding="utf-8")).items()
}
ERRORS = "Error in 500 mixtures of known expressions"
KEYS = {
    "errors": ERRORS,
    "openings": "Openings in the same mixtures",
    "clip": "Avatar and true performer over the sample clip",
    "labels": "Avatar and hand labels of five people, private data",
    "twelve": "Error with fewer control points",
    "greedy": "Control points that the sample clip needs",
    "speed": "From the clip to the shape key, 1,781 vertices, one core",
    "network": "Coordinates over a network",
}


@pytest.fixture(scope="module")
def head() -> TrueHead:
    return true_built_in_head()


def test_the_tables_of_the_page_are_those_that_the_command_wrote():
    text = PAGE.read_text(encoding="utf-8")
    written = "\n".join(table.markdown() for table in MEASURED.values())
    again, put_in = docs.with_tables(text, docs.tables_in(written))
    assert again == text
    assert set(put_in) == set(MEASURED)


def test_the_claims_follow_from_the_tables():
    assert claims({key: MEASURED[title] for key, title in KEYS.items()}).rows == list(
        map(tuple, MEASURED["Claims"].rows)
    )


def test_the_regions_are_those_of_the_shipped_head():
    assert [list(row) for row in region_table(built_in_head()).rows] == MEASURED["Regions"].rows


def test_the_errors_are_those_of_the_shipped_head(head):
    for name, options in (("with depth", {"sharp": True, "exact": True}), ("+ soft borders", {})):
        predict = regions(head, kernel="gaussian", **options)
        errors = judge(head, Method(name, 66, predict, 0.0, 0.0), head.mixtures)["errors"]
        assert errors == {area: pytest.approx(cell(MEASURED[ERRORS], name, area), rel=1e-3) for area in AREAS}


def test_the_benchmark_uses_the_settings_of_the_preset():
    options = paper_settings()
    assert (options.mode, options.kernel, options.borders) == ("planar", "gaussian", "sharp")
    assert options.exact and options.incremental and options.only_landmarks and not options.contact


def test_the_images_of_the_page_exist_and_are_all_used():
    pictures = {path.name for path in (ROOT / "docs" / "images" / "paper").iterdir()}
    assert set(re.findall(r"images/paper/(\S+?)\)", PAGE.read_text(encoding="utf-8"))) == pictures
    for name in pictures:
        picture = cv2.imread(str(ROOT / "docs" / "images" / "paper" / name))
        assert picture is not None and picture.std() > 10.0
    assert sum((ROOT / "docs" / "images" / "paper" / name).stat().st_size for name in pictures) < 1_200_000
