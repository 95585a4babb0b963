"""What a program finds in `facemime`: a few names, loaded when they are used, each with an example that runs."""

from __future__ import annotations

import doctest
import inspect
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

import facemime
from facemime.core.takes.file import save_take
from tests.helpers.takes import performance

ROOT = Path(facemime.__file__).parent
SAMPLE = ROOT / "assets" / "sample" / "sample.mp4"
PAGES = ("README.md", "docs/guides/python.md")
SHOWN = [
    name for name in facemime.__all__ if not isinstance(getattr(facemime, name), tuple) and name != "FacemimeError"
]
"""Names with an example of their own; those of constants and of the error are in others' examples."""


@pytest.fixture
def files(tmp_path, monkeypatch) -> None:
    """The files that examples read: a clip, a portrait and a take."""
    shutil.copyfile(SAMPLE, tmp_path / "clip.mp4")
    _, portrait = cv2.VideoCapture(str(SAMPLE)).read()
    cv2.imwrite(str(tmp_path / "portrait.png"), portrait)
    save_take(performance(), tmp_path / "performance.facetake")
    monkeypatch.chdir(tmp_path)


def run(examples: doctest.DocTest) -> None:
    said: list[str] = []
    doctest.DocTestRunner(optionflags=doctest.ELLIPSIS).run(examples, out=said.append)
    assert not said, "".join(said)


@pytest.mark.parametrize("name", SHOWN)
def test_the_example_of_a_name_at_the_door_runs(name, files):
    text = inspect.getdoc(getattr(facemime, name))
    found = doctest.DocTestParser().get_doctest(text, {"np": np}, name, None, 0)
    assert any(name in example.source for example in found.examples), "it shows how the name is used"
    run(found)


def test_the_example_of_the_package_runs(files):
    run(doctest.DocTestParser().get_doctest(facemime.__doc__, {}, "facemime", None, 0))


@pytest.mark.parametrize("page", [pytest.param(PAGES[0], marks=pytest.mark.thorough), PAGES[1]])
def test_the_examples_of_a_page_run(page, files):
    text = (ROOT / page).read_text(encoding="utf-8").replace("```", "")
    found = doctest.DocTestParser().get_doctest(text, {}, page, None, 0)
    assert found.examples
    run(found)


def test_every_name_at_the_door_is_listed_and_loaded_from_where_type_checkers_find_it():
    assert set(facemime.__all__) == set(facemime._PLACES) and set(facemime.__all__) <= set(dir(facemime))
    source = Path(facemime.__file__).read_text(encoding="utf-8")
    for name, place in facemime._PLACES.items():
        assert f"    from .core.{place} import {name} as {name}\n" in source
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        facemime.nothing  # noqa: B018


def test_the_door_loads_nothing_until_it_is_used():
    code = "import facemime, sys; assert not {'numpy', 'cv2', 'bpy'} & set(sys.modules); facemime.FacemimeError"
    subprocess.run([sys.executable, "-c", code], check=True)
