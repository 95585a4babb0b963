"""Settings are stated once, and everything derived from them agrees."""

from __future__ import annotations

import math

import pytest

from facemime.cli.options import Parser, add_puppet_options, parse, puppet_job
from facemime.core.bake.bake_settings import BakeSettings
from facemime.core.base.setting import changed, settings_of
from facemime.core.drive.drive_settings import DriveSettings, PosingSettings
from facemime.core.drive.head_deformer import INFORMED
from facemime.core.heads.kernels import KERNELS
from facemime.core.puppet.puppet_settings import PuppetSettings

GROUPS = (DriveSettings, PosingSettings, BakeSettings, PuppetSettings)
ALL = [(group, name, setting) for group in GROUPS for name, setting in settings_of(group).items()]


@pytest.mark.parametrize(("group", "name", "setting"), ALL, ids=[f"{g.__name__}.{n}" for g, n, _ in ALL])
def test_the_default_of_a_setting_is_in_range_and_its_texts_follow_blenders_style(group, name, setting):
    assert getattr(group(), name) == setting.default == setting.checked(setting.default, name)
    assert setting.label and setting.description and not setting.description.endswith(".")
    assert setting.description[0].isupper()
    if setting.kind in (int, float):
        for value in (setting.low - 1, setting.high + 1, math.nan, "1", None, True):
            with pytest.raises(ValueError, match=name):
                setting.checked(value, name)
    else:
        for value in (0.5, "nothing that there is", None, []):
            with pytest.raises(ValueError, match=name):
                setting.checked(value, name)


def test_every_kernel_can_be_chosen():
    assert set(settings_of(DriveSettings)["kernel"].values) == {INFORMED, *KERNELS}


def test_without_options_a_job_has_the_default_settings(tmp_path):
    parser = Parser()
    add_puppet_options(parser)
    assert puppet_job(parse(parser, []), source=tmp_path, output=tmp_path).settings == PuppetSettings()
    assert list(changed(PuppetSettings())) == []


def test_changed_settings_are_listed_in_all_groups():
    settings = PuppetSettings(smoothing=0.5, drive=DriveSettings(posing=PosingSettings(eyes_strength=0.0)))
    assert {(name, value) for name, _, value in changed(settings)} == {("smoothing", 0.5), ("eyes_strength", 0.0)}


def test_a_number_that_blender_rounded_to_seven_digits_is_still_within_its_range():
    setting = settings_of(PosingSettings)["rotation_limit"]
    assert setting.checked(3.1415929, "limit") == math.pi
    with pytest.raises(ValueError, match="limit"):
        setting.checked(3.1417, "limit")
