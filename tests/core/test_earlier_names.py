"""Programs that import modules under their names of 0.1.0 get the modules of today."""

import subprocess
import sys
from importlib import import_module

import pytest

import facemime.blender  # noqa: F401 - adds its own earlier names
from facemime.core.earlier_names import EarlierNames

import_module("facemime.blender")
FINDERS = [finder for finder in sys.meta_path if isinstance(finder, EarlierNames)]
MOVED = [f"{finder._root}{name}" for finder in FINDERS for name in finder.moved]
KEPT = ("core.binding.bind", "core.live.sources", "blender.media.rendering")
"""Modules whose package alone has another name."""


def test_modules_of_both_packages_are_found():
    assert {finder._root for finder in FINDERS} == {"facemime.core.", "facemime.blender."}


@pytest.mark.parametrize("name", sorted([*MOVED, *(f"facemime.{name}" for name in KEPT)]))
def test_a_module_is_the_same_under_its_earlier_name(name):
    today = import_module(next(filter(None, (finder.today(name) for finder in FINDERS))))
    before = today.__spec__
    with pytest.warns(DeprecationWarning, match="is now"):
        sys.modules.pop(name, None)
        assert import_module(name) is today
    assert today.__spec__ is before


def test_a_program_of_0_1_0_still_starts():
    code = "from facemime.core.puppet.settings import PuppetSettings; from facemime.core.landmarks import LIPS"
    subprocess.run([sys.executable, "-c", code], check=True)
