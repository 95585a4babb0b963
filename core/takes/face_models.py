"""Motion of statistical face models, FLAME's and GNM's, beside the model's file (takes.md)."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..errors import DataError, Message, SourceError
from ..face.rotation import fit_rotation
from ..files.capture import check_readable
from ..files.reading import shown
from ..numeric.arrays import FloatArray, IntArray
from .face_parameters import (
    BODY,
    DYNAMIC_OFFSET,
    EXPRESSION,
    EYES,
    IDENTITY,
    JAW,
    LEFT_EYE,
    NECK,
    POSE,
    RIGHT_EYE,
    ROOT,
    SCALE,
    STATIC_OFFSET,
    SUFFIXES,
    TRANSLATION,
    VERTICES,
    Arrays,
    FaceParameters,
    check_shapes,
    read_arrays,
    read_parameters_file,
)
from .landmark_model import take_of_landmarks
from .moving_mesh import TO_HEAD, MovingMesh, take_of_mesh
from .numbered_meshes import numbered_files, read_numbered
from .rates import check_rate
from .take import Take

FPS = 30.0
"""Rate of a sequence that states none."""
_IDENTITY = 300
"""Number of FLAME's modes of identity, which precede those of expression."""
_JOINTS = ((ROOT, (0,)), (NECK, (1,)), (JAW, (2,)), (EYES, (3, 4)), (LEFT_EYE, (3,)), (RIGHT_EYE, (4,)))
"""Joints of FLAME that each kind of rotation turns."""
_POSE_JOINTS = {1: (0,), 2: (0, 2), 3: (0, 1, 2), 5: (0, 1, 2, 3, 4)}
"""Joints of FLAME in `pose`, by their number."""
_BODY_JOINTS = 55
"""Number of joints of SMPL-X, whose expressions are FLAME's."""
_BODY_FACE = (22, 23, 24)
"""Joints of SMPL-X that are FLAME's jaw and eyes."""
_SPINE = (3, 6, 9, 12, 15)
"""Joints of SMPL-X from the hips to the head."""
_UPRIGHT = np.radians(60.0)
"""Mean rotation above which a head is not upright in the axes of its file, whose y may point down, or z up."""


def is_moving_face(path: Path) -> bool:
    """Return whether `read_moving_face` reads a file or folder: parameters, or several numbered meshes."""
    if os.path.isdir(path) or path.suffix.lower() in SUFFIXES:  # unlike those of Path, these never raise
        return True
    return os.path.isfile(path) and len(numbered_files(path)) > 1


def read_moving_face(
    path: Path, fps: float | None = None, model: Path | None = None, marks: Mapping[int, int] | None = None
) -> Take:
    """Return the take of numbered meshes, or of parameters, as `read_parameters` and `read_numbered` read them.

    Without `fps` the rate is that which the file states, or `FPS`.
    """
    check_rate(fps)
    if path.is_dir() and not numbered_files(path):
        path = next(iter(numbered_files(path, SUFFIXES).values()), path)
    if path.is_dir() or path.suffix.lower() not in SUFFIXES:
        return take_of_mesh(read_numbered(path), fps or FPS, marks)
    if not check_readable(path):
        raise SourceError("There is no file {path}. Check its name.", path=path)
    if model is None:
        raise SourceError(
            "{path} contains parameters of a face model. Choose the model's file, too: FLAME's .pkl, or GNM's .npz.",
            path=path,
        )
    return read_parameters(path, model, fps, marks)


def read_parameters(path: Path, model: Path, fps: float | None = None, marks: Mapping[int, int] | None = None) -> Take:
    """Return the take of a face model's parameters.

    `path` is a file that `read_parameters_file` reads; `model` is FLAME's model (`.pkl` or `.npz`), GNM's (`.npz`), or
    the file of GNM's landmarks. The face without expression is neutral; that of vertices is found in the take. Raises
    SourceError if a file cannot be read or they do not fit together, and HeadError if no face is found on the model.
    """
    known, given = read_arrays(model, Message("a face model")), read_parameters_file(path)
    rate = fps or given.fps or FPS
    try:
        if "expression_modes" in known:
            return take_of_landmarks(path.name, given, known, rate)
        mesh = _moving_mesh(path.name, given, known)
    except KeyError as error:
        raise SourceError("{path} is not a face model: it has no {name}.", path=model, name=error.args[0]) from error
    except (ValueError, IndexError) as error:
        raise SourceError(
            "{path} does not fit the model {model}: {error}.", path=path, model=model.name, error=error
        ) from error
    return take_of_mesh(mesh, rate, marks)


def _moving_mesh(source: str, given: FaceParameters, model: Arrays) -> MovingMesh:
    faces = np.asarray(model[next((name for name in ("f", "faces") if name in model), "triangles")], dtype=np.intp)
    notes = [Message("Not used: {names}", names=shown(", ".join(given.ignored)))] if given.ignored else []
    if VERTICES in given:
        template = model["v_template" if "v_template" in model else "template_vertex_positions"]
        places = _offsets(given.arrays[VERTICES], len(template)) * TO_HEAD
        _check_faces(faces, len(template))
        known = np.isfinite(places).all(axis=(1, 2))
        if not known.any():
            raise SourceError("{source} has no frame with a face. Choose another file.", source=source)
        frames = [place if whole else None for place, whole in zip(places, known, strict=True)]
        return MovingMesh(source, places[known][0], faces, frames, notes=tuple(notes))
    rig, turned = _upright(_flame(given, model) if "v_template" in model else _gnm(given, model))
    _check_faces(faces, len(rig.rest))
    if turned is not None:
        notes.append(
            Message("The head was {angle:.0f} degrees from upright in the middle, and was turned.", angle=turned)
        )
    if _is_body(given):
        notes.append(Message("Of the body, the turns of the head relative to the hips are used."))
    return MovingMesh(source, rig.rest * TO_HEAD, faces, rig, is_neutral=True, notes=tuple(notes))


def _check_faces(faces: IntArray, count: int) -> None:
    if faces.ndim != 2 or faces.min() < 0 or faces.max() >= count:
        raise DataError("a face has a vertex that does not exist")


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


def _flame(given: FaceParameters, model: Arrays) -> _Rig:
    """Return the frames of FLAME (Li et al. 2017)."""
    template = np.asarray(model["v_template"], dtype=np.float64)
    directions = np.asarray(model["shapedirs"], dtype=np.float64)
    regressor, weights = (np.asarray(model[name], dtype=np.float64) for name in ("J_regressor", "weights"))
    parents = np.array([0, *model["kintree_table"][0][1:].astype(np.intp)])
    count, joints = len(template), len(parents)
    correctives = np.asarray(model["posedirs"], dtype=np.float64).reshape(count, 3, -1)
    check_shapes(
        template=(template, (count, 3)), J_regressor=(regressor, (joints, count)), weights=(weights, (count, joints))
    )
    check_shapes(posedirs=(correctives, (count, 3, 9 * (joints - 1))), shapedirs=(directions[..., 0], (count, 3)))
    _check_tree(parents)
    if joints != 5:
        raise DataError("the model has {joints} joints, and FLAME has 5", joints=joints)
    identity = min(_IDENTITY, directions.shape[2])
    modes = np.moveaxis(directions[:, :, identity:], 2, 0)
    expressions = given.rows(EXPRESSION, len(modes))
    rest = template + directions[:, :, :identity] @ given.rows(IDENTITY, identity)[0] * (not _is_body(given))
    if STATIC_OFFSET in given:
        rest = rest + _offsets(given.arrays[STATIC_OFFSET], count)[0]
    return _Rig(
        rest=rest,
        joints=regressor @ rest,
        modes=modes,
        joint_modes=regressor @ modes,
        correctives=np.moveaxis(correctives, 2, 0),
        weights=weights,
        parents=parents,
        expressions=expressions,
        turns=_turns_of_flame(given),
        moved=_moved(given),
        offsets=_offsets(given.arrays[DYNAMIC_OFFSET], count) if DYNAMIC_OFFSET in given else None,
    )


def _is_body(given: FaceParameters) -> bool:
    """Whether parameters are those of SMPL-X, whose identity is that of a body."""
    return BODY in given or (POSE in given and given.turns(POSE).shape[1] == _BODY_JOINTS)


def _turns_of_flame(given: FaceParameters) -> FloatArray:
    """Return the rotation vectors (N, 5, 3) of FLAME's joints."""
    turns = np.zeros((given.count, 5, 3))
    body = given.turns(BODY) if BODY in given else None
    if POSE in given:
        pose = given.turns(POSE)
        if pose.shape[1] == _BODY_JOINTS:
            turns[:, 2:] = pose[:, _BODY_FACE]
            body = pose[:, 1:] if body is None else body
        elif pose.shape[1] in _POSE_JOINTS:
            turns[:, _POSE_JOINTS[pose.shape[1]]] = pose
        else:
            raise given.has_unknown_shape(POSE)
    for kind, joints in _JOINTS:
        if kind in given:
            own = given.turns(kind)
            if own.shape[1] != len(joints):
                raise given.has_unknown_shape(kind)
            turns[:, joints] = own
    if body is not None:
        if body.shape[1] < max(_SPINE):
            raise DataError("the body has {count} joints, and SMPL-X's has 21", count=body.shape[1])
        # Its root turns the whole body, which may walk in a circle, or have z up.
        turns[:, 0] = _product([body[:, joint - 1] for joint in _SPINE])
    return turns


def _product(chain: Sequence[FloatArray]) -> FloatArray:
    """Return the rotation vectors (N, 3) of the products of rotations (N, 3); NaN where one is unknown."""
    out = np.full(chain[0].shape, np.nan)
    for frame in np.flatnonzero(np.isfinite(chain).all(axis=(0, 2))):
        whole = np.eye(3)
        for turns in chain:
            whole = whole @ cv2.Rodrigues(turns[frame])[0]
        out[frame] = cv2.Rodrigues(whole)[0][:, 0]
    return out


def _moved(given: FaceParameters) -> FloatArray:
    """Return the translation (N, 3) of a head that has the size of the model; that of a body does not say its place."""
    if _is_body(given):
        return np.zeros((given.count, 3))
    scale = np.asarray(given.arrays.get(SCALE, 1.0), dtype=np.float64).reshape(-1)
    known = scale.size == 1 and np.isfinite(scale[0]) and scale[0] > 0.0
    return given.rows(TRANSLATION, 3) / (scale[0] if known else 1.0)


def _upright(rig: _Rig) -> tuple[_Rig, float | None]:
    """Turn a head that is not upright in the axes of its file; return the rig, and by how many degrees it was not."""
    known = np.isfinite(rig.turns[:, 0]).all(axis=1)
    matrices = np.array([cv2.Rodrigues(turn)[0] for turn in rig.turns[known, 0]])
    if not len(matrices):
        return rig, None
    mean = fit_rotation(np.tile(np.eye(3), (len(matrices), 1)), matrices.transpose(0, 2, 1).reshape(-1, 3))
    angle = float(np.linalg.norm(cv2.Rodrigues(mean)[0]))
    if angle < _UPRIGHT:
        return rig, None
    turns, pivot = rig.turns.copy(), rig.joints[0]
    turns[known, 0] = [cv2.Rodrigues(mean.T @ matrix)[0][:, 0] for matrix in matrices]
    return replace(rig, turns=turns, moved=(rig.moved + pivot) @ mean - pivot), float(np.degrees(angle))


def _gnm(given: FaceParameters, model: Arrays) -> _Rig:
    """Return the frames of GNM Head (Google, 2026), whose correctives are 0."""
    template, joints = (np.asarray(model[f"template_{of}_positions"], dtype=np.float64) for of in ("vertex", "joint"))
    modes: FloatArray = model["expression_basis"]
    identities, joint_identities = model["vertex_identity_basis"], model["joint_identity_basis"]
    weights = np.asarray(model["skinning_weights"], dtype=np.float64).T
    parents = np.array([0, *model["joint_parent_indices"][1:].astype(np.intp)])
    check_shapes(expression_basis=(modes[0], template.shape), skinning_weights=(weights, (len(template), len(joints))))
    _check_tree(parents)
    shape = given.rows(IDENTITY, len(identities))[0]
    turns = given.turns(ROOT) if ROOT in given else np.zeros((given.count, len(joints), 3))
    if turns.shape[1] != len(joints):
        raise given.has_unknown_shape(ROOT)
    return _Rig(
        rest=template + np.tensordot(shape, identities, 1),
        joints=joints + np.tensordot(shape, joint_identities, 1),
        modes=modes,
        joint_modes=np.zeros((len(modes), len(joints), 3)),
        correctives=np.empty((0, len(template), 3)),
        weights=weights,
        parents=parents,
        expressions=given.rows(EXPRESSION, len(modes)),
        turns=turns,
        moved=_moved(given),
    )


def _check_tree(parents: IntArray) -> None:
    """Raise ValueError unless every joint but the first comes after its parent."""
    if not ((parents[1:] >= 0) & (parents[1:] < np.arange(1, len(parents)))).all():
        raise DataError("its joints do not form a tree")


def _offsets(value: NDArray[Any], count: int) -> FloatArray:
    """Return offsets (N, V, 3) of the first vertices, as trackers add teeth to FLAME."""
    rows = np.asarray(value, dtype=np.float64)
    rows = rows.reshape(-1, count, 3) if rows.shape[-1] == 3 * count else rows.reshape(-1, *rows.shape[-2:])[:, :count]
    if rows.shape[1:] != (count, 3):
        raise DataError("an offset has the shape {shape}, for {count} vertices", shape=value.shape, count=count)
    return rows
