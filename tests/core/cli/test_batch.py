"""Batches: finding and naming clips, their records and their processes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from facemime.cli import batch as cli_batch
from facemime.cli import clips, puppet, runners
from facemime.cli import main as cli
from facemime.cli.clips import (
    CHECKSUMS,
    Checksums,
    Clip,
    Namer,
    confidence_curve,
    find_clips,
    read_record,
    worst_frames,
    write_record,
)
from facemime.cli.guard import own_command
from facemime.cli.options import Parser, add_puppet_options, as_options, parse, puppet_job
from facemime.core.bake.bake_settings import BakeSettings
from facemime.core.drive.drive_settings import DriveSettings, PosingSettings
from facemime.core.errors import FacemimeError, OutputError, SourceError
from facemime.core.files.setting import settings_of
from facemime.core.files.writing import locked
from facemime.core.puppet.job import HeadFile, PuppetJob
from facemime.core.puppet.puppet_settings import PuppetSettings
from tests.helpers.takes import performance
from tools import farm

ROOT = Path(__file__).resolve().parents[3]
JOB = PuppetJob(Path("a.mp4"), Path("out"))


def test_clips_are_found_in_folders_and_lists_in_a_fixed_order(tmp_path):
    for name in ("b.mp4", "a.MOV", "notes.txt", "deep/c.webm", "._b.mp4", "a folder.mp4/notes.txt", "c.MTS"):
        (tmp_path / "clips" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "clips" / name).write_text(name)
    folder = [tmp_path / "clips" / name for name in ("a.MOV", "b.mp4", "c.MTS", "deep/c.webm")]
    assert find_clips([tmp_path / "clips"]) == folder
    (tmp_path / "list.txt").write_text("# mine\nclips/b.mp4\n\nnowhere.mp4\n")
    assert find_clips([tmp_path / "list.txt"]) == [tmp_path / "clips" / "b.mp4", tmp_path / "nowhere.mp4"]
    assert len(find_clips([tmp_path / "clips", tmp_path / "clips" / "b.mp4"])) == 5
    assert find_clips([tmp_path / "clips" / "c.MTS"]) == [tmp_path / "clips" / "c.MTS"]
    (tmp_path / "empty").mkdir()
    (tmp_path / "binary").write_bytes(b"\xff\xfe\x00")
    for source, words in (
        ("empty", "no video in"),
        ("missing", "nor a list of clips"),
        ("binary", "nor a list of clips"),
    ):
        with pytest.raises(SourceError, match=words):
            find_clips([tmp_path / source])


def test_a_clip_keeps_its_name_until_its_content_or_a_setting_changes(tmp_path):
    clip, copy, head = tmp_path / "a.mp4", tmp_path / "b.mp4", tmp_path / "own.blend"
    for path in (clip, copy, head):
        path.write_text("one")
    name = Namer(JOB).clip(clip).name
    assert name.startswith("a-") and Namer(replace(JOB)).clip(clip).name == name
    assert Namer(JOB).clip(copy).name[2:] == name[2:]
    planar = replace(JOB, settings=PuppetSettings(drive=DriveSettings(mode="planar")))
    assert Namer(planar).clip(clip).name != name
    own, other = (replace(JOB, head=HeadFile(head, obj)) for obj in ("Face", "Other"))
    before = Namer(own).clip(clip).name
    assert Namer(other).clip(clip).name != before != name
    head.write_text("two")
    assert Namer(own).clip(clip).name != before
    clip.write_text("two")
    assert Namer(JOB).clip(clip).name != name
    with pytest.raises(SourceError, match=r"no such file|file not found|cannot find the"):
        Namer(JOB).clip(tmp_path / "none.mp4")
    with pytest.raises(SourceError, match=r"no such file|file not found|cannot find the"):
        Namer(replace(JOB, head=HeadFile(Path("none.blend"), "Face")))


@pytest.mark.parametrize(
    "settings",
    [
        PuppetSettings(),
        PuppetSettings(smoothing=0.0, rotation=False, drive=DriveSettings(kernel="gaussian", mirror=True)),
        PuppetSettings(
            translation=True,
            drive=DriveSettings(strength_lower=0.125, posing=PosingSettings(eyes_limit=0.3, location_limit=2.0)),
            bake=BakeSettings(keys="mapped", max_keys=7, clean=0.005, nla=True),
        ),
    ],
    ids=["default", "few", "many"],
)
def test_a_job_survives_conversion_to_options_and_back(tmp_path, settings):
    files = {"points": tmp_path / "p.json", "map": tmp_path / "m.json" if settings.bake.keys == "mapped" else None}
    job = replace(JOB, settings=settings, face=(320.0, 12.0), head=HeadFile(tmp_path / "a.blend", "Face"), **files)
    parser = Parser()
    add_puppet_options(parser)
    read = puppet_job(parse(parser, as_options(job)), source=job.source, output=job.output)
    assert replace(read, settings=settings) == job
    for ours, theirs in zip(_numbers(read.settings), _numbers(settings), strict=True):
        assert ours == (pytest.approx(theirs, rel=1e-9) if type(theirs) is float else theirs)


@pytest.mark.parametrize(
    ("line", "positive"),
    [
        ([], False),
        (["--gltf", "out.glb"], True),
        (["--gltf", "out.glb", "--no-positive"], False),
        (["--no-positive", "--gltf", "out.glb"], False),
        (["--positive"], True),
    ],
)
def test_an_explicit_choice_of_positive_values_wins_over_gltf(line, positive):
    parser = Parser()
    puppet.add_commands(parser.add_subparsers())
    options = parse(parser, ["puppet", "a.facetake", "-o", "a.blend", *line])
    assert puppet_job(options).settings.bake.positive is positive


def _numbers(settings: PuppetSettings) -> list[object]:
    groups = (settings, settings.drive, settings.drive.posing, settings.bake)
    return [getattr(group, name) for group in groups for name in settings_of(type(group))]


def test_the_farm_templates_have_every_option_that_a_clip_has():
    assert (ROOT / "farm" / "facemime.openjd.yaml").read_text() == farm.openjd(), "run tools/farm.py"
    assert (ROOT / "farm" / "facemime.js").read_text() == farm.flamenco(), "run tools/farm.py"


def test_a_clip_is_done_if_its_record_and_outputs_exist(tmp_path):
    job = Clip(tmp_path / "a.mp4", "a-0")
    assert read_record(job, tmp_path) is None
    outputs = [job.output(tmp_path, suffix) for suffix in (".blend", ".facetake", ".pc2", ".png")]
    for path in (*outputs, job.output(tmp_path, ".lock")):
        path.touch()
    write_record(job, tmp_path, performance(), 1.0, {"1": b"jpeg"})
    record = read_record(job, tmp_path)
    assert record["outputs"] == [path.name for path in outputs]
    outputs[2].unlink()
    assert read_record(job, tmp_path) is None
    outputs[2].touch()
    assert (record["frames"], record["found"], record["clip"]) == (60, 59, "a.mp4")
    for broken in ("", "[]", '{"outputs": ', "{}"):
        job.output(tmp_path, ".json").write_text(broken)
        assert read_record(job, tmp_path) is None


def test_the_worst_frames_are_the_least_certain_ones_some_time_apart():
    take = performance(100)
    take.confidence[:] = 0.9
    take.confidence[[10, 11, 70]] = (0.1, 0.2, 0.3)
    assert worst_frames(take) == [10, 50, 70]
    curve = confidence_curve(performance(1000))
    assert len(curve) == 300 and min(curve) == 0.0 and max(curve) == 1.0
    assert len(worst_frames(performance(2))) == 1


@pytest.fixture
def done(tmp_path) -> tuple[Clip, Path, dict]:
    """A finished clip, the path of its record, and its content."""
    job = Clip(tmp_path / "a.mp4", "a-1")
    job.output(tmp_path, ".blend").write_bytes(b"x")
    write_record(job, tmp_path, performance(), 1.0, {"1": b"jpeg"})
    path = job.output(tmp_path, ".json")
    return job, path, json.loads(path.read_text())


@pytest.mark.parametrize(
    "key", ["clip", "outputs", "frames", "found", "length", "seconds", "confidence", "worst", "pictures"]
)
def test_a_clip_whose_record_lacks_a_part_is_not_done(done, key):
    job, path, record = done
    assert read_record(job, path.parent) == record
    path.write_text(json.dumps({name: value for name, value in record.items() if name != key}))
    assert read_record(job, path.parent) is None


@pytest.mark.parametrize(
    ("key", "value"),
    [
        *(("found", value) for value in (61, -1, "<b>", True, 1e300, 10**400)),
        *(("length", value) for value in (float("nan"), float("inf"), "1", None)),
        *(("outputs", value) for value in ([], ["../a-1.blend"], ["/etc/passwd"], ["a\\b"], [""], [3], "a-1.blend")),
        *(("confidence", value) for value in (["<script>"], [2.0], [float("nan")], 3, [0.5] * 5000)),
        *(("worst", value) for value in (["x"], [[]], [None])),
        *(("pictures", value) for value in (["../a.jpg"], ["/etc/passwd"], [3], {})),
        ("clip", ["a"]),
        *(("missing", value) for value in (3, None, "x" * 2000)),
    ],
)
def test_a_clip_with_an_invalid_record_is_not_done(done, key, value):
    job, path, record = done
    path.write_text(json.dumps(record | {key: value}))
    assert read_record(job, path.parent) is None


def test_a_clip_that_was_done_just_before_the_interruption_is_reported_as_done(tmp_path, monkeypatch):
    for name in ("a.mp4", "b.mp4"):
        (tmp_path / name).write_text(name)
    out = tmp_path / "out"
    job = PuppetJob(tmp_path / "a.mp4", out)

    class Interrupted:
        """Finishes the first clip, and is interrupted before it says so."""

        def __init__(self, _: int) -> None:
            pass

        def run(self, paths, _):
            clip = Namer(job, Checksums(out)).clip(Path(paths[0]))
            clip.output(out, ".blend").write_bytes(b"x")
            write_record(clip, out, performance(), 1.0, {"1": b"jpeg"})
            raise KeyboardInterrupt
            yield

        def close(self) -> None:
            pass

    monkeypatch.setattr(cli_batch, "LocalRunner", Interrupted)
    assert cli_batch._run_batch(job, [tmp_path / "a.mp4", tmp_path / "b.mp4"], 1, None) == 130
    assert json.loads((out / "report.json").read_text())["counts"] == {
        "done": 1,
        "skipped": 0,
        "failed": 0,
        "not reached": 1,
    }


def test_checksums_are_kept_by_size_and_time(tmp_path, monkeypatch):
    clip, out = tmp_path / "a.mp4", tmp_path / "out"
    out.mkdir()
    clip.write_text("one")
    os.utime(clip, (1e9, 1e9))
    first = Checksums(out).of(clip)
    (out / CHECKSUMS).write_text((out / CHECKSUMS).read_text() + 'half a line\n["x", 1]\n["y", 1, 1, "zz"]\n')
    with monkeypatch.context() as patch:
        patch.setattr(clips.hashlib, "file_digest", None)
        assert Checksums(out).of(clip) == first
    clip.write_text("two")
    os.utime(clip, (1e9 + 5, 1e9 + 5))
    assert Checksums(out).of(clip) != first


def test_the_checksum_of_a_file_that_has_just_changed_is_not_kept(tmp_path):
    clip = tmp_path / "a.mp4"
    clip.write_text("one")
    Checksums(tmp_path).of(clip)
    assert not (tmp_path / CHECKSUMS).exists()


_WORKER = """
import json, os, sys
for name in sys.argv[2:]:
    if name == "abort":
        os.abort()
    if name == "leave":
        sys.exit("no head")
    print("something else")
    print(json.dumps({"clip": name, "status": int(name == "bad"), "said": name}), flush=True)
"""


@pytest.fixture
def workers(monkeypatch):
    """Processes that only say what became of clips."""
    monkeypatch.setattr(runners, "own_command", lambda: [sys.executable, "-c", _WORKER])


@pytest.mark.parametrize("together", [1, 3, 16])
def test_a_crashed_or_failed_process_does_not_stop_other_clips(workers, monkeypatch, together):
    monkeypatch.setattr(runners, "_TOGETHER", together)
    names = ["abort", "leave", "one", "bad", *["more"] * 20, "abort", "last"]
    runner = runners.LocalRunner(2)
    ended = sorted(runner.run(names, []), key=lambda outcome: outcome.index)
    runner.close()
    runner.close()
    assert [outcome.index for outcome in ended] == list(range(len(names)))
    failed = {name: {outcome.status for outcome in ended if names[outcome.index] == name} for name in names}
    assert failed["one"] == failed["more"] == failed["last"] == {0} and failed["bad"] == failed["leave"] == {1}
    assert 0 not in failed["abort"] and ended[1].said == "no head" and ended[3].said == "bad"


def test_clips_whose_process_cannot_be_started_have_failed(monkeypatch):
    monkeypatch.setattr(runners, "own_command", lambda: ["/nowhere/facemime"])
    runner = runners.LocalRunner(2)
    ended = sorted(runner.run(["one", "two", "three"], []), key=lambda outcome: outcome.index)
    runner.close()
    assert [(outcome.index, outcome.status) for outcome in ended] == [(0, 1), (1, 1), (2, 1)]
    assert all("no process could be started" in outcome.said for outcome in ended)


def test_a_task_of_several_clips_reports_those_that_it_began(workers):
    assert runners.run_clips(["one", "leave", "two"], []) == [(0, "one"), (1, "no head")]


def test_closing_a_runner_ends_running_and_drops_waiting_clips(monkeypatch, tmp_path):
    script = f"import sys, time; open({str(tmp_path)!r} + '/' + sys.argv[2], 'w').close(); time.sleep(600)"
    monkeypatch.setattr(runners, "own_command", lambda: [sys.executable, "-c", script])
    monkeypatch.setattr(runners, "_TOGETHER", 1)
    runner = runners.LocalRunner(1)
    thread = threading.Thread(target=lambda: ended.append(next(runner.run(["first", "second"], []))))
    ended: list[runners.Outcome] = []
    thread.start()
    while not (tmp_path / "first").exists():
        time.sleep(0.01)
    runner.close()
    thread.join()
    assert ended[0].index == 0 and ended[0].status != 0
    assert not (tmp_path / "second").exists()


def test_inside_blender_processes_are_started_through_blender(monkeypatch):
    monkeypatch.setitem(sys.modules, "bpy", SimpleNamespace(app=SimpleNamespace(binary_path="/opt/blender")))
    assert own_command() == ["/opt/blender", "--command", "facemime"]
    monkeypatch.setitem(sys.modules, "bpy", SimpleNamespace(app=SimpleNamespace(binary_path="")))
    assert own_command() == [sys.executable, "-m", "facemime.cli"]


def test_missing_dask_or_scheduler_is_a_clear_error(monkeypatch):
    with pytest.raises(FacemimeError, match="There is no Dask scheduler at nowhere"):
        runners.DaskRunner("nowhere://")
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(FacemimeError, match="pip install distributed"):
        runners.DaskRunner("tcp://127.0.0.1:1")


def test_dask_is_imported_only_if_requested():
    code = "import sys, facemime.cli.main; sys.exit('distributed' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_lock_is_exclusive_and_ends_with_its_process(tmp_path):
    lock, log = tmp_path / "a.lock", tmp_path / "log"
    script = (
        "import sys, time; from pathlib import Path; from facemime.core.files.writing import locked\n"
        "log = open(sys.argv[2], 'a')\n"
        "for i in range(10):\n"
        "    with locked(Path(sys.argv[1])):\n"
        "        log.write('in\\n'); log.flush(); time.sleep(0.005); log.write('out\\n'); log.flush()\n"
    )
    several = [subprocess.Popen([sys.executable, "-c", script, lock, log]) for _ in range(3)]
    assert [process.wait() for process in several] == [0, 0, 0]
    assert log.read_text() == "in\nout\n" * 30 and not lock.exists()
    holding = script.split("log =")[0] + "\nwith locked(Path(sys.argv[1])): print('in', flush=True); time.sleep(600)"
    with subprocess.Popen([sys.executable, "-c", holding, lock], stdout=subprocess.PIPE) as process:
        process.stdout.readline()
        process.kill()
    with locked(lock):
        assert lock.exists()
    (tmp_path / "file").touch()
    with pytest.raises(OutputError), locked(tmp_path / "file" / "a.lock"):
        raise AssertionError


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["batch", "{0}", "-o", "{0}/out"], "no video in"),
        (["batch", "{0}/a.mp4", "-o", "{0}/out", "--jobs", "0"], "must be at least 1"),
        (["batch", "{0}/a.mp4", "-o", "{0}/a.mp4"], "read-only|not a directory|folder"),
        (["clip", "{0}/list", "--number", "0", "-o", "{0}/out"], "--number 1 to --number 2"),
        (["clip", "{0}/list", "--number", "3", "-o", "{0}/out"], "--number 1 to --number 2"),
        (["clip", "{0}/list", "--number", "2", "-o", "{0}/out"], "cannot be read"),
        (["clip", "{0}/list", "--share", "2/2", "-o", "{0}/out"], "cannot be read"),
    ],
)
def test_impossible_batches_are_refused_before_anything_is_written(tmp_path, capsys, arguments, words):
    import re

    (tmp_path / "list").write_text("a.mp4\nb.mp4\n")
    if "no video" not in words:
        (tmp_path / "a.mp4").write_text("x")
    assert cli.main([argument.format(tmp_path) for argument in arguments]) == 1
    assert re.search(words, capsys.readouterr().err) and not (tmp_path / "out").exists()


@pytest.mark.parametrize("share", ["0/2", "3/2", "1", "1/0", "a/b", "-1/2"])
def test_a_share_that_is_none_is_refused(tmp_path, capsys, share):
    with pytest.raises(SystemExit):
        cli.main(["clip", str(tmp_path), f"--share={share}", "-o", str(tmp_path)])
    assert "not a share" in capsys.readouterr().err


def test_a_share_without_clips_is_done(tmp_path):
    (tmp_path / "list").write_text("a.mp4\nb.mp4\n")
    assert cli.main(["clip", str(tmp_path / "list"), "--share", "3/3", "-o", str(tmp_path / "out")]) == 0
