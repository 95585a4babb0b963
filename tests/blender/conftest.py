"""Every test starts from an empty file with factory settings."""

import bpy
import pytest

import facemime


@pytest.fixture(scope="session", autouse=True)
def _registered():
    """The extension's classes, taken back at the end: Blender does not survive an exit with them registered."""
    facemime.register()
    yield
    facemime.unregister()


@pytest.fixture(autouse=True)
def _empty_file(_registered):
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
