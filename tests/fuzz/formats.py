"""Formats to fuzz: for each an intact file, mutators, and code that reads the file and uses its content."""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

from facemime.cli.clips import checked_record
from facemime.core.control_points import selection as control_points
from facemime.core.control_points.selection import GreedySelection, GreedyStep
from facemime.core.control_points.table import draw_curve, drop_by_hand, point_rows
from facemime.core.deform.covariance import follow_matrix
from facemime.core.drive.driver import HeadDriver
from facemime.core.drive.retarget import retargeter_for
from facemime.core.drive.teaching import TaughtKeys
from facemime.core.errors import HeadError, SourceError
from facemime.core.files.reading import parse_json
from facemime.core.files.setting import Choice, Setting
from facemime.core.heads import key_map, key_presets
from facemime.core.heads.built_in import HEAD_FILE, PART_NAMES, load_head
from facemime.core.heads.facegen import FaceGenMesh, read_egm, read_obj, read_tri
from facemime.core.heads.regions import membership, region_sigmas
from facemime.core.heads.rig import built_in_head
from facemime.core.heads.style import Example, Style, load_style, style_bytes
from facemime.core.heads.thumbnail import pixels_of, thumbnail
from facemime.core.mesh.kernels import get_kernel
from facemime.core.puppet import presets
from facemime.core.takes.neutral import Neutral, calibrate
from facemime.core.tracking.cascade_detector import CascadeDetector
from facemime.core.tracking.linear_fitter import RADII, LinearFitter
from facemime.core.tracking.model_file import _HEADER, FORMAT_VERSION, MAGIC
from facemime.core.tracking.pdm import FittedShape
from facemime.core.tracking.tracker import DEFAULT_MODEL, FaceTracker
from tests.fuzz.media import filmed_face, mutated_picture, picture, read_picture, read_video, video
from tests.helpers.facegen_files import OBJ, egm, tri
from tests.helpers.facetracker_files import facetracker_file, sample_experts, small_pdm
from tests.helpers.takes import performance

from .mutators import Arrays, archive_bytes, mutated_archive, mutated_bytes, mutated_json, npy_bytes
from .recordings import TAKES
from .streams import INTACT, mutated_packet, packets, reader


@dataclass(frozen=True)
class Format:
    """A format.

    Attributes
    ----------
    suffix : str
    intact : callable
        Returns the bytes of an intact file.
    mutated : callable
        Returns the bytes of a damaged one.
    read : callable
        Reads a file, and uses it as the program does.
    megabytes : int
        Memory that reading may take, in addition to that of the process.
    """

    suffix: str
    intact: Callable[[], bytes]
    mutated: Callable[[Random], bytes]
    read: Callable[[Path], None]
    megabytes: int = 256


def _text(read: Callable[[str], None]) -> Callable[[Path], None]:
    """Decode text as the program does, which rejects invalid UTF-8 before parsing."""
    return lambda path: read(path.read_text(encoding="utf-8", errors="replace"))


def _json(data: Callable[[], Any], read: Callable[[str], None]) -> Format:
    return Format(
        ".json",
        lambda: json.dumps(data()).encode(),
        lambda rng: mutated_json(rng, data()),
        _text(read),
    )


@cache
def _head_arrays() -> Arrays:
    """A head with little more than its landmarks."""
    with np.load(HEAD_FILE) as file:
        arrays = {name: file[name] for name in file.files}
    chosen = arrays["landmarks"].astype(int)
    arrays |= {name: arrays[name][:, chosen] for name in ("units", "regions")}
    arrays["vertices"], arrays["landmarks"] = arrays["vertices"][chosen], np.arange(66, dtype=np.int16)
    faces = np.array([[0, 1, 2, -1], [3, 4, 5, 6]], np.int16)
    arrays |= {"faces": faces, "uv": arrays["uv"][:2]}
    for part in PART_NAMES:
        arrays |= {f"{part}.vertices": arrays[f"{part}.vertices"][:7]}
        if (units := f"{part}.units") in arrays:  # hair and other parts on the skull have none
            arrays[units] = arrays[units][:, :7]
        arrays |= {f"{part}.faces": faces, f"{part}.uv": arrays[f"{part}.uv"][:2]}
    return arrays


def _read_head(path: Path) -> None:
    head = load_head(path)
    for mesh in (head, *head.parts):
        assert np.isfinite(mesh.vertices).all() and np.isfinite(mesh.units).all() and np.isfinite(mesh.uv).all()
        assert (np.sort(mesh.faces, axis=1)[:, 1:] >= 0).all() and mesh.faces.max(initial=0) < len(mesh.vertices)
    assert len(set(head.landmarks.tolist())) == 66 and head.landmarks.min() >= 0
    retargeter_for(_neutral(), head.vertices[head.landmarks])


@cache
def _tracker_arrays() -> Arrays:
    """The shipped model with two units for each patch expert."""
    with np.load(io.BytesIO(DEFAULT_MODEL.read_bytes()[_HEADER.size :])) as file:
        arrays = {name: file[name] for name in file.files}
    for view in ("frontal", "side"):
        arrays[f"{view}_hidden"] = arrays[f"{view}_hidden"][:, :, :2]
        arrays |= {f"{view}_{part}": arrays[f"{view}_{part}"][:, :2] for part in ("step", "hidden_bias", "output")}
    return arrays


def _tracker_bytes(payload: bytes) -> bytes:
    digest = hashlib.sha256(payload).digest()
    return _HEADER.pack(MAGIC, FORMAT_VERSION, len(payload), digest) + payload


def _mutated_tracker(rng: Random) -> bytes:
    data = _tracker_bytes(mutated_archive(rng, _tracker_arrays()))
    return mutated_bytes(rng, data) if rng.random() < 0.1 else data


@cache
def _cascades() -> CascadeDetector:
    return CascadeDetector()


def _read_tracker(path: Path) -> None:
    tracker = FaceTracker.load(path)
    tracker.search._cascades = _cascades()  # which would read its own files, slowly
    for _ in range(2):
        tracker.track(filmed_face())


@cache
def _neutral() -> Neutral:
    return calibrate(performance())


def _read_neutral(text: str) -> None:
    neutral = Neutral.from_json(text)
    rig = built_in_head()
    for one in (neutral, neutral.mirrored()):
        moved = retargeter_for(one, rig.vertices[rig.landmarks]).displacements(_neutral().shape + 0.01)
        assert np.isfinite(moved).all()


def _points() -> Any:
    steps = [GreedyStep("start", i, 0, "frontalis", i + 1, 0.5 / (i + 1), i, 20) for i in range(3)]
    steps += [GreedyStep("add", 30, 1, "error", 4, 0.05, 9, 8), GreedyStep("drop", 2, 0, "", 3, float("nan"), 0, 0)]
    selection = GreedySelection(membership(), tuple(steps), 0.01, False, np.eye(66) * 1e-4)
    return json.loads(control_points.to_json(selection))


def _read_points(text: str) -> None:
    selection = control_points.from_json(text)
    assert all(isinstance(row.reason, str) and row.order >= 0 for row in point_rows(selection))
    assert np.isfinite(draw_curve(selection)).all()
    rig, kernel = built_in_head(), get_kernel("gaussian")
    points = np.asarray(rig.vertices, np.float64)[rig.landmarks]
    sigmas = region_sigmas(points, kernel)
    assert np.isfinite(follow_matrix(points, selection.membership, selection.covariance, kernel, sigmas)).all()
    assert len(control_points.from_json(control_points.to_json(selection)).steps) == len(selection.steps)
    with contextlib.suppress(HeadError):  # the last one of a region
        drop_by_hand(selection, int(selection.landmarks[0]))


def _key_map() -> Any:
    return json.loads(key_presets.presets()[0].to_json())


def _read_key_map(text: str) -> None:
    table = key_map.from_json(text)
    for values in table.apply(np.full((2, 52), 0.5), dict.fromkeys(table.keys, (0.0, 1.0))).values():
        assert np.isfinite(values).all()
    table.matched(["Jaw Open"])
    json.loads(table.to_json())


_PRESET = {
    "settings": {
        "mode": Setting("3d", "Depth", choices=(Choice("3d", "", ""), Choice("planar", "", ""))),
        "strength_upper": Setting(1.0, "Upper", low=0.0, high=5.0),
        "smoothing": Setting(1.0, "Smoothing", low=0.0, high=20.0),
        "mirror": Setting(False, "Mirror"),
    },
    "posing": {
        "rotation_limit": Setting(3.0, "Limit", low=0.0, high=3.14),
        "eyes_strength": Setting(1.0, "Eyes", low=0.0, high=10.0),
    },
}


def _record() -> Any:
    record = {"clip": "a.mp4", "outputs": ["a-1.blend"], "frames": 9, "found": 8, "length": 0.4, "seconds": 2.5}
    return record | {"confidence": [0.5, 1.0], "worst": [0.1], "pictures": ["a-1-1.jpg"]}


def _read_record(text: str) -> None:
    try:
        checked_record(parse_json(text))
    except ValueError as error:  # as `read_record` has it, to which it is a clip that is not done
        raise SourceError(str(error)) from error


def _preset() -> Any:
    values = {"mode": "3d", "strength_upper": 1.5, "smoothing": 1, "mirror": True}
    return json.loads(presets.to_json({"settings": values, "posing": {"rotation_limit": 0.5, "eyes_strength": 1.0}}))


def _read_preset(text: str) -> None:
    for group, values in presets.from_json(text, _PRESET).items():
        for name, value in values.items():
            assert _PRESET[group][name].checked(value, name) == value


def _read_facegen(mesh: FaceGenMesh, modes: tuple[Any, ...] = ()) -> None:
    assert np.isfinite(mesh.vertices).all() and len(mesh.faces)
    assert np.linalg.norm(np.ptp(mesh.vertices, axis=0)) > 0
    for face in mesh.faces.tolist():
        corners = [vertex for vertex in face if vertex >= 0]
        assert len(set(corners)) == len(corners) >= 3 and max(corners) < len(mesh.vertices)
    for name, offsets in (*mesh.morphs, *modes):
        assert isinstance(name, str) and np.isfinite(mesh.vertices + offsets).all()


def _mutated_obj(rng: Random) -> bytes:
    words = ("nan", "inf", "1e39", "0", "-1", "99", "1/1", "2//", "1/0/0", "9" * 500, "f 1 1 1", "v 0 0 0", "f 2 2 3")
    lines = OBJ.splitlines()
    for _ in range(rng.randint(1, 4)):
        at = rng.randrange(len(lines))
        parts = lines[at].split()
        if rng.random() < 0.2 or not parts:
            lines.insert(at, rng.choice((*words, lines[at], "f " + "1 2 3 " * 2000)))
        else:
            parts[rng.randrange(len(parts))] = rng.choice(words)
            lines[at] = " ".join(parts)
    data = "\n".join(lines).encode()
    return mutated_bytes(rng, data) if rng.random() < 0.3 else data


def _mutated_tri(rng: Random) -> bytes:
    return mutated_bytes(rng, tri(labels=rng.random() < 0.5, per_vertex_uv=rng.random() < 0.3))


@cache
def _mesh() -> FaceGenMesh:
    with tempfile.NamedTemporaryFile(suffix=".tri") as file:
        Path(file.name).write_bytes(tri())
        return read_tri(Path(file.name))


def _packet(name: str) -> bytes:
    return packets(name)[0]


@cache
def _style_arrays() -> Arrays:
    """Arrays of the file of a style, by name."""
    rig, result = built_in_head(), performance().result(45)
    driver = HeadDriver(rig, _neutral())
    shown = driver.frame(result)
    offsets = np.zeros_like(shown.vertices)
    offsets[:50] = 0.01
    example = Example(
        "Smile", "Anna", driver.expression(result), offsets, {"mouthSmileLeft": 0.4}, 0.5, controls={"jaw": 0.1}
    )
    pictured = replace(example, thumbnail=thumbnail(rig, shown.vertices))
    with np.load(io.BytesIO(style_bytes(Style((pictured, example))))) as archive:
        return {name: archive[name] for name in archive.files}


def _read_style(path: Path) -> None:
    style = load_style(path)
    result = performance().result(45)
    driver = HeadDriver(replace(built_in_head(), style=style), _neutral())
    assert np.isfinite(driver.frame(result).vertices).all()
    TaughtKeys(style).changes(driver.expression(result))
    for example in style.examples:
        pixels_of(example.thumbnail)


@cache
def _facetracker() -> bytes:
    """Two modes and the experts of one view, so that mutations reach every kind of record."""
    return facetracker_file(small_pdm(2), sample_experts()[:1], (0.0,))


def _read_facetracker(path: Path) -> None:
    fitter = FaceTracker.load(path).fitter
    assert isinstance(fitter, LinearFitter)
    start = FittedShape(np.array([60.0, 0.0, 0.0, 0.0, 80.0, 60.0]), np.zeros(fitter._linear.pdm.n_modes))
    fitted = fitter.fit_linear(np.arange(120 * 160, dtype=np.uint8).reshape(120, 160), start, RADII)
    assert np.isfinite(fitted.pose).all() and np.isfinite(fitted.shape_params).all()


FORMATS: dict[str, Format] = {
    "style": Format(
        ".facestyle",
        lambda: archive_bytes({f"{name}.npy": npy_bytes(array) for name, array in _style_arrays().items()}),
        lambda rng: mutated_archive(rng, _style_arrays()),
        _read_style,
    ),
    "head": Format(
        ".npz",
        lambda: archive_bytes({f"{name}.npy": npy_bytes(array) for name, array in _head_arrays().items()}),
        lambda rng: mutated_archive(rng, _head_arrays()),
        _read_head,
    ),
    "tracker": Format(
        ".tracker",
        lambda: _tracker_bytes(archive_bytes({f"{n}.npy": npy_bytes(a) for n, a in _tracker_arrays().items()})),
        _mutated_tracker,
        _read_tracker,
    ),
    "model of FaceTracker": Format(
        ".tracker", _facetracker, lambda rng: mutated_bytes(rng, _facetracker()), _read_facetracker
    ),
    "control points": _json(_points, _read_points),
    "key map": _json(_key_map, _read_key_map),
    "batch record": _json(_record, _read_record),
    "preset": _json(_preset, _read_preset),
    "calibration": _json(lambda: _neutral().to_dict(), _read_neutral),
    "facegen tri": Format(".tri", tri, _mutated_tri, lambda path: _read_facegen(read_tri(path))),
    "facegen egm": Format(
        ".egm", egm, lambda rng: mutated_bytes(rng, egm()), lambda path: _read_facegen(_mesh(), read_egm(path, _mesh()))
    ),
    "facegen obj": Format(".obj", OBJ.encode, _mutated_obj, lambda path: _read_facegen(read_obj(path))),
    **{name: Format(*of) for name, of in TAKES.items()},
    **{
        f"stream {name}": Format(".packet", partial(_packet, name), partial(mutated_packet, name), reader(name))
        for name in INTACT
    },
    "picture": Format(".png", lambda: picture(".png"), mutated_picture, read_picture, 512),
    "video": Format(".mp4", video, lambda rng: mutated_bytes(rng, video()), read_video, 512),
}
