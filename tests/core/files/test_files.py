"""Outputs are complete, never replace inputs, belong to one run, and leave no temporary files."""

from __future__ import annotations

import errno
import os
import stat
import subprocess
import sys
import tempfile
import time
from io import FileIO
from pathlib import Path

import pytest

from facemime.core.errors import OutputError
from facemime.core.files import locks
from facemime.core.files import writing as files
from facemime.core.files.locks import holding, lock_of, sweep, temporary_folder
from facemime.core.files.owner_only import write_secret
from facemime.core.files.writing import check_distinct, check_writable, claimed, free_name, replacing, settle
from tests.helpers.owners import UNDER_WINE, who_can_open

needs_posix = pytest.mark.skipif(os.name != "posix", reason="permissions and links as POSIX has them")


@pytest.fixture
def stuck(monkeypatch):
    """Make it impossible to replace files called old.csv or old.facetake, as if they were mount points."""
    rename = os.replace

    def replace(source, target):
        if Path(target).stem == "old":
            raise OSError(errno.EBUSY, "Device or resource busy")
        rename(source, target)

    monkeypatch.setattr(files.os, "replace", replace)


def in_another_process(text: str, *arguments: object) -> subprocess.Popen:
    """Start Python with the program `text`; its standard output is read."""
    line = [sys.executable, "-c", f"import sys, time; from pathlib import Path\n{text}", *map(str, arguments)]
    return subprocess.Popen(line, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def test_a_result_that_cannot_replace_the_output_is_kept_under_another_name(stuck, tmp_path):
    (tmp_path / "old.csv").write_text("old")
    for name in ("old-2.csv", "old-3.csv"):
        with pytest.raises(OutputError, match=rf"The result is in .*{name}"), replacing(tmp_path / "old.csv") as path:
            path.write_text("new")
        assert (tmp_path / name).read_text() == "new"
    assert sorted(os.listdir(tmp_path)) == ["old-2.csv", "old-3.csv", "old.csv"]


def test_a_take_that_cannot_be_moved_stays_in_place(stuck, tmp_path):
    finished, old = tmp_path / "old.unfinished.facetake", tmp_path / "old.facetake"
    finished.write_text("new")
    old.write_text("old")
    with pytest.raises(OutputError, match="resource busy"):
        settle(finished, old)
    assert finished.read_text() == "new" and old.read_text() == "old"


def test_a_failure_removes_only_the_temporary_file(tmp_path):
    (tmp_path / "a.csv").write_text("old")
    with pytest.raises(ZeroDivisionError), replacing(tmp_path / "a.csv") as path:
        path.write_text("new")
        raise ZeroDivisionError
    assert (tmp_path / "a.csv").read_text() == "old" and os.listdir(tmp_path) == ["a.csv"]


@needs_posix
def test_permissions_are_kept_when_a_file_is_replaced(tmp_path):
    before = os.umask(0o027)
    try:
        (tmp_path / "private.csv").touch()
        (tmp_path / "private.csv").chmod(0o600)
        for name, mode in (("private.csv", 0o600), ("new.csv", 0o640)):
            with replacing(tmp_path / name) as path:
                path.write_text("new")
            assert stat.S_IMODE((tmp_path / name).stat().st_mode) == mode
            (tmp_path / "finished").write_text("newer")
            settle(tmp_path / "finished", tmp_path / name)
            assert stat.S_IMODE((tmp_path / name).stat().st_mode) == mode
    finally:
        os.umask(before)


@needs_posix
def test_a_link_stays_a_link_and_its_target_is_replaced(tmp_path):
    (tmp_path / "real").mkdir()
    for name in ("there.csv", "not there.csv"):
        link = tmp_path / name
        link.symlink_to(tmp_path / "real" / name)
        if name == "there.csv":
            (tmp_path / "real" / name).write_text("old")
        with replacing(link) as path:
            assert path.parent == tmp_path / "real"
            path.write_text("new")
        assert link.is_symlink() and (tmp_path / "real" / name).read_text() == "new"
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    with pytest.raises(OutputError, match="Cannot write"), replacing(tmp_path / "loop" / "a.csv"):
        raise AssertionError


@needs_posix
def test_an_output_that_is_an_input_is_refused_by_any_name(tmp_path):
    take = tmp_path / "take.facetake"
    take.touch()
    (tmp_path / "link").symlink_to(take)
    (tmp_path / "hard").hardlink_to(take)
    for output in (take, tmp_path / "link", tmp_path / "hard", tmp_path / "none" / ".." / "take.facetake"):
        with pytest.raises(OutputError, match="it is the take that is mended"):
            check_distinct([None, output], {"another": None, "the take that is mended": take})
    (tmp_path / "copy").touch()
    check_distinct([tmp_path / "copy", tmp_path / "new"], {"the take": take, "a missing one": tmp_path / "none"})


_IMPOSSIBLE = ("x" * 300 + ".csv", "a\0b.csv")


@pytest.mark.parametrize("name", (*_IMPOSSIBLE[UNDER_WINE:], "what?.csv") if os.name == "nt" else _IMPOSSIBLE)
def test_an_impossible_file_name_is_a_clear_error(tmp_path, name):
    with pytest.raises(OutputError, match=r"Choose (a shorter|another) name for the output"):
        check_writable(tmp_path / name)
    with pytest.raises(OutputError, match="Cannot write"), replacing(tmp_path / name):
        raise AssertionError


@needs_posix
def test_files_that_cannot_be_replaced_are_reported_before_the_work(tmp_path, monkeypatch):
    output = tmp_path / "take.facetake"
    output.touch()
    check_writable(output)
    access = os.access
    monkeypatch.setattr(files.os, "access", lambda path, mode: Path(path) != output and access(path, mode))
    with pytest.raises(OutputError, match="write-protected"):
        check_writable(output)
    monkeypatch.undo()
    tmp_path.chmod(0o1777)
    monkeypatch.setattr(files.os, "geteuid", lambda: 4242)  # a user who owns neither the file nor the folder
    with pytest.raises(OutputError, match="only its owner"):
        check_writable(output)
    monkeypatch.undo()
    os.mkfifo(tmp_path / "pipe.csv")
    with pytest.raises(OutputError, match="a pipe or a device"):
        check_writable(tmp_path / "pipe.csv")


def test_an_output_is_claimed_until_its_process_ends_or_crashes(tmp_path):
    output = tmp_path / "made" / "take.facetake"
    text = (
        "from facemime.core.files.writing import claimed\n"
        "with claimed(Path(sys.argv[1])):\n    print('mine', flush=True)\n    sys.stdin.read()"
    )
    for end in ("leave", "kill"):
        with in_another_process(text, output) as other:
            assert other.stdout.readline() == "mine\n"
            with pytest.raises(OutputError, match="Another facemime is writing"), claimed(output):
                raise AssertionError
            with claimed(output.with_name("another.facetake")):
                pass
            if end == "kill":
                other.kill()
            else:
                other.stdin.close()
        assert output.parent.exists() == (end == "kill")
        with claimed(output):
            assert lock_of(output).exists()
        assert not output.parent.exists() or not os.listdir(output.parent)


def test_the_next_run_deletes_only_what_a_killed_one_left(tmp_path):
    text = (
        "from facemime.core.files.writing import replacing\n"
        "with replacing(Path(sys.argv[1])) as path:\n    print(path.name, flush=True)\n    time.sleep(600)"
    )
    kept = {".facemime-notes.txt", ".out-abc.mp4", "a.lock", ".facemime-0123456789abcdef.mp4"}
    for name in kept:
        (tmp_path / name).touch()
    with in_another_process(text, tmp_path / "a.mp4") as dead, in_another_process(text, tmp_path / "b.mp4") as alive:
        waste, used = dead.stdout.readline().strip(), alive.stdout.readline().strip()
        assert {waste, used} < set(os.listdir(tmp_path))
        dead.kill()
        dead.wait()
        with claimed(tmp_path / "c.mp4"):
            pass
        left = set(os.listdir(tmp_path))
        assert kept < left and waste not in left and used in left and len(left) == len(kept) + 2
        alive.kill()
    sweep(tmp_path)
    assert set(os.listdir(tmp_path)) == kept
    sweep(tmp_path / "none")


def test_the_next_run_deletes_the_pictures_of_a_killed_preview(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", None)
    text = (
        "from facemime.core.files.locks import temporary_folder\n"
        "with temporary_folder() as path:\n    (path / 'a.jpg').touch()\n"
        "    print(path, flush=True)\n    time.sleep(600)"
    )
    with in_another_process(text) as dead, in_another_process(text) as alive:
        waste, used = Path(dead.stdout.readline().strip()), Path(alive.stdout.readline().strip())
        assert waste.parent == used.parent == tmp_path and list(waste.iterdir())
        dead.kill()
        dead.wait()
        with temporary_folder() as folder:
            assert folder.parent == tmp_path and not list(folder.iterdir())
        assert not waste.exists() and list(used.iterdir()) and not folder.exists()
        alive.kill()


def test_outputs_are_written_on_file_systems_without_locks(tmp_path, monkeypatch):
    if sys.platform == "win32":
        pytest.skip("it has them")
    from facemime.core.files import locks

    def refuse(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(locks.fcntl, "flock", refuse)
    with claimed(tmp_path / "a.csv"), replacing(tmp_path / "a.csv") as path:
        path.write_text("new")
    assert (tmp_path / "a.csv").read_text() == "new"


def test_a_held_lock_is_awaited_for_the_given_time(tmp_path):
    with holding(tmp_path / "lock") as first, holding(tmp_path / "lock", 0.0) as second:
        assert first and not second
    started = time.monotonic()
    with holding(tmp_path / "lock", 60.0) as held:
        assert held and time.monotonic() - started < 60.0
    assert not os.listdir(tmp_path)


@pytest.fixture
def scanner(monkeypatch):
    """Return a function that lets a virus scanner on Windows hold files for the next attempts to move them."""
    move, left = os.replace, []
    monkeypatch.setattr(files.sys, "platform", "win32")

    def replace(source, target):
        if left:
            left.pop()
            raise PermissionError(errno.EACCES, "The process cannot access the file")
        move(source, target)

    monkeypatch.setattr(files.os, "replace", replace)
    return lambda attempts: left.extend([None] * attempts)


def test_a_file_that_a_virus_scanner_holds_for_a_moment_is_written(scanner, tmp_path):
    scanner(3)
    with replacing(tmp_path / "a.csv") as path:
        path.write_text("new")
    scanner(3)
    (tmp_path / "b.unfinished.csv").write_text("new")
    settle(tmp_path / "b.unfinished.csv", tmp_path / "b.csv")
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"a.csv": "new", "b.csv": "new"}


def test_a_file_that_is_never_let_go_is_an_error(scanner, tmp_path, monkeypatch):
    monkeypatch.setattr(files, "_SCAN", 0.1)
    scanner(1000)
    (tmp_path / "b.unfinished.csv").write_text("new")
    with pytest.raises(OutputError, match="cannot access the file"):
        settle(tmp_path / "b.unfinished.csv", tmp_path / "b.csv")
    assert (tmp_path / "b.unfinished.csv").exists()


def test_a_secret_can_be_read_by_its_owner_alone(tmp_path):
    path = tmp_path / "key"
    path.touch()
    write_secret(path, b"long before", replace=True)
    write_secret(path, b"secret", replace=True)
    assert path.read_bytes() == b"secret" and who_can_open(path) == {"owner"}
    with pytest.raises(FileExistsError):
        write_secret(path, b"another")


def test_free_names_are_numbered(tmp_path):
    path = tmp_path / "a.unfinished.facetake"
    assert free_name(path) == path
    path.touch()
    assert free_name(path).name == "a.unfinished-2.facetake"


@pytest.mark.parametrize("platform", ["win32"] if sys.platform == "win32" else ["linux", "win32"])
def test_a_run_that_fails_leaves_no_lock_behind(tmp_path, monkeypatch, platform):
    path = tmp_path / "lock"
    monkeypatch.setattr("facemime.core.files.locks.sys.platform", platform)
    with pytest.raises(RuntimeError), locks._deleting(FileIO(path, "w"), path):
        raise RuntimeError
    assert not path.exists()
