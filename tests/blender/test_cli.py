"""The command in a separate process, on real files."""

import contextlib
import os
import re
import signal
import subprocess
import tempfile
from pathlib import Path

import bpy
import cv2
import numpy as np
import pytest

import facemime
from facemime.blender import rendering
from facemime.blender.heads.new_heads import add_head
from facemime.blender.rigs import read_rig
from facemime.core.control_points.select import select_control_points
from facemime.core.control_points.selection import from_json
from facemime.core.errors import OutputError
from facemime.core.heads.rig import built_in_head
from facemime.core.takes.file import load_take, save_take
from tests.helpers.commands import COMMAND, needs_posix
from tests.helpers.takes import performance

SAMPLE = Path(facemime.__file__).parent / "assets" / "sample"


def run(*arguments: object, **options: object) -> subprocess.CompletedProcess:
    """Run `facemime`; options as for `subprocess.run`."""
    line = [*COMMAND, *map(str, arguments)]
    return subprocess.run(line, capture_output=True, text=True, timeout=500, check=False, **options)


def with_little_space() -> None:
    """Limit the size of files to that of a take, which has the effect of a full disk."""
    import resource

    resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))


@pytest.fixture(scope="module")
def clip(tmp_path_factory) -> Path:
    """The first two seconds of the sample clip."""
    path = tmp_path_factory.mktemp("clip") / "clip.mp4"
    source = cv2.VideoCapture(str(SAMPLE / "sample.mp4"))
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), 25.0, (640, 480))
    for _ in range(50):
        writer.write(source.read()[1])
    writer.release()
    return path


@pytest.fixture(scope="module")
def faceless(tmp_path_factory) -> Path:
    """A clip of noise."""
    path = tmp_path_factory.mktemp("clip") / "noise.mp4"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), 25.0, (320, 240))
    rng = np.random.default_rng(0)
    for _ in range(10):
        writer.write(rng.integers(0, 255, (240, 320, 3)).astype(np.uint8))
    writer.release()
    return path


@pytest.mark.thorough
def test_puppet_writes_a_blend_a_video_a_contact_sheet_and_a_take(clip, tmp_path):
    out = {name: tmp_path / name for name in ("out.blend", "out.mp4", "out.png", "take.facetake")}
    done = run(
        "puppet", clip, "-o", out["out.blend"], "--preview", out["out.mp4"], "--sheet", out["out.png"],
        "--take", out["take.facetake"],
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "largest error" in done.stderr and "Traceback" not in done.stderr and done.stdout == ""
    take = load_take(out["take.facetake"])
    assert len(take) == 50 and take.found.all()
    video = cv2.VideoCapture(str(out["out.mp4"]))
    fourcc = int(video.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little")
    assert fourcc in (b"h264", b"avc1") and video.get(cv2.CAP_PROP_FRAME_COUNT) == 50
    sheet = cv2.imread(str(out["out.png"]))
    assert sheet.shape[0] > 300 and sheet.std() > 10
    assert out["out.blend"].read_bytes()[:4] in (b"\x28\xb5\x2f\xfd", b"BLEN")


@pytest.mark.parametrize(
    ("options", "written", "message"),
    [
        pytest.param(
            ("--keys", "named", "--no-residual", "--clean", "0.1"), (), "52 shape keys", marks=pytest.mark.thorough
        ),
        pytest.param(("--keys", "mapped", "--nla"), (), "52 shape keys", marks=pytest.mark.thorough),
        pytest.param(("--keys", "new", "--max-keys", "1"), (), "1 shape keys", marks=pytest.mark.thorough),
        (("--keys", "cache"), ("out.pc2", "out Lashes.pc2"), "exact for every vertex"),
        pytest.param(
            ("--keys", "alembic"),
            ("out.pc2", "out Lashes.pc2", "out.abc"),
            "exact for every vertex",
            marks=pytest.mark.thorough,
        ),
    ],
    ids=str,
)
def test_puppet_bakes_to_the_requested_format(options, written, message, tmp_path):
    save_take(performance(), tmp_path / "take.facetake")
    done = run("puppet", tmp_path / "take.facetake", "-o", tmp_path / "out.blend", *options)
    assert done.returncode == 0 and message in done.stderr and done.stdout == ""
    assert {path.name for path in tmp_path.iterdir()} == {"take.facetake", "out.blend", *written}
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "out.blend"))
    head = bpy.data.objects["Facemime Head"]
    if written:
        assert head.modifiers[0].filepath == "//out.pc2"
    assert bool(head.animation_data.nla_tracks) == ("--nla" in options)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("options", "status", "message"),
    [
        (("--max-keys", "0"), 2, "is not between 1 and 512"),
        (("--clean", "-1"), 2, "is not between 0 and 10"),
        (("--keys", "new", "--map", "table.json"), 1, "with --keys mapped only"),
        (("--keys", "mapped", "--map", "table.json"), 1, "table.json cannot be read"),
    ],
    ids=str,
)
def test_an_impossible_bake_is_reported_at_once(options, status, message, tmp_path):
    save_take(performance(), tmp_path / "take.facetake")
    refused = run("puppet", tmp_path / "take.facetake", "-o", tmp_path / "out.blend", *options)
    assert refused.returncode == status and message in refused.stderr and not (tmp_path / "out.blend").exists()


@pytest.mark.thorough
def test_a_take_drives_a_custom_head(tmp_path):
    save_take(performance(), tmp_path / "take.facetake")
    assert run("puppet", tmp_path / "take.facetake", "-o", tmp_path / "own.blend").returncode == 0
    again = run("puppet", tmp_path / "take.facetake", "-o", tmp_path / "b.blend", "--head", tmp_path / "own.blend")
    assert again.returncode == 0, again.stderr
    named = f"{tmp_path / 'own.blend'}:Eye.L"
    part = run("puppet", tmp_path / "take.facetake", "-o", tmp_path / "c.blend", "--head", named)
    assert part.returncode == 0 and "Bound" not in part.stderr
    missing = run(
        "puppet", tmp_path / "take.facetake", "-o", tmp_path / "c.blend", "--head", f"{tmp_path}/own.blend:Nobody"
    )
    assert missing.returncode == 1 and "has no object Nobody" in missing.stderr


@pytest.mark.thorough
def test_landmarks_of_a_folder_are_nan_where_there_is_no_face(clip, tmp_path):
    (tmp_path / "in").mkdir()
    cv2.imwrite(str(tmp_path / "in" / "a.png"), cv2.VideoCapture(str(clip)).read()[1])
    cv2.imwrite(str(tmp_path / "in" / "b.jpg"), np.full((100, 100, 3), 90, np.uint8))
    done = run("landmarks", tmp_path / "in", "-o", tmp_path / "out.npz", "--overlay", tmp_path / "drawn")
    assert done.returncode == 0, done.stderr
    with np.load(tmp_path / "out.npz") as data:
        assert data["names"].tolist() == ["a.png", "b.jpg"] and data["landmarks"].shape == (2, 66, 2)
        assert np.isfinite(data["landmarks"][0]).all() and np.isnan(data["landmarks"][1]).all()
        assert data["confidence"].shape == (2,)
        truth = np.load(SAMPLE / "sample_landmarks.npz")["landmarks"][0]
        error = np.linalg.norm(data["landmarks"][0] - truth, axis=1)[17:].mean() / np.linalg.norm(truth[36] - truth[45])
        assert error < 0.08
    assert sorted(p.name for p in (tmp_path / "drawn").iterdir()) == ["a.png", "b.png"]
    (tmp_path / "in" / "c.png").write_bytes(b"broken")
    again = run("landmarks", tmp_path / "in", "-o", tmp_path / "out.npz")
    assert again.returncode == 1 and "c.png" in again.stderr and len(np.load(tmp_path / "out.npz")["names"]) == 3


@pytest.mark.thorough
def test_landmark_images_never_overwrite_each_other(clip, tmp_path):
    image = cv2.VideoCapture(str(clip)).read()[1]
    for name in ("a.png", "a.jpg", "b.png", "more/a.png"):
        (tmp_path / "in" / name).parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(tmp_path / "in" / name), image)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*.*g")}
    arguments = ("landmarks", tmp_path / "in", tmp_path / "in" / "more", "-o", tmp_path / "out.npz", "--overlay")
    refused = run(*arguments, tmp_path / "in")
    assert refused.returncode == 1 and "Choose another folder for --overlay" in refused.stderr
    assert {path: path.read_bytes() for path in tmp_path.rglob("*.*g")} == before
    done = run(*arguments, tmp_path / "drawn")
    assert done.returncode == 0, done.stderr
    assert sorted(path.name for path in (tmp_path / "drawn").iterdir()) == ["a-2.png", "a-3.png", "a.png", "b.png"]


def test_a_missing_display_library_is_reported_before_tracking(clip, tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), cv2.VideoCapture(str(clip)).read()[1])
    done = run("landmarks", tmp_path / "a.png", "-o", tmp_path / "out.npz", "--overlay", tmp_path / "a.png")
    assert done.returncode == 1 and "is not a folder" in done.stderr and "Finding" not in done.stderr


@pytest.mark.thorough
def test_the_source_video_is_never_overwritten(clip, tmp_path):
    copy = tmp_path / "clip.mp4"
    copy.write_bytes(clip.read_bytes())
    done = run("puppet", copy, "-o", tmp_path / "out.blend", "--preview", tmp_path / "in" / ".." / "clip.mp4")
    assert done.returncode == 1 and "it is the video that is tracked" in done.stderr
    assert copy.read_bytes() == clip.read_bytes()


@needs_posix
@pytest.mark.thorough
def test_a_full_disk_does_not_lose_the_tracking(clip, tmp_path):
    done = run("puppet", clip, "-o", tmp_path / "out.blend", preexec_fn=with_little_space)
    errors = [line for line in done.stderr.splitlines() if line.startswith("facemime:")]
    assert done.returncode == 1 and len(errors) == 1 and "Traceback" not in done.stderr, done.stderr
    assert "out.blend" in errors[0] and f"What was tracked is in {tmp_path / 'out.unfinished.facetake'}" in errors[0]
    assert len(load_take(tmp_path / "out.unfinished.facetake")) == 50
    assert [path.name for path in tmp_path.iterdir()] == ["out.unfinished.facetake"]
    done = run("puppet", tmp_path / "none.mp4", "-o", tmp_path / "out.blend")
    assert done.returncode == 1 and (tmp_path / "out.unfinished.facetake").exists()


@pytest.mark.thorough
def test_a_head_that_cannot_be_baked_to_is_reported_before_tracking(clip, tmp_path):
    add_head(bpy.context, units=True).data.shape_keys.use_relative = False
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "own.blend"))
    done = run("puppet", clip, "-o", tmp_path / "out.blend", "--head", tmp_path / "own.blend")
    assert done.returncode == 1 and "are absolute" in done.stderr and "Tracking" not in done.stderr


@needs_posix
@pytest.mark.thorough
def test_closed_output_streams_are_not_errors(tmp_path):
    save_take(performance(), tmp_path / "take.facetake")
    select = f"{COMMAND[0]} select {tmp_path / 'take.facetake'} -o {tmp_path / 'points.json'}"
    for line in (f"{select} | true; exit ${{PIPESTATUS[0]}}", f"{select} >&-", f"{select} 2>&- >&- <&-"):
        done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=False)
        assert done.returncode == 0 and done.stderr == "", line
        (tmp_path / "points.json").unlink()
    done = subprocess.run(["bash", "-c", f"{select} > /dev/full"], capture_output=True, text=True, check=False)
    assert done.returncode == 1 and "Traceback" not in done.stderr and "standard output" in done.stderr


def test_an_incomplete_video_is_reported(tmp_path, monkeypatch):
    encode = rendering._encode

    def cut(folder: Path, names: list[str], size: tuple[int, int], fps: float, output: Path) -> None:
        encode(folder, names, size, fps, output)
        output.write_bytes(output.read_bytes()[:1000])

    images = [np.full((64, 64, 3), 20 * i, np.uint8) for i in range(10)]
    rendering.write_video(images, 25.0, tmp_path / "out.mp4")
    assert rendering._frames_in(tmp_path / "out.mp4") == 10
    monkeypatch.setattr(rendering, "_encode", cut)
    with pytest.raises(OutputError, match="Free some disk space"):
        rendering.write_video(images, 25.0, tmp_path / "out.mp4")
    assert rendering._frames_in(tmp_path / "out.mp4") == 10


@pytest.mark.parametrize("name", ["{x} #1", "{blend_name}", "a{{b"])
def test_folders_whose_names_mean_something_in_blenders_paths_are_written_to(tmp_path, monkeypatch, name):
    folder = tmp_path / name
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    rendering.write_video([np.full((64, 64, 3), 100, np.uint8)] * 3, 25.0, folder / "out.mp4")
    assert rendering._frames_in(folder / "out.mp4") == 3
    scene = bpy.context.scene
    scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(scene.camera)
    (image,) = rendering.render_frames(scene, [1.0], (64, 48))
    assert image.shape == (48, 64, 3) and os.listdir(folder) == ["out.mp4"]


@pytest.mark.thorough
def test_errors_are_one_line_and_keep_the_earlier_output(clip, faceless, tmp_path):
    (tmp_path / "text.mp4").write_text("no video")
    (tmp_path / "empty.mp4").write_bytes(b"")
    (tmp_path / "broken.facetake").write_bytes(b"PK broken")
    good = tmp_path / "good.facetake"
    good.write_text("good")
    for arguments, words in (
        (("track", tmp_path / "none.mp4", "-o", good), "There is no file"),
        (("track", tmp_path / "text.mp4", "-o", good), "cannot be read as a video"),
        (("track", tmp_path / "empty.mp4", "-o", good), "cannot be read as a video"),
        (("track", tmp_path, "-o", good), "no images"),
        (("track", faceless, "-o", good), "No face was found"),
        (("track", clip, "-o", "/proc/take.facetake"), "Cannot write"),
        (("landmarks", tmp_path / "none", "-o", tmp_path / "o.npz"), "There is no file"),
        (("landmarks", tmp_path, "-o", tmp_path / "o.npz"), "no image"),
        (("puppet", clip, "-o", good), "suffix .blend"),
        (("puppet", tmp_path / "broken.facetake", "-o", tmp_path / "o.blend"), "not a Facemime take"),
        (("puppet", faceless, "-o", tmp_path / "o.blend"), "No face was found"),
        (("puppet", clip, "-o", tmp_path / "o.blend", "--head", tmp_path / "no.blend"), "There is no file"),
    ):
        done = run(*arguments)
        errors = [line for line in done.stderr.splitlines() if line.startswith("facemime:")]
        assert done.returncode == 1 and len(errors) == 1 and words in errors[0], done.stderr
        assert "Traceback" not in done.stderr
    assert good.read_text() == "good"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["broken.facetake", "empty.mp4", "good.facetake", "text.mp4"]


@needs_posix
def test_ctrl_c_keeps_the_tracked_frames(tmp_path):
    import pty

    output = tmp_path / "take.facetake"
    try:
        terminal, side = pty.openpty()
    except OSError as error:
        pytest.skip(f"this system gives no terminal: {error}")
    with subprocess.Popen([*COMMAND, "track", SAMPLE / "sample.mp4", "-o", output], stderr=side) as process:
        os.close(side)
        heard = b""
        while not re.search(rb"\] [1-9]\d*/", heard):
            heard += os.read(terminal, 1024)
        process.send_signal(signal.SIGINT)
        with contextlib.suppress(OSError):  # Linux reports the end of a terminal as an error
            while piece := os.read(terminal, 1024):
                heard += piece
    assert process.returncode == 130 and b"Traceback" not in heard
    take = load_take(output)
    assert 1 <= len(take) < 240 and take.info["interrupted"] and str(len(take)).encode() in heard


@pytest.mark.thorough
def test_select_prints_the_curve_and_puppet_uses_the_points(tmp_path):
    save_take(performance(), tmp_path / "take.facetake")
    points = tmp_path / "points.json"
    done = run("select", tmp_path / "take.facetake", "-o", points, "--max-points", 12, "--add", "33", "--remove", "0-1")
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    count, words = lines[-1].split(" ", 1)
    assert lines[0].startswith("action") and words.startswith("control points:") and " 33" in words
    assert 3 <= int(count) <= 12 and len(words.split(",")) == int(count)
    assert all(re.match(r"(start|add|drop) +\d+ +(upper|middle|lower) +\d+ +\d+\.\d\d ", line) for line in lines[1:-1])
    done = run(
        "puppet", tmp_path / "take.facetake", "-o", tmp_path / "out.blend", "--points", points, "--kernel", "gaussian"
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        (["--max-points", "2"], 2, "'2' is not between 3 and 66"),
        (["--tolerance", "0"], 2, "'0' is not between 0.01 and 100"),
        (["--add", "nose"], 1, "not a list of landmarks"),
        (["-o", "points.txt"], 1, "json"),
    ],
)
def test_select_reports_invalid_arguments(tmp_path, arguments, status, message):
    save_take(performance(), tmp_path / "take.facetake")
    done = run("select", tmp_path / "take.facetake", *arguments)
    assert done.returncode == status and message in done.stderr and "Traceback" not in done.stderr


@pytest.mark.thorough
def test_select_uses_the_head_in_a_file(tmp_path):
    save_take(performance(), tmp_path / "take.facetake")
    obj = add_head(bpy.context)
    for vertex in obj.data.vertices:
        vertex.co.x *= 1.6
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "head.blend"))
    points = tmp_path / "points.json"
    done = run("select", tmp_path / "take.facetake", "--head", tmp_path / "head.blend", "-o", points)
    assert done.returncode == 0, done.stderr
    found, take = from_json(points.read_text()), load_take(tmp_path / "take.facetake")
    expected, usual = (select_control_points(rig, take) for rig in (read_rig(obj), built_in_head()))
    # Two candidates of nearly the same error may change places from one process to another.
    assert (found.membership == expected.membership).mean() > 0.95
    np.testing.assert_allclose(found.covariance, expected.covariance, rtol=1e-3, atol=1e-9)
    assert not np.allclose(found.covariance, usual.covariance, rtol=1e-2, atol=1e-10)


@pytest.mark.thorough
def test_invalid_points_are_rejected_before_anything_is_written(tmp_path):
    save_take(performance(), tmp_path / "take.facetake")
    (tmp_path / "points.json").write_text("{}")
    done = run("puppet", tmp_path / "take.facetake", "-o", tmp_path / "out.blend", "--points", tmp_path / "points.json")
    assert done.returncode == 1 and "not a control point file" in done.stderr
    assert not (tmp_path / "out.blend").exists()
