"""Batches of real clips: locally, on Dask workers, and by the commands of the templates for render farms."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import quickjs

import facemime
from facemime.core.takes.file import load_take
from tests.helpers.clips import write_clips

ROOT = Path(facemime.__file__).parent
BIN = Path(sys.prefix) / "bin"
ENVIRONMENT = {**os.environ, "PATH": f"{BIN}{os.pathsep}{os.environ['PATH']}"}


def batch(*arguments: object) -> subprocess.CompletedProcess:
    """Run `facemime batch`."""
    command = [BIN / "facemime", "batch", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)


def records(folder: Path) -> list[Path]:
    return sorted(path for path in folder.glob("[!.]*.json") if path.name != "report.json")


@pytest.mark.thorough
def test_good_clips_succeed_bad_ones_are_reported_and_finished_ones_are_skipped(tmp_path):
    clips, out = write_clips(tmp_path / "clips", 2), tmp_path / "out"
    shutil.copy(clips / "0.mp4", clips / "copy.mp4")
    (clips / "broken.mp4").write_text("nothing")
    (tmp_path / "list.txt").write_text(
        "clips/0.mp4\nclips/1.mp4\nclips/broken.mp4\nclips/copy.mp4\nclips/missing.mp4\n"
    )
    done = batch(tmp_path / "list.txt", "-o", out, "--jobs", "2")
    assert done.returncode == 2 and "Traceback" not in done.stderr, done.stderr
    assert "broken.mp4 cannot be read as a video" in done.stderr and "missing.mp4 cannot be read" in done.stderr
    first = {path.name: path.stat().st_mtime_ns for path in records(out)}
    assert len(first) == 2 and not list(out.glob("*.lock")) and not list(out.glob("*unfinished*"))
    report = json.loads((out / "report.json").read_text())
    assert report["counts"] == {"done": 2, "skipped": 0, "failed": 2, "not reached": 0}
    assert {len(load_take(path)) for path in out.glob("*.facetake")} == {12}
    page = (out / "report.html").read_text()
    assert page.count("data:image/jpeg;base64,") == 4 and page.count("<svg") == 2
    assert batch(clips, "-o", out).returncode == 1
    assert {path.name: path.stat().st_mtime_ns for path in records(out)} == first
    assert json.loads((out / "report.json").read_text())["counts"]["skipped"] == 2


@pytest.mark.thorough
def test_ctrl_c_stops_the_batch_and_the_next_run_finishes_it(tmp_path):
    clips, out = write_clips(tmp_path / "clips", 3), tmp_path / "out"
    command = [BIN / "facemime", "batch", clips, "-o", out, "--jobs", "1"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        while not records(out):
            assert process.poll() is None
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        said = process.stderr.read()
    assert process.returncode == 130 and "Traceback" not in said, said
    assert "Run the same command again to continue" in said
    counts = json.loads((out / "report.json").read_text())["counts"]
    assert 1 <= counts["done"] < 3 and counts["failed"] <= 1
    assert batch(clips, "-o", out).returncode == 0 and len(records(out)) == 3


@pytest.fixture
def scheduler(tmp_path) -> Iterator[tuple[str, list[subprocess.Popen]]]:
    """Start a Dask scheduler and two workers; yield its address and the processes of the workers."""
    file = tmp_path / "scheduler.json"
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": tmp_path}
    dask = [sys.executable, "-m", "dask"]
    started = [
        subprocess.Popen([*dask, "scheduler", "--port", "0", "--no-dashboard", "--scheduler-file", file], **quiet)
    ]
    try:
        worker = [*dask, "worker", "--scheduler-file", file, "--nthreads", "1", "--no-nanny", "--no-dashboard"]
        started += [subprocess.Popen(worker, **quiet) for _ in range(2)]
        while not file.exists() or not file.read_text():
            assert started[0].poll() is None
            time.sleep(0.05)
        yield json.loads(file.read_text())["address"], started[1:]
    finally:
        for process in started:
            process.kill()
            process.wait()


@pytest.mark.thorough
def test_killing_a_worker_loses_no_clip_and_repeats_none(tmp_path, scheduler):
    address, workers = scheduler
    clips, out = write_clips(tmp_path / "clips", 4), tmp_path / "out"
    command = [BIN / "facemime", "batch", clips, "-o", out, "--dask", address]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        while not list(out.glob("*.unfinished.facetake")) and not records(out):
            assert process.poll() is None
            time.sleep(0.02)
        workers[0].kill()
        written = {}
        while process.poll() is None:
            for path in records(out):
                written.setdefault(path.name, path.stat().st_mtime_ns)
            time.sleep(0.05)
        said = process.stderr.read()
    assert process.returncode == 0, said
    now = {path.name: path.stat().st_mtime_ns for path in records(out)}
    assert len(now) == 4 and all(now[name] == at for name, at in written.items())
    assert json.loads((out / "report.json").read_text())["counts"]["done"] == 4


def flamenco_tasks(settings: dict) -> list[dict]:
    """Return the tasks that the Flamenco job type creates: name, command, and the tasks that each waits for."""
    engine = quickjs.Context()
    engine.eval(
        "const author = { Task: (name, type) => ({ name, type, commands: [], after: [],"
        " addCommand(c) { this.commands.push(c) }, addDependency(t) { this.after.push(t.name) } }),"
        " Command: (name, parameters) => ({ name, parameters }) };"
    )
    engine.eval((ROOT / "farm" / "facemime.js").read_text())
    engine.eval(
        f"const tasks = [];compileJob({{ settings: {json.dumps(settings)}, addTask: (task) => tasks.push(task) }});"
    )
    return json.loads(engine.eval("JSON.stringify(tasks)"))


@pytest.mark.thorough
def test_the_commands_of_the_flamenco_job_process_every_clip_and_write_the_report(tmp_path):
    clips, out = write_clips(tmp_path / "clips", 2), tmp_path / "out"
    settings = {
        "clips": str(clips),
        "tasks": 2,
        "output": str(out),
        "face": "left",
        "smoothing": 0.5,
        "nla": False,
        "keys": "cache",
    }
    tasks = flamenco_tasks(settings)
    assert [task["name"] for task in tasks] == ["clips 1/2", "clips 2/2", "report"]
    assert tasks[-1]["after"] == ["clips 1/2", "clips 2/2"]
    for task in tasks:
        (command,) = task["commands"]
        assert command["name"] == "exec"
        line = [command["parameters"]["exe"], *command["parameters"]["args"]]
        assert line[line.index("--face") + 1] == "left"
        done = subprocess.run(line, env=ENVIRONMENT, capture_output=True, text=True, timeout=300, check=False)
        assert done.returncode == 0, done.stderr
    assert json.loads((out / "report.json").read_text())["counts"]["skipped"] == 2 and len(records(out)) == 2
    for record in records(out):
        suffixes = {Path(name).suffix for name in json.loads(record.read_text())["outputs"]}
        assert suffixes == {".blend", ".facetake", ".png", ".pc2"}


def test_the_flamenco_job_declares_its_settings():
    engine = quickjs.Context()
    engine.eval((ROOT / "farm" / "facemime.js").read_text())
    settings = json.loads(engine.eval("JSON.stringify(JOB_TYPE)"))["settings"]
    assert [item["key"] for item in settings if item.get("required")] == ["clips", "output"]
    # What Flamenco's published job types use.
    known = {"key", "type", "subtype", "choices", "default", "propargs", "required", "visible", "editable", "eval"}
    assert {name for item in settings for name in item} <= known | {"evalInfo", "label", "description"}
    assert {item["type"] for item in settings} <= {"string", "int32", "float", "bool"}
    assert {item.get("subtype", "dir_path") for item in settings} <= {"file_path", "dir_path", "file_name"}


@pytest.mark.thorough
def test_the_open_job_description_processes_every_clip_and_writes_the_report(tmp_path):
    clips, out = write_clips(tmp_path / "clips", 2), tmp_path / "out"
    template = ROOT / "farm" / "facemime.openjd.yaml"
    line = [BIN / "openjd", "run", template, "--step", "Report", "--run-dependencies"]
    for parameter in (f"Clips={clips}", "Tasks=2", f"Output={out}"):
        line += ["-p", parameter]
    done = subprocess.run(line, env=ENVIRONMENT, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert json.loads((out / "report.json").read_text())["counts"]["skipped"] == 2
    assert len(records(out)) == 2 and "Chunks run: 3" in done.stdout
    refused = subprocess.run([*line, "-p", "Face=nobody"], env=ENVIRONMENT, capture_output=True, text=True, check=False)
    assert refused.returncode != 0 and "'nobody' is not a face" in refused.stdout
