"""Programs that import modules of core under their names of 0.1.0 get the modules of today."""

import subprocess
import sys
from importlib import import_module

import pytest

from facemime.core.earlier_names import _MOVED, _today

KEPT = ("binding.bind", "control_points.greedy", "deform.rbf", "live.sources", "mesh.kernels")
"""Modules whose package alone has another name."""


@pytest.mark.parametrize("name", sorted((*_MOVED, *KEPT)))
def test_a_module_is_the_same_under_its_earlier_name(name):
    today = import_module(f"facemime.core.{_today(name)}")
    before = today.__spec__
    with pytest.warns(DeprecationWarning, match="is now"):
        sys.modules.pop(f"facemime.core.{name}", None)
        assert import_module(f"facemime.core.{name}") is today
    assert today.__spec__ is before


def test_a_program_of_0_1_0_still_starts():
    code = "from facemime.core.puppet.settings import PuppetSettings; from facemime.core.landmarks import LIPS"
    subprocess.run([sys.executable, "-c", code], check=True)
