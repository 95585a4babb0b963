"""Scans of the built-in head as by a depth camera: one skin, without openings for eyes and mouth."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from facemime.core.base.landmarks import OUTER_EYE_CORNERS
from facemime.core.heads.built_in import load_head
from facemime.core.heads.lids import EyeCut

HEAD = load_head()
VERTICES = HEAD.vertices.astype(float)
UNIT = float(np.linalg.norm(np.subtract(*VERTICES[HEAD.landmarks[OUTER_EYE_CORNERS]])))


def scanned(spacing: float = 0.02) -> tuple[np.ndarray, np.ndarray]:
    """The front of the head as one skin, on a grid with a spacing in eye distances."""
    step = spacing * UNIT
    low = VERTICES[:, :2].min(axis=0) - step
    width, height = np.ceil((VERTICES[:, :2].max(axis=0) - low) / step).astype(int) + 2
    depth = np.full((height, width), np.nan, np.float32)
    eyes = [part for part in HEAD.parts if part.name.startswith("eye")]
    triangles = np.concatenate([_triangles(surface.vertices, surface.faces) for surface in (HEAD, *eyes)])
    nearness = triangles[:, :, 2].mean(axis=1)
    for i in np.argsort(-nearness):
        corners = (triangles[i, :, :2] - low) / step
        cv2.fillConvexPoly(depth, np.round(corners).astype(np.int32), float(nearness[i]))
    seen = np.isfinite(depth)
    filled = np.where(seen, depth, np.nanmax(depth)).astype(np.float32)
    y, x = np.mgrid[:height, :width]
    places = np.stack([low[0] + step * x, low[1] + step * y, cv2.GaussianBlur(filled, (0, 0), 1.5)], axis=-1)
    number = np.arange(height * width).reshape(height, width)
    quads = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], axis=-1)
    whole = seen[:-1, :-1] & seen[:-1, 1:] & seen[1:, 1:] & seen[1:, :-1]
    used, faces = np.unique(quads[whole], return_inverse=True)
    return places.reshape(-1, 3)[used].astype(float), faces.reshape(-1, 4)


def write_scan(path: Path) -> int:
    """Write a scan as an OBJ file; returns the number of its vertices."""
    places, faces = scanned()
    lines = [f"v {x:.6f} {-y:.6f} {-z:.6f}" for x, y, z in places]
    lines += ["f " + " ".join(str(v + 1) for v in face) for face in faces.tolist()]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return len(places)


def _triangles(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Corners of the triangles of a surface, (T, 3, 3)."""
    return vertices[np.concatenate([faces[:, :3], faces[faces[:, 3] >= 0][:, [0, 2, 3]]])].astype(float)


def cut_apart(
    vertices: np.ndarray, polygons: list[list[int]], cut: EyeCut
) -> tuple[np.ndarray, list[list[int]], list[list[int]]]:
    """Apply a cut: all vertices, including new ones, and the polygons of the skin and of the eye."""
    ends = vertices[cut.edges]
    points = np.concatenate([vertices, ends[:, 0] + cut.shares[:, None] * (ends[:, 1] - ends[:, 0])])
    new = {frozenset(pair): len(vertices) + i for i, pair in enumerate(cut.edges.tolist())}
    rings = []
    for polygon in polygons:
        edges = zip(polygon, polygon[1:] + polygon[:1], strict=True)
        rings.append([v for a, b in edges for v in (a, new.get(frozenset((a, b)))) if v is not None])
    for a, b in cut.chords.tolist():
        whole = next(ring for ring in rings if a in ring and b in ring)
        rings.remove(whole)
        at = whole.index(a)
        turned = whole[at:] + whole[:at]
        rings += [turned[: turned.index(b) + 1], [*turned[turned.index(b) :], a]]
    within = set(cut.within.tolist())
    return points, [r for r in rings if not within & set(r)], [r for r in rings if within & set(r)]


def padded(polygons: list[list[int]]) -> np.ndarray:
    """Vertices of each polygon, (F, K), padded with -1."""
    widest = max(map(len, polygons))
    return np.array([polygon + [-1] * (widest - len(polygon)) for polygon in polygons])
