"""The FaceGen head that ships: `python -m lab.training.facegen`.

Jane, of Singular Inversions' FaceGen Base Library (MIT), with her mouth and hair, unchanged. The library has no
textures of mouth and hair, which are painted here.
"""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path

import cv2
import numpy as np

from facemime.core.heads.facegen import FaceGenMesh, read_tri
from facemime.core.mesh.surface import islands

from .data import ROOT, add_data_option

FOLDER = Path("heads") / "facegen"
OUTPUT = ROOT / "assets" / "facegen"
_COPIED = ("Jane.tri", "Jane.jpg", "Mouth.tri", "Hair.tri", "LICENSE.txt")
_SIDE = 512
"""Side of the painted textures in pixels."""
_GUMS, _ENAMEL, _GAP = (112, 106, 178), (196, 214, 222), (60, 66, 84)
_TONGUE, _WALL = (104, 96, 172), (44, 38, 92)
_HAIR = (22, 26, 34)
"""Colours of the mouth and the hair, BGR."""
_TEETH = 12
"""Visible teeth in a row."""
_LIT = 0.3
"""Share of a row, from the middle, that light reaches. Like the next, chosen by looking at Jane's open mouth."""
_DARK = 0.85
"""How much darker the last molar is."""
_CAP = 0.2
"""Share of the texture that only the cap is wider than."""
_STRANDS = 26
"""Strands across a lock."""


def main() -> None:
    """Copy the meshes and paint the textures."""
    command = argparse.ArgumentParser(prog="python -m lab.training.facegen", description=__doc__.splitlines()[0])
    add_data_option(command)
    source, rng = command.parse_args().data / FOLDER, np.random.default_rng(2026)
    OUTPUT.mkdir(parents=True, exist_ok=True)
    for name in _COPIED:
        shutil.copyfile(source / name, OUTPUT / name)
    cv2.imwrite(str(OUTPUT / "Mouth.png"), paint_mouth(read_tri(source / "Mouth.tri"), rng))
    cv2.imwrite(str(OUTPUT / "Hair.png"), paint_hair(read_tri(source / "Hair.tri"), rng))


def paint_mouth(mouth: FaceGenMesh, rng: np.random.Generator) -> np.ndarray:
    """Texture (S, S, 3) of tongue, wall and two rows of teeth."""
    image = np.full((_SIDE, _SIDE, 3), _WALL, np.uint8)
    pieces = _pieces(mouth)
    wall = max(pieces, key=lambda piece: float(np.ptp(mouth.vertices[piece][:, 1])))
    rows = [piece for piece in pieces if len(piece) == min(len(other) for other in pieces)]
    for piece in pieces:
        own = np.isin(mouth.faces[:, 0], piece)
        depth = mouth.vertices[:, 2]
        near, far = float(depth[piece].min()), float(depth[piece].max())
        for face, uv in zip(mouth.faces[own], _pixels(mouth, image)[own], strict=True):
            inside = (float(depth[face[face >= 0]].mean()) - near) / (far - near)
            colour, fade = (_WALL, 0.85) if piece is wall else (_TONGUE, 0.5)
            shade = tuple(float(value) * (1.0 - fade * inside) for value in colour)
            cv2.fillPoly(image, [uv[face >= 0]], shade)
    image = cv2.GaussianBlur(image, (0, 0), 3.0)
    for piece in rows:
        own = np.isin(mouth.faces[:, 0], piece)
        corners, where = mouth.faces[own], _pixels(mouth, image)[own]
        known = corners >= 0
        left, top = where[known].min(axis=0)
        right, bottom = where[known].max(axis=0)
        upper = mouth.vertices[piece][:, 1].mean() < np.mean([mouth.vertices[p][:, 1].mean() for p in rows])
        height, at = mouth.vertices[corners[known]][:, 1], where[known][:, 1]
        # The gums are at the top of the upper row, and at the bottom of the lower one.
        gums_first = (np.corrcoef(height, at)[0, 1] > 0.0) == upper
        image[top : bottom + 1, left : right + 1] = _row_of_teeth(right - left + 1, bottom - top + 1, gums_first, rng)
    noise = cv2.GaussianBlur(rng.normal(0.0, 1.0, image.shape[:2]).astype(np.float32), (0, 0), 2.0)
    return np.clip(image * (1.0 + 0.05 * noise[..., None] / noise.std()), 0, 255).astype(np.uint8)


def _row_of_teeth(width: int, height: int, gums_first: bool, rng: np.random.Generator) -> np.ndarray:
    """Picture (height, width, 3) of a row of teeth, with the gums at the top or at the bottom."""
    row = np.full((height, width, 3), _GAP, np.uint8)
    row[: height // 2] = _GUMS
    each = width / _TEETH
    for i in range(_TEETH):
        centre = ((i + 0.5) * each, height * 0.56)
        size = (each * 0.47, height * 0.44 * rng.uniform(0.93, 1.0))
        angle = np.linspace(0.0, 2.0 * np.pi, 60)
        edge = [np.sign(f) * np.abs(f) ** 0.5 for f in (np.cos(angle), np.sin(angle))]
        outline = np.stack([centre[k] + size[k] * edge[k] for k in (0, 1)], axis=1)
        cv2.fillPoly(row, [np.round(outline * 16).astype(np.int32)], _ENAMEL, cv2.LINE_AA, 4)
    # The cheeks of the head do not hide its molars, which have no width: seen along the row, they are a bright stroke.
    back = np.clip((np.abs(np.linspace(-1.0, 1.0, width)) - _LIT) / (1.0 - _LIT), 0.0, 1.0)
    shade = 1.0 - _DARK * np.sin(0.5 * np.pi * back)
    row = (cv2.GaussianBlur(row, (0, 0), 0.8) * shade[None, :, None]).astype(np.uint8)
    return row if gums_first else row[::-1]


def paint_hair(hair: FaceGenMesh, rng: np.random.Generator) -> np.ndarray:
    """Texture (S, S, 4) of locks, whose strands end at different lengths, and of the cap below them."""
    streaks = cv2.GaussianBlur(rng.normal(0.0, 1.0, (_SIDE, _SIDE)).astype(np.float32), (0, 0), 0.7, sigmaY=12.0)
    tone = np.array(_HAIR) * (1.0 + 0.5 * streaks / streaks.std())[..., None]
    alpha = np.full((_SIDE, _SIDE), 255, np.uint8)
    where = _pixels(hair, alpha)
    locks = np.zeros((_SIDE, _SIDE), np.uint8)
    for face, uv in zip(hair.faces, where, strict=True):
        cv2.fillPoly(locks, [uv[face >= 0]], 255)
    count, number, box, _ = cv2.connectedComponentsWithStats(locks)
    known = hair.faces >= 0
    places, at = hair.vertices[hair.faces[known]], where[known]
    for i in range(1, count):
        x, y, w, h = (int(v) for v in box[i][:4])
        if w > _CAP * _SIDE:
            continue
        own = number[at[:, 1], at[:, 0]] == i
        tip_below = np.corrcoef(places[own][:, 1], at[own][:, 1])[0, 1] > 0.0
        lock = np.zeros((h, w), np.uint8)
        for _ in range(_STRANDS):
            end, root = int(h * rng.uniform(0.6, 1.0)), rng.uniform(0, w - 1)
            lean = np.clip(root + rng.normal(0.0, 0.12 * w), 0, w - 1)
            cv2.line(lock, (round(root), 0), (round(float(lean)), end), 255, 1 + int(rng.random() < 0.6), cv2.LINE_AA)
        alpha[y : y + h, x : x + w] = lock if tip_below else lock[::-1]
    return np.dstack([np.clip(tone, 0, 255).astype(np.uint8), alpha])


def _pixels(mesh: FaceGenMesh, image: np.ndarray) -> np.ndarray:
    """Texture coordinates of the corners in pixels, (F, 4, 2) int32."""
    assert mesh.uv is not None
    last = np.array([image.shape[1] - 1, image.shape[0] - 1])
    return np.round(np.abs(mesh.uv - (0.0, 1.0)) * last).astype(np.int32)


def _pieces(mesh: FaceGenMesh) -> list[np.ndarray]:
    """Vertices of each connected piece."""
    number = islands(len(mesh.vertices), mesh.faces)
    return [np.flatnonzero(number == i) for i in np.unique(number)]


if __name__ == "__main__":
    main()
