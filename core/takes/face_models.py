"""Parameters of statistical face models over time, FLAME's and GNM's, beside the model's file (takes.md)."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..errors import DataError, Message, SourceError
from ..face.landmarks import IBUG68_INDICES, LOWER_LIPS, UPPER_LIPS, outer_eye_distance
from ..files.capture import check_readable
from ..files.pickles import arrays_of_pickle
from ..files.reading import read_bytes, shown
from ..heads.rig import neck_of
from ..numeric.arrays import FloatArray, IntArray
from .measured import FacePoints, PointTracker, describe_animation
from .moving_mesh import TO_HEAD, MovingMesh, take_of_mesh
from .numbered_meshes import numbered_files, read_numbered
from .take import Take, TakeRecorder

PARAMETERS = (".npz",)
FPS = 30.0
"""Rate of a sequence that states none."""
MIN_FPS, MAX_FPS = 1.0, 1000.0
Arrays = Mapping[str, NDArray[Any]]
_MAX_FILE = 1 << 30
_MAX_FRAMES = 1_000_000
_IDENTITY = 300
"""Number of FLAME's modes of identity, which precede those of expression."""
_EXPRESSION = ("expr", "expression", "exp", "expression_params", "expression_coefficients", "coefficients")
_SHAPE = ("shape", "betas", "shape_params", "identity")
_TRANSLATION = ("translation", "transl")
_POSES = (
    *((("rotation",), (0,)), (("global_orient",), (0,)), (("neck_pose",), (1,)), (("jaw_pose",), (2,))),
    *((("eyes_pose", "eye_pose"), (3, 4)), (("leye_pose",), (3,)), (("reye_pose",), (4,))),
)
"""Names of the rotations in FLAME's parameters, as its trackers VHAP, GaussianAvatars, DECA and SMPL-X write them, and
the joints: neck's root, neck, jaw, left and right eye. `pose` has those of root and jaw, or all."""
_POSE_JOINTS = {6: (0, 2), 15: (0, 1, 2, 3, 4)}
_EYES_APART = 0.09
"""Distance between the outer corners of a face's eyes in metres, the unit of the modes of GNM's landmarks."""
_MEDIAPIPE = (
    *(127, 234, 93, 58, 172, 136, 150, 149, 152, 378, 379, 365, 397, 288, 323, 454, 356),
    *(70, 63, 105, 66, 107, 336, 296, 334, 293, 300),
    *(168, 197, 5, 4, 98, 97, 2, 326, 327),
    *(33, 160, 158, 133, 153, 144, 362, 385, 387, 263, 373, 380),
    *(61, 39, 37, 0, 267, 269, 291, 321, 314, 17, 84, 91),
    *(61, 37, 0, 267, 291, 314, 17, 84),
)
"""Point of MediaPipe's face mesh for each iBUG-68 landmark, among those that GNM's landmarks have: the inner rims of
the lips are those of the outer ones."""


def is_moving_face(path: Path) -> bool:
    """Return whether `read_moving_face` reads a file or folder: parameters, or several numbered meshes."""
    if os.path.isdir(path) or path.suffix.lower() in PARAMETERS:  # unlike those of Path, these never raise
        return True
    return os.path.isfile(path) and len(numbered_files(path)) > 1


def read_moving_face(path: Path, fps: float, model: Path | None = None, marks: Mapping[int, int] | None = None) -> Take:
    """Return the take of numbered meshes, or of parameters, as `read_parameters` and `read_numbered` read them."""
    if not MIN_FPS <= fps <= MAX_FPS:
        raise SourceError(
            "The rate cannot be {fps:g}. Use one between {low:g} and {high:g}.", fps=fps, low=MIN_FPS, high=MAX_FPS
        )
    if path.is_dir() or path.suffix.lower() not in PARAMETERS:
        return take_of_mesh(read_numbered(path), fps, marks)
    if not check_readable(path):
        raise SourceError("There is no file {path}. Check its name.", path=path)
    if model is None:
        raise SourceError(
            "{path} contains parameters of a face model. Choose the model's file, too: FLAME's .pkl, or GNM's .npz.",
            path=path,
        )
    return read_parameters(path, model, fps, marks)


def read_parameters(path: Path, model: Path, fps: float, marks: Mapping[int, int] | None = None) -> Take:
    """Return the take of a face model's parameters.

    `path` is an `.npz` file with an array for each kind of parameter, one row per frame, or the first of numbered ones
    with a frame each; `model` is FLAME's model (`.pkl` or `.npz`), GNM's (`.npz`), or the file of GNM's landmarks.
    The face without expression is neutral. Raises SourceError if a file cannot be read or they do not fit together, and
    HeadError if no face is found on the model.
    """
    known = _read(model, Message("a face model"))
    given = _sequence(path)
    try:
        if "expression_modes" in known:
            return _take_of_landmarks(path.name, given, known, fps)
        rig = _flame(given, known) if "v_template" in known else _gnm(given, known)
        faces = np.asarray(known["f" if "f" in known else "triangles"], dtype=np.intp)
        if faces.ndim != 2 or faces.min() < 0 or faces.max() >= len(rig.rest):
            raise DataError("a face has a vertex that does not exist")
    except KeyError as error:
        raise SourceError("{path} is not a face model: it has no {name}.", path=model, name=error.args[0]) from error
    except (ValueError, IndexError) as error:
        raise SourceError(
            "{path} does not fit the model {model}: {error}.", path=path, model=model.name, error=error
        ) from error
    return take_of_mesh(MovingMesh(path.name, rig.rest * TO_HEAD, faces, rig, is_neutral=True), fps, marks)


def _read(path: Path, what: str) -> dict[str, NDArray[Any]]:
    """Return the arrays of numbers in a file; a SourceError says that it cannot be read as `what`."""
    try:
        if path.suffix.lower() == ".pkl":
            return arrays_of_pickle(read_bytes(path, _MAX_FILE))
        with np.load(path, allow_pickle=False) as archive:
            if sum(member.file_size for member in archive.zip.infolist()) > _MAX_FILE:
                raise DataError("it is larger than {limit} MB", limit=_MAX_FILE >> 20)
            arrays = {}
            for name in archive.files:
                with suppress(ValueError):  # an array of objects, which is not read
                    arrays[name] = archive[name]
        return {name: array for name, array in arrays.items() if array.dtype.kind in "biuf"}
    except (OSError, ValueError, EOFError, TypeError, AttributeError, zipfile.BadZipFile) as error:
        raise SourceError("{path} cannot be read as {what}: {error}.", path=path, what=what, error=error) from error


def _sequence(path: Path) -> dict[str, NDArray[Any]]:
    """Return the parameters in a file, or in numbered files with a frame each; missing ones are rows of NaN."""
    what = Message("parameters of a face")
    first = _read(path, what)
    files = numbered_files(path, PARAMETERS)
    row = _found(first, _EXPRESSION)
    if row is None:
        raise SourceError(
            "{path} contains no expression, such as expr, expression or exp. Choose another file.", path=path
        )
    if len(files) < 2 or len(np.atleast_2d(row)) != 1:
        return first
    frames = {number: _read(file, what) for number, file in files.items()}
    numbers = range(min(frames), max(frames) + 1)
    if len(numbers) > _MAX_FRAMES:
        raise SourceError("{path} has more than {frames:,} frames.", path=path, frames=_MAX_FRAMES)
    joined = dict(first)
    for name, value in first.items():
        if name in _SHAPE or name == "static_offset":
            continue
        lost = np.full((1, *np.atleast_2d(value).shape[1:]), np.nan)
        rows = [np.atleast_2d(frames[n][name]) if name in frames.get(n, {}) else lost for n in numbers]
        if any(row.shape != lost.shape for row in rows):
            raise SourceError("{path} and the numbered files after it differ in {name}.", path=path, name=shown(name))
        joined[name] = np.concatenate(rows)
    return joined


def _found(given: Arrays, names: tuple[str, ...]) -> NDArray[Any] | None:
    return next((given[name] for name in names if name in given), None)


def _rows(given: Arrays, names: tuple[str, ...], count: int, width: int) -> FloatArray:
    """Return an array (N, width) with a row per frame from the first that is given, or of zeros; a single row is
    repeated, and columns that lack are 0.
    """
    value = _found(given, names)
    if value is None:
        return np.zeros((count, width))
    rows = np.asarray(value, dtype=np.float64).reshape(len(value) if value.ndim > 1 else 1, -1)
    if len(rows) not in (1, count) or rows.shape[1] > width:
        raise DataError(
            "{name} has the shape {shape}, for {count} frames of at most {width} values",
            name=next(name for name in names if name in given),
            shape=value.shape,
            count=count,
            width=width,
        )
    return np.broadcast_to(np.pad(rows, ((0, 0), (0, width - rows.shape[1]))), (count, width))


def _expressions(given: Arrays, width: int) -> FloatArray:
    """Return the expression of each frame, (N, width)."""
    value = _found(given, _EXPRESSION)
    assert value is not None
    return _rows(given, _EXPRESSION, len(value) if value.ndim > 1 else 1, width)


@dataclass(frozen=True)
class _Rig:
    """The frames of a face model that modes bend and joints turn (linear blend skinning), in the axes of the model.

    Attributes
    ----------
    rest, joints : (V, 3), (J, 3) float64
        Vertices, and joints, of the person without expression.
    modes, joint_modes : (E, V, 3), (E, J, 3) float
        What a unit of each expression adds.
    correctives : (9 (J - 1), V, 3) float
        What the elements of the rotation of each joint but the first add.
    weights : (V, J) float64
        Share of each joint.
    parents : (J,) int
        Parent of each joint; that of the first is ignored.
    expressions, turns, moved : (N, E), (N, J, 3), (N, 3) float64
        In each frame: expression, rotation vectors of the joints, and translation. Rows of NaN are missing frames.
    offsets : (N or 1, V, 3) float64 or None
        Offsets in each frame.
    """

    rest: FloatArray
    joints: FloatArray
    modes: FloatArray
    joint_modes: FloatArray
    correctives: FloatArray
    weights: FloatArray
    parents: IntArray
    expressions: FloatArray
    turns: FloatArray
    moved: FloatArray
    offsets: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.expressions)

    def __iter__(self) -> Iterator[FloatArray | None]:
        for frame, (values, turns, moved) in enumerate(zip(self.expressions, self.turns, self.moved, strict=True)):
            known = np.isfinite(values).all() and np.isfinite(turns).all() and np.isfinite(moved).all()
            yield self._posed(frame, values, turns, moved) * TO_HEAD if known else None

    def _posed(self, frame: int, values: FloatArray, turns: FloatArray, moved: FloatArray) -> FloatArray:
        places = self.rest + np.tensordot(values, self.modes, 1)
        if self.offsets is not None:
            places = places + self.offsets[frame % len(self.offsets)]
        joints = self.joints + np.tensordot(values, self.joint_modes, 1)
        rotations = np.array([cv2.Rodrigues(turn)[0] for turn in turns])
        if len(self.correctives):
            places = places + np.tensordot((rotations[1:] - np.eye(3)).ravel(), self.correctives, 1)
        world, origin = [rotations[0]], [joints[0]]
        for joint, parent in enumerate(self.parents[1:].tolist(), 1):
            world.append(world[parent] @ rotations[joint])
            origin.append(origin[parent] + world[parent] @ (joints[joint] - joints[parent]))
        shifts = np.array(origin) - np.einsum("jab,jb->ja", np.array(world), joints)
        turned = np.einsum("vj,jab,vb->va", self.weights, np.array(world), places, optimize=True)
        return np.asarray(turned + self.weights @ shifts + moved)


def _flame(given: Arrays, model: Arrays) -> _Rig:
    """Return the frames of FLAME (Li et al. 2017)."""
    template = np.asarray(model["v_template"], dtype=np.float64)
    directions = np.asarray(model["shapedirs"], dtype=np.float64)
    regressor, weights = (np.asarray(model[name], dtype=np.float64) for name in ("J_regressor", "weights"))
    parents = np.array([0, *model["kintree_table"][0][1:].astype(np.intp)])
    count, joints = len(template), len(parents)
    correctives = np.asarray(model["posedirs"], dtype=np.float64).reshape(count, 3, -1)
    _check(
        template=(template, (count, 3)), J_regressor=(regressor, (joints, count)), weights=(weights, (count, joints))
    )
    _check(posedirs=(correctives, (count, 3, 9 * (joints - 1))), shapedirs=(directions[..., 0], (count, 3)))
    _check_tree(parents)
    if joints != 5:
        raise DataError("the model has {joints} joints, and FLAME has 5", joints=joints)
    identity = min(_IDENTITY, directions.shape[2])
    modes = np.moveaxis(directions[:, :, identity:], 2, 0)
    expressions = _expressions(given, len(modes))
    frames = len(expressions)
    shape = _rows(given, _SHAPE, frames, identity)[0]
    rest = template + directions[:, :, :identity] @ shape
    if "static_offset" in given:
        rest = rest + _offsets(given["static_offset"], count)[0]
    turns = np.zeros((frames, joints, 3))
    if "pose" in given:
        width = np.atleast_2d(given["pose"])[0].size
        if width not in _POSE_JOINTS:
            raise DataError("pose has the shape {shape}, which is unknown", shape=given["pose"].shape)
        turns[:, _POSE_JOINTS[width]] = _rows(given, ("pose",), frames, width).reshape(frames, -1, 3)
    for names, of in _POSES:
        if _found(given, names) is not None:
            turns[:, of] = _rows(given, names, frames, 3 * len(of)).reshape(frames, -1, 3)
    moved = _rows(given, _TRANSLATION, frames, 3)
    offsets = _offsets(given["dynamic_offset"], count) if "dynamic_offset" in given else None
    return _Rig(
        rest=rest,
        joints=regressor @ rest,
        modes=modes,
        joint_modes=regressor @ modes,
        correctives=np.moveaxis(correctives, 2, 0),
        weights=weights,
        parents=parents,
        expressions=expressions,
        turns=turns,
        moved=moved,
        offsets=offsets,
    )


def _gnm(given: Arrays, model: Arrays) -> _Rig:
    """Return the frames of GNM Head (Google, 2026), whose correctives are 0."""
    template, joints = (np.asarray(model[f"template_{of}_positions"], dtype=np.float64) for of in ("vertex", "joint"))
    modes: FloatArray = model["expression_basis"]
    identities, joint_identities = model["vertex_identity_basis"], model["joint_identity_basis"]
    weights = np.asarray(model["skinning_weights"], dtype=np.float64).T
    parents = np.array([0, *model["joint_parent_indices"][1:].astype(np.intp)])
    _check(expression_basis=(modes[0], template.shape), skinning_weights=(weights, (len(template), len(joints))))
    _check_tree(parents)
    expressions = _expressions(given, len(modes))
    frames = len(expressions)
    shape = _rows(given, _SHAPE, frames, len(identities))[0]
    turns = _rows(given, ("rotations",), frames, 3 * len(joints)).reshape(frames, len(joints), 3)
    return _Rig(
        rest=template + np.tensordot(shape, identities, 1),
        joints=joints + np.tensordot(shape, joint_identities, 1),
        modes=modes,
        joint_modes=np.zeros((len(modes), len(joints), 3)),
        correctives=np.empty((0, len(template), 3)),
        weights=weights,
        parents=parents,
        expressions=expressions,
        turns=turns,
        moved=_rows(given, _TRANSLATION, frames, 3),
    )


def _check(**arrays: tuple[FloatArray, tuple[int, ...]]) -> None:
    """Raise ValueError if an array of the model has another shape than expected, or contains NaN."""
    for name, (array, shape) in arrays.items():
        if array.shape != shape or not np.isfinite(array).all():
            raise DataError(
                "{name} has the shape {shape}, not {expected}", name=name, shape=array.shape, expected=shape
            )


def _check_tree(parents: IntArray) -> None:
    """Raise ValueError unless every joint but the first comes after its parent."""
    if not ((parents[1:] >= 0) & (parents[1:] < np.arange(1, len(parents)))).all():
        raise DataError("its joints do not form a tree")


def _offsets(value: NDArray[Any], count: int) -> FloatArray:
    """Return offsets (N, V, 3) of the first vertices, as trackers add teeth to FLAME."""
    rows = np.asarray(value, dtype=np.float64)
    rows = rows.reshape(-1, *rows.shape[-2:])[:, :count]
    if rows.shape[1:] != (count, 3):
        raise DataError("an offset has the shape {shape}, for {count} vertices", shape=value.shape, count=count)
    return rows


def _take_of_landmarks(source: str, given: Arrays, model: Arrays, fps: float) -> Take:
    """Return the take of GNM's expressions, by its landmarks alone; the head does not turn."""
    places, modes = np.asarray(model["rest"], dtype=np.float64), np.asarray(model["expression_modes"], np.float64)
    anchors = {int(point): place for place, point in enumerate(model["mediapipe_index"].tolist())}
    if lacking := sorted(set(_MEDIAPIPE) - anchors.keys()):
        raise DataError("it has no landmark {number}", number=lacking[0])
    _check(rest=(places, (len(anchors), 3)), expression_modes=(modes, (len(modes), len(anchors), 3)))
    expressions = _expressions(given, len(modes))
    identity = _found(given, _SHAPE)
    if identity is not None and "identity_modes" in model:
        own = np.asarray(model["identity_modes"], dtype=np.float64)
        places = places + np.tensordot(_rows(given, _SHAPE, 1, max(len(own), identity.size))[0][: len(own)], own, 1)
    chosen = np.array([anchors[point] for point in _MEDIAPIPE])[IBUG68_INDICES]
    rest = places[chosen] * TO_HEAD
    rest[UPPER_LIPS] = rest[LOWER_LIPS] = (rest[UPPER_LIPS] + rest[LOWER_LIPS]) / 2.0
    unit = outer_eye_distance(rest) / _EYES_APART
    tracker = PointTracker(FacePoints(rest, rest), neck_of(rest), np.ones(len(rest)))
    recorder = TakeRecorder(describe_animation(source, fps))
    for number, values in enumerate(expressions):
        moved = rest + unit * np.tensordot(values, modes[:, chosen], 1) * TO_HEAD
        recorder.append(number / fps, tracker.result(FacePoints(moved, moved), np.eye(3), np.zeros(3)))
    take = tracker.finish(recorder)
    take.info["notes"] = [
        Message("By GNM's landmarks alone, the inner rims of the lips move as the outer ones, and the head is still.")
    ]
    return take
