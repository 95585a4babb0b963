"""`facemime puppet` and `batch` with untrusted heads, full disks, closed streams and signals."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import bpy
import numpy as np
import pytest

import facemime
from facemime.blender.heads.new_heads import add_head
from facemime.blender.rendering import write_video
from facemime.cli.clips import CHECKSUMS
from facemime.core.errors import OutputError
from facemime.core.takes.file import load_take, save_take
from tests.helpers.commands import COMMAND, needs_posix
from tests.helpers.takes import performance

SAMPLE = Path(facemime.__file__).parent / "assets" / "sample" / "sample.mp4"


def run(*arguments: object, **options: object) -> subprocess.CompletedProcess:
    """Run `facemime`; options as for `subprocess.run`."""
    line = [*COMMAND, *map(str, arguments)]
    return subprocess.run(line, capture_output=True, text=True, timeout=300, check=False, **options)


@pytest.fixture
def take(tmp_path) -> Path:
    """A take of 60 frames in a file."""
    save_take(performance(), tmp_path / "take.facetake")
    return tmp_path / "take.facetake"


@contextlib.contextmanager
def started(*arguments: object, until: Path) -> Iterator[subprocess.Popen]:
    """Start `facemime`, and yield its process once the file `until` has frames."""
    with subprocess.Popen([*COMMAND, *map(str, arguments)], stderr=subprocess.PIPE, text=True) as process:
        while not (until.exists() and until.stat().st_size > 5_000):
            assert process.poll() is None
            time.sleep(0.005)
        yield process


@pytest.mark.thorough
def test_a_blocked_driver_does_not_keep_the_process_running(take, tmp_path):
    add_head(bpy.context)
    other = bpy.data.objects.new("Other", None)
    bpy.context.scene.collection.objects.link(other)
    other.driver_add("location", 0).driver.expression = "noise.random()"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "own.blend"))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    (tmp_path / "temporary").mkdir()
    done = run(
        "puppet", take, "-o", tmp_path / "out.blend", "--head", tmp_path / "own.blend",
        env=os.environ | {"TMPDIR": str(tmp_path / "temporary")},
    )  # fmt: skip
    assert done.returncode == 0 and (tmp_path / "out.blend").stat().st_size > 10_000
    assert not os.listdir(tmp_path / "temporary")


def test_a_head_from_another_file_runs_no_scripts(take, tmp_path):
    add_head(bpy.context)
    text = bpy.data.texts.new("boot.py")
    text.write(f"open({str(tmp_path / 'ran')!r}, 'w').close()")
    text.use_module = True
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "own.blend"))
    script = (
        "import bpy, sys; bpy.context.preferences.filepaths.use_scripts_auto_execute = True\n"
        "from facemime.cli.entry import _leave; from facemime.cli.main import main; _leave(main(sys.argv[1:]))"
    )
    line = ["puppet", take, "-o", tmp_path / "out.blend", "--head", tmp_path / "own.blend"]
    done = subprocess.run([sys.executable, "-c", script, *map(str, line)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out.blend").exists() and not (tmp_path / "ran").exists()


@pytest.mark.thorough
def test_no_output_may_be_one_of_the_inputs(take, tmp_path):
    assert run("puppet", take, "-o", tmp_path / "own.blend").returncode == 0
    before = (tmp_path / "own.blend").read_bytes()
    (tmp_path / "link.blend").symlink_to(tmp_path / "own.blend")
    for output, named in (("own.blend", "own.blend:Facemime Head"), ("link.blend", "own.blend")):
        done = run("puppet", take, "-o", tmp_path / output, "--head", tmp_path / named)
        assert done.returncode == 1 and "it is the file of the head" in done.stderr
    done = run("puppet", take, "-o", tmp_path / "out.blend", "--take", take)
    assert done.returncode == 1 and "it is the take that moves the head" in done.stderr
    assert (tmp_path / "own.blend").read_bytes() == before and len(load_take(take)) == 60


@needs_posix
@pytest.mark.parametrize(
    ("by", "status"), [(signal.SIGINT, 130), pytest.param(signal.SIGTERM, 143, marks=pytest.mark.thorough)]
)
def test_an_interrupted_puppet_keeps_earlier_output_and_the_tracked_part(take, tmp_path, by, status):
    (tmp_path / "out.interrupted.facetake").touch()
    for option, whole, part in (
        (("--take", take), take, "take.interrupted.facetake"),
        ((), None, "out.interrupted-2.facetake"),
    ):
        unfinished = tmp_path / f"{'take' if whole else 'out'}.unfinished.facetake"
        with started("puppet", SAMPLE, "-o", tmp_path / "out.blend", *option, until=unfinished) as process:
            process.send_signal(by)
            said = process.stderr.read()
        assert process.returncode == status and f"are in {tmp_path / part}." in said and "Traceback" not in said, said
        assert 0 < len(load_take(tmp_path / part)) < 255 and not unfinished.exists()
    assert len(load_take(take)) == 60 and not (tmp_path / "out.blend").exists()


@needs_posix
@pytest.mark.parametrize("by", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_blender_is_imported_is_not_lost_and_prints_no_traceback(take, tmp_path, by):
    package = tmp_path / "bpy.py"  # substitute for the real one, which handles signals itself during its import
    package.write_text(
        "import os, signal\n"
        "signal.signal(signal.SIGINT, lambda *_: None)\n"
        f"os.kill(os.getpid(), {int(by)})\n"
        "raise ImportError('not reached by a signal')\n"
    )
    environment = os.environ | {"PYTHONPATH": str(tmp_path)}
    done = run("puppet", take, "-o", tmp_path / "out.blend", env=environment)
    assert done.returncode == 128 + by and done.stderr == "facemime: interrupted; nothing was written.\n"


@needs_posix
@pytest.mark.thorough
def test_a_signal_while_rendering_leaves_no_partial_output(take, tmp_path):
    preview = tmp_path / "out.mp4"
    line = [*COMMAND, "puppet", take, "-o", tmp_path / "out.blend", "--preview", preview]
    with subprocess.Popen(line, stderr=subprocess.PIPE, text=True) as process:
        while not list(tmp_path.glob(".facemime-*.mp4")):
            assert process.poll() is None
            time.sleep(0.005)
        process.send_signal(signal.SIGTERM)
        said = process.stderr.read()
    assert process.returncode == 143 and "Files that were complete are kept." in said, said
    assert set(os.listdir(tmp_path)) == {"take.facetake", "out.blend"}


@needs_posix
@pytest.mark.thorough
def test_closed_or_full_streams_do_not_stop_the_puppet(take, tmp_path):
    line = f"{COMMAND[0]} puppet {take} -o {tmp_path / 'out.blend'}"
    for streams in (">&-", ">&- 2>&- <&-", "2>/dev/full", ">/dev/full"):
        done = subprocess.run(["bash", "-c", f"{line} {streams}"], capture_output=True, text=True, check=False)
        assert done.returncode == 0 and "Traceback" not in done.stderr, (streams, done.stderr)
        (tmp_path / "out.blend").unlink()


@pytest.fixture
def small_disk(tmp_path) -> Iterator[Path]:
    """A folder that holds 2 MB."""
    folder = tmp_path / "small"
    folder.mkdir()
    mount = shutil.which("mount")
    if sys.platform != "linux" or mount is None or os.geteuid() != 0:
        pytest.skip("only root of a Linux can make a small disk")
    made = subprocess.run([mount, "-t", "tmpfs", "-o", "size=2m", "tmpfs", folder], capture_output=True, check=False)
    if made.returncode:
        pytest.skip(f"this system gives no small disk: {made.stderr.decode().strip()}")
    yield folder
    subprocess.run(["umount", folder], check=True)


@pytest.mark.thorough
def test_a_full_disk_is_one_clear_error_wherever_it_is(take, small_disk, tmp_path):
    (small_disk / "fill").write_bytes(bytes(2_000_000))
    done = run(
        "puppet", take, "-o", tmp_path / "out.blend", "--sheet", tmp_path / "out.png",
        env=os.environ | {"TMPDIR": str(small_disk)},
    )  # fmt: skip
    assert done.returncode == 1 and f"Free some space in {small_disk}" in done.stderr and "Traceback" not in done.stderr
    for option, name in (("--preview", "out.mp4"), ("--sheet", "out.png"), ("-o", "out.blend")):
        output = small_disk / name
        other = [] if option == "-o" else ["-o", tmp_path / "out.blend"]
        done = run("puppet", take, option, output, *other)
        assert done.returncode == 1 and str(output) in done.stderr and "Traceback" not in done.stderr, done.stderr
        assert os.listdir(small_disk) == ["fill"]


@pytest.mark.thorough
def test_a_disk_that_is_full_from_the_start_is_reported_for_videos_and_reports(small_disk):
    (small_disk / "fill").write_bytes(bytes(2 << 20))
    with pytest.raises(OutputError, match=r"could not write .*out\.mp4\. Free some disk space"):
        write_video([np.zeros((64, 64, 3), np.uint8)] * 2, 25.0, small_disk / "out.mp4")
    assert os.listdir(small_disk) == ["fill"]
    done = run("batch", SAMPLE, "-o", small_disk / "out")
    errors = done.stderr.splitlines()
    assert done.returncode == 1 and "facemime: sample.mp4: Cannot write" in errors[-2] and "report" in errors[-1], (
        errors
    )


@needs_posix
@pytest.mark.thorough
def test_the_processes_of_a_killed_batch_end_and_the_next_run_cleans_up(tmp_path):
    out = tmp_path / "out"
    with subprocess.Popen([*COMMAND, "batch", SAMPLE, "-o", out, "--jobs", "1"], stderr=subprocess.DEVNULL) as process:
        while not list(out.glob("*.unfinished.facetake")):
            assert process.poll() is None
            time.sleep(0.005)
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
        tasks = children.parent.parent.glob("*/children") if children.exists() else []
        child = [int(number) for task in tasks for number in task.read_text().split()]
        process.kill()
    if not child:
        pytest.skip("this system does not tell whose child a process is")
    while any(Path(f"/proc/{number}/exe").exists() for number in child):
        time.sleep(0.02)
    (out / ".facemime-0123456789abcdef.lock").touch()  # left by a process that was killed
    (out / ".facemime-0123456789abcdef.mp4").touch()
    done = run("batch", SAMPLE, "-o", out)
    assert done.returncode == 0, done.stderr
    left = [name for name in os.listdir(out) if name.startswith(".") or name.endswith(".lock")]
    assert left == [CHECKSUMS]
    (whole,) = (path for path in out.glob("*.facetake") if "unfinished" not in path.name)
    assert len(load_take(whole)) == 255


@pytest.mark.thorough
@pytest.mark.skipif(sys.platform != "linux", reason="other systems refuse such names themselves")
def test_a_file_name_that_is_not_utf_8_stops_neither_puppet_nor_batch(take, tmp_path):
    clip = Path(os.fsdecode(os.fsencode(tmp_path) + b"/a\xff.mp4"))
    clip.write_bytes(b"x")
    for line in (
        ["puppet", clip, "-o", tmp_path / "out.blend"],
        ["puppet", take, "-o", clip.with_suffix(".blend")],
        ["puppet", take, "-o", tmp_path / "out.blend", "--head", clip],
        ["batch", clip, "-o", tmp_path / "out"],
    ):
        done = run(*line)
        assert done.returncode == 1 and "Traceback" not in done.stderr, done.stderr
        assert (r"a\xff" in done.stderr and "is not valid UTF-8. Rename it" in done.stderr) or line[0] == "batch"
    (tmp_path / "link.blend").symlink_to(clip.with_suffix(".blend"))
    folder = clip.with_suffix("")
    folder.mkdir()
    for line, options in (
        (["puppet", take, "-o", "out.blend"], {"cwd": folder}),
        (["puppet", take, "-o", tmp_path / "link.blend"], {}),
        (["puppet", take, "-o", tmp_path / "out.blend", "--sheet", tmp_path / "out.png"], {"TMPDIR": str(folder)}),
    ):
        done = run(*line, cwd=options.pop("cwd", None), env=os.environ | options)
        assert done.returncode == 1 and "is not valid UTF-8. Rename it" in done.stderr, done.stderr
    done = run("puppet", take, "-o", tmp_path / "2.blend", "--head", f"{tmp_path / 'out.blend'}:a\udcff")
    assert done.returncode == 1 and r"out.blend has no object a\xff. Choose one of: " in done.stderr, done.stderr
    assert r"a\\xff.mp4 is not valid UTF-8" in (tmp_path / "out" / "report.json").read_text()
