"""Presets: saving, loading, sharing and removing."""

import json
import os

import bpy
import pytest

from facemime.core.puppet.presets import BUILT_IN, built_in_path
from facemime.settings import user_presets as presets


@pytest.fixture(autouse=True)
def _own_folder(tmp_path, monkeypatch):
    monkeypatch.setattr(presets, "folder", lambda: tmp_path / "presets")


def test_loading_a_preset_restores_all_settings():
    settings = bpy.context.scene.facemime
    settings.strength_lower, settings.kernel, settings.mirror = 1.7, "gaussian", True
    settings.posing.rotation_limit, settings.smoothing = 0.5, 2.5
    assert bpy.ops.facemime.save_preset(name="Lively") == {"FINISHED"}
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    settings = bpy.context.scene.facemime
    assert presets.names() == ["Lively"] and settings.strength_lower == 1.0
    assert bpy.ops.facemime.load_preset(name="Lively") == {"FINISHED"}
    assert settings.strength_lower == pytest.approx(1.7) and settings.kernel == "gaussian" and settings.mirror
    assert settings.posing.rotation_limit == pytest.approx(0.5) and settings.smoothing == pytest.approx(2.5)
    assert bpy.ops.facemime.remove_preset(name="Lively") == {"FINISHED"} and presets.names() == []


@pytest.mark.parametrize("name", BUILT_IN)
def test_built_in_presets_set_every_setting_of_the_panel_expression(name):
    settings = bpy.context.scene.facemime
    settings.strength_upper = settings.strength_middle = settings.strength_lower = 4.0
    settings.smoothing, settings.posing.rotation_strength, settings.posing.eyes_strength = 9.0, 9.0, 9.0
    assert bpy.ops.facemime.load_preset(name=name, built_in=True) == {"FINISHED"}
    assert 0.5 < settings.strength_lower < 3.0 and 0.5 < settings.strength_upper < 3.0
    assert settings.smoothing < 3.0 and settings.posing.rotation_strength < 2.0 > settings.posing.eyes_strength
    names = ("mode", "kernel", "only_landmarks", "borders", "exact", "incremental", "contact")
    usual, papers = (
        ("3d", "informed", False, "soft", False, False, True),
        ("planar", "gaussian", True, "sharp", True, True, False),
    )
    assert tuple(getattr(settings, each) for each in names) == (papers if name == "yao_2019" else usual)
    assert bpy.context.scene.facemime_steps.search == ("paper" if name == "yao_2019" else "take")


def test_built_in_presets_cannot_be_removed_and_are_not_hidden_by_your_own():
    settings = bpy.context.scene.facemime
    settings.strength_lower = 3.3
    assert bpy.ops.facemime.save_preset(name="strong") == {"FINISHED"}
    assert bpy.ops.facemime.load_preset(name="strong", built_in=True) == {"FINISHED"}
    assert settings.strength_lower == pytest.approx(1.25)
    assert bpy.ops.facemime.remove_preset(name="strong") == {"FINISHED"}
    assert bpy.ops.facemime.remove_preset(name="strong") == {"FINISHED"}
    assert presets.names() == [] and built_in_path("strong").is_file()


def test_a_preset_is_exported_and_imported(tmp_path):
    settings = bpy.context.scene.facemime
    settings.smoothing = 0.25
    assert bpy.ops.facemime.export_preset(filepath=str(tmp_path / "Calm")) == {"FINISHED"}
    settings.smoothing = 1.0
    assert bpy.ops.facemime.import_preset(filepath=str(tmp_path / "Calm.json")) == {"FINISHED"}
    assert settings.smoothing == pytest.approx(0.25) and presets.names() == ["Calm"]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "{}",
        '{"format": "other"}',
        '{"format": "facemime-preset"}',
        '{"format": "facemime-preset", "settings": 3}',
        "[" * 100_000,
    ]
    + [
        json.dumps({"format": "facemime-preset", "settings": {"smoothing": 0.5, name: value}, "posing": {}})
        for name, value in (
            *(("kernel", "magic"), ("strength_upper", "much"), ("mirror", 1), ("strength_lower", True)),
            *(("strength_lower", float("nan")), ("strength_lower", float("inf")), ("strength_lower", 10**400)),
        )
    ],
)
def test_an_invalid_preset_changes_nothing(tmp_path, text):
    (tmp_path / "bad.json").write_text(text)
    with pytest.raises(RuntimeError, match="preset"):
        bpy.ops.facemime.import_preset(filepath=str(tmp_path / "bad.json"))
    assert bpy.context.scene.facemime.smoothing == 1.0


@pytest.mark.parametrize("name", ["", "  ", "../outside", "a/b", ".hidden", "what?", "\U0001f600" * 60, "nul"])
@pytest.mark.parametrize("operator", ["save_preset", "load_preset", "remove_preset"])
def test_a_name_that_cannot_be_a_file_name_is_rejected(operator, name):
    with pytest.raises(RuntimeError, match="cannot be used as the name"):
        getattr(bpy.ops.facemime, operator)(name=name)


def test_a_preset_that_cannot_be_removed_is_reported(tmp_path):
    (tmp_path / "presets" / "Folder.json").mkdir(parents=True)
    with pytest.raises(RuntimeError, match="Cannot remove"):
        bpy.ops.facemime.remove_preset(name="Folder")


def test_importing_a_preset_with_an_invalid_name_changes_nothing(tmp_path):
    assert bpy.ops.facemime.export_preset(filepath=str(tmp_path / "Calm.json")) == {"FINISHED"}
    if os.name == "posix":  # Windows has no such names
        (tmp_path / "Calm.json").rename(tmp_path / "what?.json")
    bpy.context.scene.facemime.smoothing = 3.0
    with pytest.raises(RuntimeError, match=r"cannot be used as the name|cannot be read"):
        bpy.ops.facemime.import_preset(filepath=str(tmp_path / "what?.json"))
    assert bpy.context.scene.facemime.smoothing == 3.0
