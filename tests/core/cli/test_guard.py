"""Files of strangers are read in a child process, whose death is an error with a message."""

import os
import subprocess
import sys
import time

import pytest

from facemime.cli import guard
from facemime.core.errors import SourceError
from tests.helpers.commands import needs_posix, run

FILE = "/home/ada/head.glb"


@pytest.fixture
def child(monkeypatch):
    """Let a line of Python stand in for the command."""
    monkeypatch.setattr(guard, "own_command", lambda: [sys.executable, "-c", "import sys; exec(sys.argv[1])"])

    def start(code: str, *, orderly: bool = True) -> int:
        end = "import os; os.unlink(os.environ['FACEMIME_GUARD']); " if orderly else ""
        return guard.run_in_child([end + code], FILE)

    return start


def test_the_exit_status_of_a_child_is_that_of_the_command(child):
    assert child("sys.exit(0)") == 0 and child("sys.exit(3)") == 3


@needs_posix
@pytest.mark.parametrize("code", ["os._exit(0)", "os._exit(1)", "os.kill(os.getpid(), 11)", "os.abort()"])
def test_a_child_that_dies_without_a_word_is_an_error_that_names_the_file(child, code):
    with pytest.raises(
        SourceError, match=rf"{FILE} cannot be read: Blender crashed or ran out of memory\. .*export it"
    ):
        child(f"import os; {code}", orderly=False)


def test_a_leashed_process_that_is_terminated_ends_in_an_orderly_way(tmp_path):
    script = f"""
import time
from pathlib import Path
from facemime.cli.stopping import STOPPING, follow_stdin
STOPPING.install()
follow_stdin()
STOPPING.run()
try:
    Path({str(tmp_path / "started")!r}).touch()
    while True:
        time.sleep(0.01)
except KeyboardInterrupt:
    Path({str(tmp_path / "ended")!r}).touch()
"""
    with guard.leashed([sys.executable, "-c", script]) as process:
        while not (tmp_path / "started").exists():
            time.sleep(0.01)
        process.terminate()
    assert (tmp_path / "ended").exists()


def test_a_child_that_the_system_interrupts_itself_is_awaited(child, monkeypatch):
    wait, heard = subprocess.Popen.wait, []

    def interrupted(self, timeout=None):
        if not heard:
            heard.append(True)
            raise KeyboardInterrupt
        return wait(self, timeout)

    def refuse(self, number):
        raise ValueError("Unsupported signal: 2")  # as on Windows

    monkeypatch.setattr(subprocess.Popen, "wait", interrupted)
    monkeypatch.setattr(subprocess.Popen, "send_signal", refuse)
    assert child("sys.exit(130)") == 130 and heard


@needs_posix
def test_a_child_that_takes_too_long_says_so(child):
    with pytest.raises(SourceError, match="it took too long"):
        child("import os, signal; os.kill(os.getpid(), signal.SIGXCPU)", orderly=False)


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not limit memory")
def test_memory_and_time_are_limited_while_a_file_is_read(tmp_path):
    (tmp_path / "head.glb").write_bytes(b"x")
    code = f"""
import resource, pathlib
from facemime.cli import guard
kinds = resource.RLIMIT_DATA, resource.RLIMIT_CPU
before = [resource.getrlimit(kind) for kind in kinds]
with guard.limited(pathlib.Path({str(tmp_path / "head.glb")!r})):
    assert all(resource.getrlimit(kind)[0] > 0 for kind in kinds)
    assert resource.getrlimit(resource.RLIMIT_CPU)[0] < 100
    small = bytearray(100 << 20)
    try:
        large = bytearray(3 << 30)
    except MemoryError:
        print("limited")
assert [resource.getrlimit(kind) for kind in kinds] == before
"""
    environment = {**os.environ, "FACEMIME_GUARD": str(tmp_path / "mark")}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and done.stdout == "limited\n", done.stderr


@pytest.mark.parametrize("suffix", ["glb", pytest.param("abc", marks=pytest.mark.thorough)])
def test_a_file_that_is_no_model_at_all_is_a_single_line(tmp_path, suffix):
    pytest.importorskip("bpy")
    (tmp_path / f"a.{suffix}").write_bytes(b"nonsense" * 9)
    done = run("bind", tmp_path / f"a.{suffix}", "-o", tmp_path / "out.blend")
    assert done.returncode == 1 and len(done.stderr.splitlines()) == 1, done.stderr
    assert done.stderr.startswith("facemime: ") and not (tmp_path / "out.blend").exists()
