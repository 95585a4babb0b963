"""The process of the command: closed streams, a full disk, signals and threads."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from facemime.cli import console
from facemime.cli import main as cli
from facemime.cli.console import Progress
from facemime.cli.stopping import LEASH
from facemime.core.files.capture import write_image
from facemime.core.takes.file import load_take
from tests.helpers.commands import SAMPLE, START, needs_posix, run


def test_a_child_ends_in_an_orderly_way_with_its_input(tmp_path):
    code = """
import sys, time
from facemime.cli.stopping import STOPPING, follow_stdin
STOPPING.install()
follow_stdin()
import numpy
STOPPING.run()
try:
    print("ready", flush=True)
    while True:
        time.sleep(0.01)
except KeyboardInterrupt:
    print("ended", flush=True)
"""
    environment = os.environ | {LEASH: "1"}
    with subprocess.Popen(
        [sys.executable, "-c", code], env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as child:
        assert child.stdout.readline() == "ready\n"
        child.stdin.close()
        assert child.stdout.read() == "ended\n" and child.wait(60) == 0


class Full:
    """A stream on a full disk, or without a reader."""

    def write(self, text: str) -> int:
        raise BrokenPipeError

    def flush(self) -> None:
        raise BrokenPipeError

    def isatty(self) -> bool:
        return True


def test_closed_message_streams_are_not_errors(take, tmp_path, monkeypatch):
    for stream in (Full(), None):
        monkeypatch.setattr(console.sys, "stderr", stream)
        progress = Progress("Working", 3)
        progress.update(1)
        progress.finish()
        assert cli.main(["mend", str(take), "-o", str(tmp_path / "out.facetake")]) == 0
        assert cli.main(["mend", "none", "-o", str(tmp_path / "out.facetake")]) == 1


@pytest.mark.thorough
@needs_posix
def test_closed_streams_do_not_stop_the_command(take, tmp_path):
    mend = f"{sys.executable} -m facemime.cli mend {take} -o {tmp_path / 'out.facetake'}"
    helped = f"{sys.executable} -m facemime.cli --help"
    for line, status in (
        (f"{mend} 2>/dev/full", 0),
        (f"{mend} 2>&1 >/dev/null | true; exit ${{PIPESTATUS[0]}}", 0),
        (f"{mend} >&- 2>&- <&-", 0),
        (f"{mend} --nonsense 2>/dev/full", 2),
        (f"{helped} | true; exit ${{PIPESTATUS[0]}}", 0),
        (f"{helped} >/dev/full", 1),
    ):
        done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=False)
        assert done.returncode == status and "Traceback" not in done.stderr, (line, done.stderr)
    assert len(load_take(tmp_path / "out.facetake")) == 60


@pytest.mark.thorough
@needs_posix
def test_a_full_disk_is_reported_with_the_given_name(take, tmp_path):
    import resource

    def full() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))

    write_image(tmp_path / "a.png", np.zeros((8, 8, 3), np.uint8))
    lines = [["mend", take, "-o", tmp_path / "out.facetake"], ["export", take, "-o", tmp_path / "out.csv"]]
    lines += [["landmarks", *([tmp_path / "a.png"] * 40), "-o", tmp_path / "out.npz"]]
    for line in lines:
        done = run(*line, preexec_fn=full, env=os.environ | {"OPENCV_LOG_LEVEL": "OFF"})
        if line[0] != "landmarks" or done.returncode:
            (said,) = (text for text in done.stderr.splitlines() if text.startswith("facemime:"))
            assert done.returncode == 1 and str(line[-1]) in said and "Traceback" not in done.stderr, done.stderr
    assert not [name for name in os.listdir(tmp_path) if name.startswith(".")]


@needs_posix
@pytest.mark.parametrize(("by", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_during_start_up_ends_the_process_at_once_without_a_traceback(tmp_path, by, status):
    slow = tmp_path / "numpy.py"  # simulates a slow import
    slow.write_text("open('importing', 'w').close()\nimport time\nwhile True: time.sleep(0.01)\n")
    environment = os.environ | {"PYTHONPATH": str(tmp_path)}
    with subprocess.Popen([*START, "--version"], stderr=subprocess.PIPE, cwd=tmp_path, env=environment) as process:
        while not (tmp_path / "importing").exists():
            assert process.poll() is None
            time.sleep(0.005)
        process.send_signal(by)
        said = process.stderr.read()
    assert process.returncode == status and said == b"facemime: interrupted; nothing was written.\n"


@needs_posix
def test_an_interrupt_without_a_message_is_reported_in_a_full_sentence(take, monkeypatch, capsys):
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("facemime.cli.job_files.load_take", interrupt)
    assert cli.main(["export", str(take), "-o", str(take.with_suffix(".csv"))]) == 130
    assert capsys.readouterr().err == "facemime: interrupted. Files that were complete are kept.\n"


@pytest.mark.thorough
@needs_posix
def test_a_command_started_to_ignore_ctrl_c_ignores_it(tmp_path):
    unfinished = tmp_path / "take.unfinished.facetake"
    line = f"trap '' INT; exec {sys.executable} -m facemime.cli track {SAMPLE} -o {tmp_path / 'take.facetake'}"
    with subprocess.Popen(["bash", "-c", line], stderr=subprocess.DEVNULL) as process:
        while not unfinished.exists():
            assert process.poll() is None
            time.sleep(0.005)
        process.send_signal(signal.SIGINT)
    assert process.returncode == 0 and len(load_take(tmp_path / "take.facetake")) == 255


@pytest.mark.parametrize("chosen", [None, "4"])
def test_numpy_finds_one_thread_for_its_blas_unless_the_user_chose_a_number(tmp_path, chosen):
    (tmp_path / "numpy.py").write_text("import os\nprint(os.environ['OPENBLAS_NUM_THREADS'])\nos._exit(0)\n")
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    environment |= {"PYTHONPATH": str(tmp_path), "PYTHONUNBUFFERED": "1"}
    environment |= {} if chosen is None else {"OPENBLAS_NUM_THREADS": chosen}
    line = [*START, "--version"]
    done = subprocess.run(line, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.stdout == f"{chosen or 1}\n", done.stderr
