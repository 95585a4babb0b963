"""Images of deformed heads: expressions and their landmarks, methods side by side, the curve of the greedy search."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from facemime.core.control_points.selection import GreedySelection
from facemime.core.face.landmarks import EDGES
from lab.bench.deformers import Method, Predict, triangles_of
from lab.bench.heads import TrueHead

Image = NDArray[np.uint8]
"""(H, W, 3), BGR."""

EXPRESSIONS: dict[str, tuple[str, ...]] = {
    "jaw open": ("jawOpen",),
    "smile": ("mouthSmile", "cheekSquint"),
    "pucker": ("mouthPucker",),
    "blink": ("eyeBlink",),
    "brows up": ("browInnerUp", "browOuterUp", "eyeWide"),
    "frown": ("browDown", "mouthFrown"),
    "sneer": ("noseSneer", "mouthUpperUp"),
    "laugh": ("jawOpen", "mouthSmile", "mouthUpperUp", "eyeSquint"),
    "to the left": ("mouthLeft", "jawLeft"),
}
_COMPARED = ("jaw open", "smile", "blink", "frown")
_COLUMNS = ("whole", "split", "gaussian", "regions", "informed", "laplacian", "blender_laplacian")
_SIDE = (230, 290)
_ZOOM, _MIDDLE = 0.47, (0.12, 0.02)
"""Outer-eye distance as a share of the image's width, and the centre of the view in outer-eye distances."""
_SKIN = np.array([150.0, 180.0, 210.0])
_BACKGROUND = (30, 28, 26)
WORST = 0.08
"""Error in outer-eye distances at the end of the colour scale."""
_LIGHT = np.array([0.25, -0.45, -0.85])


def draw_head(folder: Path, head: TrueHead, methods: list[Method], selection: GreedySelection) -> None:
    """Write the sheet, the comparison and the curve for `head` into `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    name = "ict" if head.title.startswith("ICT") else "built-in"
    by_name = {method.name: method for method in methods}
    write(folder / f"deformation-sheet-{name}.jpg", _sheet(head, by_name["informed"]))
    write(
        folder / f"deformation-methods-{name}.jpg",
        comparison(head, {column: by_name[column].predict for column in _COLUMNS}),
    )
    _curve(folder / f"deformation-greedy-{name}.png", head, selection)


def weights_of(head: TrueHead, units: tuple[str, ...]) -> NDArray[np.float64]:
    """Vector (E,) that is 1 for expressions whose name without side is in `units`."""
    bare = [
        name.removesuffix("_L").removesuffix("_R").removesuffix("Left").removesuffix("Right") for name in head.names
    ]
    sided = ("mouthLeft", "jawLeft")
    return np.array(
        [
            float(name in units if name in sided or any(unit in sided for unit in units) else short in units)
            for name, short in zip(head.names, bare, strict=True)
        ]
    )


def _sheet(head: TrueHead, method: Method) -> Image:
    tiles = []
    for title, units in EXPRESSIONS.items():
        true = head.true(weights_of(head, units)[None])
        found = method.predict(true[:, head.landmarks])[0]
        tiles.append(np.hstack([_landmarks(head, true[0], title), render(head, found)]))
    rows = [np.hstack(tiles[i : i + 3]) for i in range(0, len(tiles), 3)]
    return np.vstack(rows)


def comparison(
    head: TrueHead,
    methods: dict[str, Predict],
    expressions: Sequence[str] = _COMPARED,
) -> Image:
    """Draw true `expressions`, keys of `EXPRESSIONS`, one per row, beside the results of methods.

    `methods` are `Method.predict` by title. The errors are drawn as colours.
    """
    rows = []
    for title in expressions:
        true = head.true(weights_of(head, EXPRESSIONS[title])[None])
        row = [titled(render(head, true[0]), f"true: {title}")]
        for name, predict in methods.items():
            found = predict(true[:, head.landmarks])[0]
            off = np.linalg.norm(found - true[0], axis=1)
            share = off.sum() / np.linalg.norm(true[0], axis=1).sum()
            row.append(titled(render(head, found, off / WORST), f"{name} {share:.2f}"))
        rows.append(np.hstack(row))
    return np.vstack(rows)


def project(points: NDArray[np.floating], size: tuple[int, int] = _SIDE) -> NDArray[np.float64]:
    """Project points in the head frame to pixels of an image of that size, slightly from the side and above."""
    yaw, pitch = 0.35, -0.08
    turn = np.array([[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]])
    tilt = np.array([[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]])
    turned = (np.asarray(points, dtype=np.float64) @ (tilt @ turn).T - (*_MIDDLE, 0.0)) * (_ZOOM * size[0])
    turned[..., :2] += np.array(size) / 2.0
    return turned


def render(
    head: TrueHead,
    moved: NDArray[np.floating],
    error: NDArray[np.floating] | None = None,
    skin: NDArray[np.floating] | None = None,
    size: tuple[int, int] = _SIDE,
) -> Image:
    """Draw a head whose vertices are `moved` by displacements (V, 3), as flat triangles from back to front.

    `error` (V,), from 0 to 1, is drawn as colours; `skin` (V, 3), BGR from 0 to 255, replaces the colour of skin.
    `size` is the width and height in pixels.
    """
    scale = 2
    points = project(head.vertices + moved, size)
    triangles = triangles_of(head.faces)
    corners = points[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    light = np.clip(normals @ (_LIGHT / np.linalg.norm(_LIGHT)), 0.0, 1.0) * 0.75 + 0.3
    colours = np.tile(_SKIN, (len(triangles), 1)) if skin is None else skin[triangles].mean(axis=1)
    if error is not None:
        level = np.clip(error[triangles].mean(axis=1) * 255.0, 0, 255).astype(np.uint8)
        colours = cv2.applyColorMap(level[:, None], cv2.COLORMAP_TURBO)[:, 0].astype(float)
    colours = np.clip(colours * light[:, None], 0, 255)
    canvas = np.full((scale * size[1], scale * size[0], 3), _BACKGROUND, np.uint8)
    pixels = np.round(corners[..., :2] * scale * 16).astype(np.int32)
    towards = normals[:, 2] < 0.0
    for i in np.argsort(-corners[..., 2].mean(axis=1)):
        if towards[i]:
            cv2.fillConvexPoly(canvas, pixels[i], colours[i].tolist(), cv2.LINE_AA, 4)
    return np.asarray(cv2.resize(canvas, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _landmarks(head: TrueHead, moved: NDArray[np.float32], title: str) -> Image:
    """Draw the input landmarks."""
    canvas = np.full((_SIDE[1], _SIDE[0], 3), _BACKGROUND, np.uint8)
    points = project((head.vertices + moved)[head.landmarks])[:, :2]
    fixed = np.round(points * 16).astype(np.int32)
    for a, b in EDGES:
        cv2.line(canvas, fixed[a].tolist(), fixed[b].tolist(), (80, 220, 120), 1, cv2.LINE_AA, 4)
    for point in fixed:
        cv2.circle(canvas, point.tolist(), 26, (255, 255, 255), -1, cv2.LINE_AA, 4)
    return titled(canvas, title)


def titled(image: Image, title: str) -> Image:
    """Write a title onto an image, and return it."""
    cv2.putText(image, title, (8, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (235, 235, 235), 1, cv2.LINE_AA)
    return image


def write(path: Path, image: Image) -> None:
    """Write a JPEG."""
    cv2.imwrite(str(path), image, (cv2.IMWRITE_JPEG_QUALITY, 88))


def _curve(path: Path, head: TrueHead, selection: GreedySelection) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7.0, 3.4), layout="constrained")
    steps = selection.steps
    colours = {"start": "#3a7d6b", "add": "#c8642d", "drop": "#777777"}
    axes.plot(range(1, len(steps) + 1), [100 * step.error for step in steps], color="#bbbbbb", zorder=1)
    for action, colour in colours.items():
        chosen = [(i + 1, 100 * step.error) for i, step in enumerate(steps) if step.action == action]
        if chosen:
            axes.scatter(*zip(*chosen, strict=True), s=18, color=colour, label=action, zorder=2)
    axes.set_xlabel("step")
    axes.set_ylabel("worst error, % of the face's width")
    axes.set_yscale("log")
    axes.set_title(
        f"{head.title}: {len(selection.landmarks)} control points, over all its expressions and 250 mixtures"
    )
    axes.legend(frameon=False)
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=110)
    plt.close(figure)
