"""The command line gives clear errors on any input, without tracebacks or losses."""

from __future__ import annotations

import io
import os
import shutil
import subprocess
import sys
from contextlib import suppress
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest

from facemime.cli import console
from facemime.cli import main as cli
from facemime.cli.clips import Namer, find_clips
from facemime.cli.console import Progress, Screen, printable, say, tell
from facemime.core.errors import SourceError
from facemime.core.files.capture import write_image
from facemime.core.puppet.job import PuppetJob
from tests.helpers.commands import SAMPLE, needs_posix, run

HUGE = "9" * 400


@needs_posix
@needs_posix
@pytest.mark.parametrize(
    "line",
    [
        ["batch", "{pipe}", "-o", "{out}"],
        ["batch", "{zero}", "-o", "{out}"],
        ["clip", "{pipe}", "-o", "{out}"],
        ["clip", "{list}", "-o", "{out}"],
        ["track", "{zero}", "-o", "{out}.facetake"],
        ["mend", "{pipe}", "-o", "{out}.facetake"],
        ["mend", "{take}", "-o", "{out}.facetake", "--punch-in", "{pipe}"],
        ["import", "{pipe}", "-o", "{out}.facetake"],
        ["export", "{pipe}", "-o", "{out}.csv"],
        ["select", "{pipe}"],
        ["landmarks", "{pipe}", "-o", "{out}.npz"],
    ],
    ids=" ".join,
)
def test_pipes_and_devices_are_not_read(take, tmp_path, capsys, line):
    places = {"take": take, "out": tmp_path / "out", "pipe": tmp_path / "pipe", "zero": tmp_path / "zero.mp4"}
    os.mkfifo(places["pipe"])
    places["zero"].symlink_to("/dev/zero")
    places["list"] = tmp_path / "list.txt"
    places["list"].write_text("zero.mp4\n")
    assert cli.main([part.format(**places) for part in line]) == 1
    assert "is not a file but a pipe or a device" in capsys.readouterr().err


@pytest.mark.thorough
@needs_posix
def test_invalid_names_and_inaccessible_folders_are_clear_errors(take, tmp_path):
    """Run in a process that first drops the capabilities of root."""
    (tmp_path / "shut").mkdir()
    (tmp_path / "shut").chmod(0)
    write_image(tmp_path / "a.png", np.zeros((8, 8, 3), np.uint8))
    lines = []
    for bad in (tmp_path / "shut" / "name", tmp_path / ("x" * 300)):
        out, png = tmp_path / "out", tmp_path / "a.png"
        lines += [
            ["track", f"{bad}.mp4", "-o", f"{out}.facetake"],
            ["track", SAMPLE, "-o", f"{bad}.facetake"],
            ["landmarks", f"{bad}.png", "-o", f"{out}.npz"],
            ["landmarks", bad, "-o", f"{out}.npz"],
            ["landmarks", bad.parent if bad.parent.name == "shut" else bad, "-o", f"{out}.npz"],
            ["landmarks", png, "-o", f"{bad}.npz"],
            ["landmarks", png, "-o", f"{out}.npz", "--overlay", bad],
            ["select", f"{bad}.facetake"],
            ["select", take, "-o", f"{bad}.json"],
            ["mend", f"{bad}.facetake", "-o", f"{out}.facetake"],
            ["mend", take, "-o", f"{bad}.facetake"],
            ["mend", take, "-o", f"{out}.facetake", "--punch-in", f"{bad}.facetake"],
            ["mend", take, "-o", f"{out}.facetake", "--figure", f"{bad}.png"],
            ["export", f"{bad}.facetake", "-o", f"{out}.csv"],
            ["export", take, "-o", f"{bad}.csv"],
            ["import", f"{bad}.csv", "-o", f"{out}.facetake"],
            ["clip", f"{bad}.mp4", "-o", out],
            ["clip", bad, "-o", out],
            ["clip", SAMPLE, "-o", bad],
            ["batch", bad, "-o", out],
            ["batch", f"{bad}.txt", "-o", out],
            ["batch", bad.parent if bad.parent.name == "shut" else bad, "-o", out],
            ["batch", SAMPLE, "-o", bad],
        ]
    script = (
        "import ctypes, json, os, sys\n"
        "from facemime.cli import main as cli\n"
        "if os.geteuid() == 0:\n"
        "    libc = ctypes.CDLL(None)\n"
        "    for power in (1, 2):\n"  # CAP_DAC_OVERRIDE and CAP_DAC_READ_SEARCH
        "        libc.prctl(24, power, 0, 0, 0)\n"
        "    if 'once' not in sys.argv:\n"
        "        os.execv(sys.executable, [sys.executable, '-c', os.environ['SCRIPT'], 'once'])\n"
        "if os.access(os.environ['SHUT'], os.X_OK): sys.exit(77)\n"
        "for line in json.loads(os.environ['LINES']):\n"
        "    print(cli.main(line), *line, file=sys.stderr, flush=True)\n"
    )
    import json

    given = {"SCRIPT": script, "SHUT": str(tmp_path / "shut"), "LINES": json.dumps([[*map(str, x)] for x in lines])}
    done = subprocess.run(
        [sys.executable, "-c", script], env=os.environ | given, capture_output=True, text=True, check=False
    )
    (tmp_path / "shut").chmod(0o700)
    if done.returncode == 77:
        pytest.skip("this user may enter every folder")
    assert done.returncode == 0, done.stderr[-2000:]
    said = done.stderr.splitlines()
    assert len(said) == 2 * len(lines) and all(line.startswith("facemime: ") for line in said[::2]), done.stderr
    assert all(line.startswith("1 ") for line in said[1::2])
    assert not [line for line in said if "There is no video in" in line]


def test_a_list_of_clips_has_to_be_short_utf_8_text(tmp_path, monkeypatch):
    for encoding in ("utf-16", "utf-16-le", "utf-16-be"):
        (tmp_path / "list.txt").write_bytes("a.mp4\nb.mp4\n".encode(encoding))
        with pytest.raises(SourceError, match="a UTF-8 text"):
            find_clips([tmp_path / "list.txt"])
    from facemime.cli import clips

    monkeypatch.setattr(clips, "_MAX_LIST", 10)
    (tmp_path / "film.xyz").write_text("a" * 11)
    with pytest.raises(SourceError, match="nor a list of clips"):
        find_clips([tmp_path / "film.xyz"])
    (tmp_path / "list.txt").write_text("b.mp4\n")
    assert find_clips([tmp_path / "list.txt"]) == [tmp_path / "b.mp4"]


@needs_posix
def test_a_clip_whose_name_is_not_utf_8_is_refused(tmp_path):
    clip = Path(os.fsdecode(os.fsencode(tmp_path) + b"/a\xff.mp4"))
    try:
        clip.write_bytes(b"x")
    except OSError:
        pytest.skip("this file system refuses such names itself")
    with pytest.raises(SourceError, match=r"The name of .*a\\xff.mp4 is not valid UTF-8"):
        Namer(PuppetJob(clip, tmp_path / "out")).clip(clip)
    done = run("track", clip, "-o", tmp_path / "take.facetake")
    assert done.returncode == 1 and "not valid UTF-8" in done.stderr


@needs_posix
def test_a_folder_whose_name_is_not_utf_8_is_refused_even_as_working_directory(tmp_path):
    folder = Path(os.fsdecode(os.fsencode(tmp_path) + b"/a\xff"))
    try:
        folder.mkdir()
    except OSError:
        pytest.skip("this file system refuses such names itself")
    shutil.copy(SAMPLE, folder / "clip.mp4")
    done = run("track", "clip.mp4", "-o", "take.facetake", cwd=folder)
    assert done.returncode == 1 and r"a\xff/clip.mp4 is not valid UTF-8" in done.stderr


@pytest.mark.thorough
@needs_posix
def test_a_colon_in_the_name_of_a_video_does_not_make_it_an_address(tmp_path):
    for name in ("12:30.mp4", "http:a.mp4"):
        writer = cv2.VideoWriter(str(tmp_path / name), cv2.VideoWriter_fourcc(*"mp4v"), 25.0, (64, 48))
        for value in range(3):
            writer.write(np.full((48, 64, 3), value, np.uint8))
        writer.release()
        done = run("track", name, "-o", "take.facetake", cwd=tmp_path)
        assert done.returncode == 1 and "No face was found" in done.stderr


# Numbers


@pytest.mark.parametrize(
    "options",
    [
        ["select", "{take}", "--add", "0-999999999"],
        ["select", "{take}", "--remove", f"0-{HUGE}"],
        ["select", "{take}", "--add", HUGE],
        *(["select", "{take}", f"--tolerance={value}"] for value in (HUGE, "inf", "nan", "-1")),
        *(["select", "{take}", f"--max-points={value}"] for value in (HUGE, "nan", "1e3", "0")),
        *(["select", "{take}", f"--neutral={value}"] for value in (HUGE, "inf", "nan", "1e300")),
        *(["mend", "{take}", "-o", "{out}.facetake", f"--rate={value}"] for value in (HUGE, "nan", "1e300")),
        *(["mend", "{take}", "-o", "{out}.facetake", f"--shift={value}"] for value in (HUGE, "nan")),
        *(["mend", "{take}", "-o", "{out}.facetake", f"--neutral={value}"] for value in (HUGE, "nan")),
        *(["mend", "{take}", "-o", "{out}.facetake", f"--trim={value}:"] for value in (HUGE, "nan", "x" * 400)),
        *(["mend", "{take}", "-o", "{out}.facetake", "--punch-in", "{take}", f"--blend={v}"] for v in (HUGE, "nan")),
        ["mend", "{take}", "-o", "{out}.facetake", "--punch-in", HUGE],
        ["track", "{take}", "-o", "{out}.facetake", "--face", f"{HUGE},{HUGE}"],
        *(["clip", "{take}.mp4", "-o", "{out}", f"--number={value}"] for value in (HUGE, "nan", "-1")),
        *(["batch", "{take}.mp4", "-o", "{out}", f"--jobs={value}"] for value in (HUGE, "inf", "-1")),
    ],
    ids=lambda options: " ".join(options)[:60],
)
def test_an_impossible_number_is_a_clear_error(take, tmp_path, capsys, options):
    line = [part.format(take=take, out=tmp_path / "out") for part in options]
    try:
        status = cli.main(line)
    except SystemExit as usage:
        status = usage.code
    said = capsys.readouterr().err
    assert status in (1, 2) and said.splitlines()[-1].startswith("facemime")
    assert "Warning" not in said and set(os.listdir(tmp_path)) == {"take.facetake"}


# Messages


def test_names_cannot_control_the_terminal(tmp_path, capsys, monkeypatch):
    name = "a\x1b]0;mine\x07\x9b31m\u202egpj.mp4\nfacemime: done"
    seen = r"a\x1b]0;mine\x07\x9b31m\u202egpj.mp4\nfacemime: done"
    assert printable(name) == seen and printable("Übung \u202f 12:30 é.mp4") == "Übung \u202f 12:30 é.mp4"
    assert printable("a\udcff.mp4") == r"a\xff.mp4"
    say(f"{name}\n\x1b")
    tell(name)
    assert capsys.readouterr() == (f"{seen}\n\\x1b\n".replace(r"\nfacemime", "\nfacemime"), f"{seen}\n")
    Progress(f"Tracking {name}").finish(name)
    for line in (["track", name, "-o", "x.facetake"], ["mend", "a", "-o", name], [name], ["track", "--face", name]):
        try:
            cli.main(line)
        except SystemExit as usage:
            assert usage.code == 2
    said = capsys.readouterr()
    assert not {"\x1b", "\x07", "\x9b", "\u202e"} & set(said.err + said.out) and seen in said.err


def test_what_the_code_page_of_a_terminal_lacks_is_escaped():
    code = "from facemime.cli.stopping import open_standard_streams as open; open()\n"
    code += "from facemime.cli.console import say, tell; say('\u0141\xf3d\u017a \u6d4b.mp4'); tell('\u0141')"
    environment = os.environ | {"PYTHONIOENCODING": "cp1252"}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, check=False)
    assert done.stdout.decode("cp1252").strip() == r"\u0141\xf3d\u017a \u6d4b.mp4".replace(r"\xf3", "\xf3"), done.stderr
    assert done.stderr.decode("cp1252").strip() == r"\u0141"


class Terminal(io.StringIO):
    """A terminal that may not understand escape codes."""

    def isatty(self) -> bool:
        return True


def test_a_terminal_without_escape_codes_gets_none(monkeypatch):
    monkeypatch.setenv("TERM", "dumb")
    terminal = Terminal()
    monkeypatch.setattr(console.sys, "stdout", terminal)
    screen, progress = Screen(), Progress("Working", 3, terminal)
    for number in range(3):
        monkeypatch.setattr(console.time, "perf_counter", lambda number=number: 1e6 + 10.0 * number)
        screen.show("shown")
        progress.update(number)
    progress.finish()
    shown = terminal.getvalue()
    assert shown.count("shown") == 3 and "\x1b" not in shown
    lines = shown.splitlines()[-1].split("\r")
    assert all(len(later) >= len(earlier) for earlier, later in pairwise(lines)), "the end of a line would remain"


@pytest.mark.parametrize("broken", [False, True])
def test_what_takes_long_is_announced_on_a_terminal_until_it_ends(monkeypatch, broken):
    terminal = Terminal()
    monkeypatch.setattr(console.sys, "stderr", terminal)
    with suppress(ValueError), console.announced("Baking\x1b ..."):
        shown = terminal.getvalue()
        if broken:
            raise ValueError
    assert shown == "Baking\\x1b ..."
    assert terminal.getvalue() == shown + "\r" + " " * len(shown) + "\r"


def test_nothing_is_announced_in_a_file(monkeypatch):
    file = io.StringIO()
    monkeypatch.setattr(console.sys, "stderr", file)
    with console.announced("Baking ..."):
        pass
    assert not file.getvalue()


# Signals


# Threads


@pytest.mark.parametrize(
    "line",
    [
        ["mend", "a.facetake", "-o", "b.facetake", "--hold", "--longest", "-1"],
        ["serve", "--video", "a.mp4", "--smoothing", "-1"],
        ["send", "--video", "a.mp4", "--to", "127.0.0.1", "--smoothing", "21"],
        ["receive", "-o", "a.facetake", "--delay", "2.1"],
    ],
)
def test_a_setting_out_of_range_is_refused_before_anything_is_read(line, capsys):
    with pytest.raises(SystemExit) as exit_:
        cli.main(line)
    assert exit_.value.code == 2 and "is not between 0 and" in capsys.readouterr().err
