"""Blender's properties have the defaults, ranges, choices and texts of the settings in core."""

import os

import bpy
import pytest

from facemime.core.bake.bake_settings import BakeSettings
from facemime.core.drive.drive_settings import DriveSettings, PosingSettings
from facemime.core.files.setting import settings_of
from facemime.core.puppet.puppet_settings import PuppetSettings
from facemime.core.tracking.tracker import TrackingSettings
from facemime.settings.values import bake_settings, puppet_settings


def owners() -> list[tuple[type, bpy.types.PropertyGroup]]:
    """Return each group of settings with the property group that has its properties."""
    scene = bpy.context.scene
    pairs = ((DriveSettings, scene.facemime), (PuppetSettings, scene.facemime), (PosingSettings, scene.facemime.posing))
    return [*pairs, (BakeSettings, scene.facemime_takes.bake)]


def test_files_of_earlier_versions_keep_what_they_bake_to():
    items = bpy.context.scene.facemime_takes.bake.bl_rna.properties["keys"].enum_items
    assert [item.identifier for item in sorted(items, key=lambda item: item.value)] == [
        *("new", "named", "mapped", "cache", "alembic"),
        *("automatic", "controls"),
    ]


def test_a_new_scene_has_the_defaults_of_the_command_line(in_a_project):
    scene = bpy.context.scene
    bake = bake_settings(scene.facemime_takes.bake, "take")
    shown = puppet_settings(scene.facemime)
    assert (bake.keys, bake.max_keys, bake.clean, bake.nla) == ("automatic", 64, 0.005, False)
    wanted = PuppetSettings()
    for ours, theirs in ((shown, wanted), (shown.drive, wanted.drive), (shown.drive.posing, wanted.drive.posing)):
        for name in settings_of(type(theirs)):
            assert getattr(ours, name) == pytest.approx(getattr(theirs, name)), name


def test_a_property_has_the_range_choices_and_texts_of_its_setting():
    for group, owner in owners():
        for name, setting in settings_of(group).items():
            rna = owner.bl_rna.properties[name]
            assert (rna.name, rna.description) == (setting.label, setting.description)
            if setting.choices:
                assert tuple(rna.enum_items.keys()) == setting.values and rna.default == setting.default
            elif setting.kind in (int, float):
                ends = [setting.scale * end for end in (setting.low, setting.high, setting.default)]
                assert [rna.hard_min, rna.hard_max, rna.default] == pytest.approx(ends)


@pytest.mark.filterwarnings("ignore:.*blend relative:RuntimeWarning")
def test_the_file_of_a_model_is_found_beside_the_project(in_a_project):
    settings = bpy.context.scene.facemime
    assert puppet_settings(settings).tracking == TrackingSettings()
    assert settings.bl_rna.properties["tracker_model"].subtype == "FILE_PATH"
    settings.tracker_model = "//face2.tracker"
    project = os.path.dirname(bpy.data.filepath)
    assert puppet_settings(settings).tracking.tracker_model == os.path.join(project, "face2.tracker")
