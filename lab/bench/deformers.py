"""The compared deformers, from displacements of landmarks to those of all vertices."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from time import perf_counter

import bpy
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, csc_matrix, diags
from scipy.sparse.linalg import splu

from facemime.core.control_points.greedy import greedy_select
from facemime.core.control_points.selection import GreedySelection, Search
from facemime.core.deform.expressions import ExpressionModel
from facemime.core.deform.head_deformer import head_deformer
from facemime.core.deform.rbf import IncrementalDeformer, RBFDeformer
from facemime.core.face.landmarks import N_LANDMARKS, from_ibug
from facemime.core.heads.regions import DEFAULT_KERNEL, sharp_regions
from facemime.core.heads.rig import HeadRig
from facemime.core.mesh.surface import islands
from lab.bench.heads import Points, TrueHead, random_mixtures

Predict = Callable[[NDArray[np.float32]], NDArray[np.float32]]
_RIDGE = 1e-4
SIGMAS = tuple(np.linspace(0.06, 0.3, 13).tolist())
"""Candidate widths of a single Gaussian, in outer-eye distances."""
_DEEP = 0.4
"""Distance behind the lips, in outer-eye distances, beyond which Laplacian deformation fixes the wall of the mouth; its
best value."""
_STEPS = 10
"""Number of frames from rest to an expression."""


@dataclass(frozen=True)
class Method:
    """A row of the comparison.

    Attributes
    ----------
    name : str
    points : int
        Number of control points.
    predict : callable
        Maps (N, 66, 3) displacements of the landmarks to (N, V, 3) of the vertices.
    prepare : float
        Seconds of preparation.
    frame : float
        Milliseconds per frame.
    """

    name: str
    points: int
    predict: Predict
    prepare: float
    frame: float


def all_methods(head: TrueHead, model: ExpressionModel, selection: GreedySelection) -> list[Method]:
    """Return all rows; `model` was learnt on another head."""
    papers = greedy_points(head, len(selection.landmarks), "paper")
    builders: dict[str, tuple[int, Callable[[], Predict]]] = {
        "whole": (N_LANDMARKS, lambda: whole(head)),
        "split": (N_LANDMARKS, lambda: split(head)),
        "gaussian": (N_LANDMARKS, lambda: regions(head, kernel="gaussian")),
        "paper": (N_LANDMARKS, lambda: regions(head, kernel="gaussian", sharp=True, exact=True)),
        "regions": (N_LANDMARKS, lambda: regions(head)),
        "paper_greedy": (len(papers.landmarks), lambda: regions(head, papers, "gaussian", sharp=True, exact=True)),
        "regions_greedy": (len(selection.landmarks), lambda: regions(head, selection)),
        "informed": (N_LANDMARKS, lambda: informed(head, model)),
        "informed_greedy": (len(selection.landmarks), lambda: informed(head, model, selection)),
        "laplacian": (N_LANDMARKS, lambda: laplacian(head)),
        "blender_laplacian": (N_LANDMARKS, lambda: blender_laplacian(head)),
        "own_matrix": (N_LANDMARKS, lambda: own_matrix(head)),
        "ridge": (N_LANDMARKS, lambda: ridge(head)),
    }
    methods = []
    for name, (points, build) in builders.items():
        start = perf_counter()
        predict = build()
        prepare = perf_counter() - start
        methods.append(Method(name, points, predict, prepare, _milliseconds(head, predict)))
    return methods


def greedy_points(head: TrueHead, count: int, search: Search = "take") -> GreedySelection:
    """Control points selected on single expressions of the head and on mixtures other than those of the evaluation."""
    weights = np.concatenate([np.eye(len(head.names)), random_mixtures(len(head.names), 250, seed=1)])
    motion = head.true(weights)[:, head.landmarks]
    skin = head.vertices, head.regions
    points = head.vertices[head.landmarks]
    return greedy_select(points, motion, tolerance=0.002, max_points=count, search=search, skin=skin)


def whole(head: TrueHead, sigma: float | None = None) -> Predict:
    """A Gaussian over the whole face (Yu & Li 2005), by default with the best sigma for these expressions."""
    if sigma is None:
        sigma = min(SIGMAS, key=lambda each: _error_alone(head, _one_region(head, each)))
    return _rbf(_one_region(head, sigma))


def split(head: TrueHead) -> Predict:
    """Three bands with weights of 0 and 1, cut along horizontal lines through eyes and mouth (Zhang 2017)."""
    points = head.vertices[head.landmarks]
    eyes, mouth = points[from_ibug((36, 39, 42, 45)), 1].mean(), points[from_ibug((48, 54)), 1].mean()

    def bands(height: Points) -> NDArray[np.bool_]:
        return np.stack([height <= eyes, (height >= eyes) & (height <= mouth), height >= mouth])

    weights = bands(head.vertices[:, 1]) * head.regions.any(axis=0)
    return _rbf(RBFDeformer(head.vertices, points, weights, bands(points[:, 1])))


def regions(
    head: TrueHead,
    chosen: GreedySelection | None = None,
    kernel: str = DEFAULT_KERNEL,
    *,
    sharp: bool = False,
    exact: bool = False,
) -> Predict:
    """Facemime's deformer with a kernel of distance alone; the paper's is a Gaussian, sharp and exact."""
    return _rbf(head_deformer(_rig(head, chosen, sharp=sharp), kernel, exact=exact))


def refitted(head: TrueHead, chosen: GreedySelection | None = None) -> Predict:
    """The paper's deformer, refitted in each of ten equal steps from rest."""
    deformer = head_deformer(_rig(head, chosen, sharp=True), "gaussian", exact=True, incremental=True)
    assert isinstance(deformer, IncrementalDeformer)

    def predict(displacements: NDArray[np.float32]) -> NDArray[np.float32]:
        out = np.empty((len(displacements), *deformer.rest.shape), np.float32)
        for moved, row in zip(displacements, out, strict=True):
            deformer.reset()
            for step in range(1, _STEPS + 1):
                deformer.deform(moved * (step / _STEPS), row)
        return out - deformer.rest

    return predict


def planar(predict: Predict) -> Predict:
    """A method, without depth."""
    return lambda displacements: predict(displacements * np.float32((1.0, 1.0, 0.0)))


def informed(head: TrueHead, model: ExpressionModel, chosen: GreedySelection | None = None) -> Predict:
    """Facemime's deformer with the covariance of the skin, and `model`, learnt on another head."""
    return _rbf(head_deformer(_rig(head, chosen), expressions=model))


def _rig(head: TrueHead, chosen: GreedySelection | None, *, sharp: bool = False) -> HeadRig:
    rig = head.rig
    if sharp:
        rig = replace(rig, region_weights=sharp_regions(rig.region_weights, rig.landmarks, rig.faces))
    return rig if chosen is None else replace(rig, control_points=chosen.membership, covariance=chosen.covariance)


def laplacian(head: TrueHead) -> Predict:
    """Bi-Laplacian editing with cotangent weights, ``L M^-1 L x = 0``; vertices outside all regions are fixed."""
    count = len(head.vertices)
    stiffness, mass = _cotangent(head)
    system = csc_matrix(stiffness @ diags(1.0 / mass) @ stiffness)
    free = np.setdiff1d(np.arange(count), _anchors(head))
    moves = -system[free][:, head.landmarks].toarray()
    matrix = np.zeros((count, N_LANDMARKS))
    matrix[free] = splu(system[free][:, free].tocsc()).solve(moves)
    matrix[head.landmarks] = np.eye(N_LANDMARKS)
    return _linear(matrix.astype(np.float32))


def blender_laplacian(head: TrueHead) -> Predict:
    """Blender's Laplacian Deform modifier with the same anchors."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    mesh = bpy.data.meshes.new("head")
    mesh.from_pydata(head.vertices.tolist(), [], [[int(v) for v in face if v >= 0] for face in head.faces])
    obj = bpy.data.objects.new("head", mesh)
    bpy.context.collection.objects.link(obj)
    bpy.context.view_layer.objects.active = obj
    group = obj.vertex_groups.new(name="anchors")
    group.add(_anchors(head).tolist(), 1.0, "REPLACE")
    modifier = obj.modifiers.new("laplacian", "LAPLACIANDEFORM")
    modifier.vertex_group = group.name
    bpy.ops.object.laplaciandeform_bind(modifier=modifier.name)
    if not modifier.is_bind:
        raise RuntimeError("Blender could not bind its Laplacian Deform modifier")
    rest = head.vertices.astype(np.float32)

    def predict(displacements: NDArray[np.float32]) -> NDArray[np.float32]:
        out = np.empty((len(displacements), *rest.shape), np.float32)
        for moved, row in zip(displacements, out, strict=True):
            anchors = rest.copy()
            anchors[head.landmarks] += moved
            mesh.attributes["position"].data.foreach_set("vector", anchors.reshape(-1))
            mesh.update_tag()
            evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
            flat = np.empty(rest.size, np.float32)
            evaluated.data.attributes["position"].data.foreach_get("vector", flat)
            np.subtract(flat.reshape(-1, 3), rest, out=row)
        return out

    return predict


def own_matrix(head: TrueHead) -> Predict:
    """The best matrix for this head's own motions, the limit of deformers that treat x, y and z alike."""
    weights = np.linalg.cholesky(head.mixtures.T @ head.mixtures + 1e-9 * np.eye(len(head.names))).T
    motion = head.true(weights).transpose(0, 2, 1).reshape(3 * len(head.names), -1)
    inputs = motion[:, head.landmarks].astype(np.float64)
    gram = inputs.T @ inputs
    system = gram + _RIDGE * np.trace(gram) / len(gram) * np.eye(len(gram))
    return _linear(np.linalg.solve(system, inputs.T @ motion).T.astype(np.float32))


def ridge(head: TrueHead) -> Predict:
    """A ridge regression from landmarks to vertices on this head's own expressions, the limit of knowing the rig."""
    inputs = head.motions[:, head.landmarks].reshape(len(head.names), -1).astype(np.float64)
    gram = inputs @ inputs.T
    targets = head.motions.reshape(len(head.names), -1)
    coefficients = np.linalg.solve(gram + _RIDGE * np.trace(gram) / len(gram) * np.eye(len(gram)), inputs)

    def predict(displacements: NDArray[np.float32]) -> NDArray[np.float32]:
        weights = displacements.reshape(len(displacements), -1) @ coefficients.T.astype(np.float32)
        return (weights @ targets).reshape(len(displacements), -1, 3)

    return predict


def _one_region(head: TrueHead, sigma: float) -> RBFDeformer:
    everywhere = head.regions.any(axis=0)[None].astype(float)
    return RBFDeformer(
        head.vertices, head.vertices[head.landmarks], everywhere, np.ones((1, N_LANDMARKS), bool), sigma=sigma
    )


def _error_alone(head: TrueHead, deformer: RBFDeformer) -> float:
    moved = np.einsum("vp,epc->evc", deformer.matrix(), head.motions[:, head.landmarks])
    return float(np.linalg.norm(moved - head.motions, axis=2).sum())


def _rbf(deformer: RBFDeformer) -> Predict:
    def predict(displacements: NDArray[np.float32]) -> NDArray[np.float32]:
        out = np.empty((len(displacements), *deformer.rest.shape), np.float32)
        for moved, row in zip(displacements, out, strict=True):
            deformer.deform(moved, row)
        out -= deformer.rest
        return out

    return predict


def _linear(matrix: NDArray[np.float32]) -> Predict:
    return lambda displacements: np.einsum("vp,npc->nvc", matrix, displacements, optimize=True)


def _anchors(head: TrueHead) -> NDArray[np.int64]:
    fixed = ~head.regions.any(axis=0) | _deep_in_mouth(head)
    return np.union1d(np.flatnonzero(fixed), head.landmarks)


def _deep_in_mouth(head: TrueHead) -> NDArray[np.bool_]:
    """Vertices of the mouth's wall far behind the rim of the lips; unless fixed, they swing with the lips."""
    rim = head.rims["mouth"]
    piece = islands(len(head.vertices), head.faces[~np.isin(head.faces, rim).any(axis=1)])
    inside = piece != np.bincount(piece).argmax()
    inside[rim] = False
    away = np.linalg.norm(head.vertices[:, None] - head.vertices[rim], axis=2).min(axis=1)
    return np.asarray(inside & (away > _DEEP))


def _cotangent(head: TrueHead) -> tuple[csc_matrix, Points]:
    """Cotangent stiffness matrix and vertex areas (Pinkall & Polthier 1993; Botsch & Sorkine 2008)."""
    triangles = triangles_of(head.faces)
    corners = head.vertices[triangles]
    rows, columns, values = [], [], []
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        a, b = corners[:, j] - corners[:, i], corners[:, k] - corners[:, i]
        cotangent = (a * b).sum(axis=1) / np.maximum(np.linalg.norm(np.cross(a, b), axis=1), 1e-12)
        rows.append(triangles[:, j])
        columns.append(triangles[:, k])
        values.append(0.5 * np.clip(cotangent, -20.0, 20.0))
    row, column, value = (np.concatenate(part) for part in (rows, columns, values))
    count = len(head.vertices)
    half = coo_matrix((value, (row, column)), shape=(count, count))
    weights = (half + half.T).tocsc()
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 6.0
    mass = np.bincount(triangles.ravel(), weights=np.repeat(area, 3), minlength=count)
    return csc_matrix(diags(np.asarray(weights.sum(axis=1)).ravel()) - weights), np.maximum(mass, 1e-9)


def triangles_of(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Triangles (T, 3) of faces (F, 3 or 4) padded with -1."""
    if faces.shape[1] == 3:
        return faces
    return np.concatenate([faces[:, :3], faces[faces[:, 3] >= 0][:, [0, 2, 3]]])


def _milliseconds(head: TrueHead, predict: Predict) -> float:
    """Median time of a frame."""
    motion = head.true(head.mixtures[:20])[:, head.landmarks]
    times = []
    for moved in motion:
        start = perf_counter()
        predict(moved[None])
        times.append(perf_counter() - start)
    return 1e3 * float(np.median(times))
