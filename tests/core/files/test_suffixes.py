"""Suffixes by which folders and file browsers list videos."""

import fnmatch

import pytest

from facemime.core.files.suffixes import VIDEO_SUFFIXES, shown_files


@pytest.mark.parametrize("name", ["00001.mts", "clip.wmv", "phone.3gp", "tape.dv", "a.mp4"])
def test_file_browsers_show_the_videos_of_cameras_and_phones(name):
    patterns = shown_files(*sorted(VIDEO_SUFFIXES)).split(";")
    assert any(fnmatch.fnmatch(name, pattern) for pattern in patterns)
    assert not any(fnmatch.fnmatch("notes.txt", pattern) for pattern in patterns)


def test_a_filter_is_no_longer_than_blender_stores():
    assert len(shown_files(*sorted(VIDEO_SUFFIXES), ".facetake", ".wav", ".flac", ".mp3", ".ogg").encode()) < 256
