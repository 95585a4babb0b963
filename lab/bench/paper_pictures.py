"""Pictures of docs/accuracy/paper.md."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from facemime.blender.animation.puppet import puppet_head
from facemime.blender.preview_scene import face_view, setup_preview
from facemime.blender.rendering import render_frames
from facemime.blender.timeline import frames_of
from facemime.cli.headless import open_stage
from facemime.core.control_points.greedy import START
from facemime.core.control_points.select import select_control_points
from facemime.core.control_points.table import REGION_COLOURS
from facemime.core.deform.expressions import load_expressions
from facemime.core.drive.drive_settings import DriveSettings
from facemime.core.drive.driver import select_distinct_frames
from facemime.core.face.landmarks import from_ibug
from facemime.core.files.capture import VideoSource
from facemime.core.heads.regions import membership, sharp_regions
from facemime.core.heads.rig import HeadRig
from facemime.core.puppet.job import PuppetJob
from facemime.core.puppet.puppet_settings import PuppetSettings
from facemime.core.takes.take import Take
from facemime.core.tracking.overlay import contact_sheet, draw_face
from lab.bench.deform_pictures import EXPRESSIONS, Image, comparison, project, render, titled, weights_of, write
from lab.bench.deformation import opening
from lab.bench.deformers import Predict, blender_laplacian, informed, laplacian, planar, regions, whole
from lab.bench.heads import TrueHead

_LARGE = (400, 500)
_TILE = 240
_SHOWN = 8
_BARE = np.array([165.0, 165.0, 165.0])
_COLOURS = 255.0 * np.array(REGION_COLOURS)[:, ::-1]
"""Colours of the regions, BGR."""
_MIXED = (200, 120, 220)
"""Colour of control points that belong to two regions."""


def draw(folder: Path, head: TrueHead, rig: HeadRig, take: Take, video: Path, paper: DriveSettings) -> None:
    """Write all pictures into `folder`, with `take` the sample clip, tracked, and `paper` the preset of the paper."""
    folder.mkdir(parents=True, exist_ok=True)
    write(folder / "regions.jpg", _regions(head))
    write(folder / "points.jpg", _points(head, rig, take))
    write(folder / "openings.jpg", _openings(head))
    write(folder / "laplacian.jpg", _errors(head))
    write(folder / "expressions.jpg", _expressions(take, video, paper))


def _regions(head: TrueHead) -> Image:
    """Figure 6: sets of vertices whose borders belong to both sides, and the painted weights."""
    sharp = sharp_regions(head.regions, head.landmarks, head.faces)
    tiles = []
    for title, weights in (("sets of vertices, as in the paper", sharp), ("painted weights", head.regions)):
        total = np.maximum(weights.sum(axis=0), 1e-9)
        mixed = weights.T @ _COLOURS / total[:, None]
        share = np.minimum(total, 1.0)[:, None]
        skin = share * mixed + (1.0 - share) * _BARE
        tiles.append(titled(render(head, np.zeros_like(head.vertices), skin=skin, size=_LARGE), title))
    return np.hstack(tiles)


def _points(head: TrueHead, rig: HeadRig, take: Take) -> Image:
    """Figures 7 and 8: all landmarks, those of the muscles, and those selected by two searches."""
    start = np.zeros_like(membership())
    for row, muscles in zip(start, START, strict=True):
        row[from_ibug(tuple(muscles))] = True
    chosen = {"all landmarks": membership(), "muscle points": start}
    for title, search in (("equation 6", "paper"), ("our search", "take")):
        chosen[f"{title}, within 1.5 %"] = select_control_points(rig, take, tolerance=0.015, search=search).membership
    tiles = []
    for title, members in chosen.items():
        used = int(members.any(axis=0).sum())
        tile = render(head, np.zeros_like(head.vertices), skin=np.tile(_BARE, (len(head.vertices), 1)), size=_LARGE)
        for (x, y), column in zip(project(head.vertices[head.landmarks], _LARGE)[:, :2], members.T, strict=True):
            colour = _MIXED if column.sum() > 1 else _COLOURS[column.argmax()].tolist() if column.any() else None
            place = (round(16 * x), round(16 * y))
            cv2.circle(tile, place, 72, colour or (90, 90, 90), -1 if colour else 1, cv2.LINE_AA, 4)
        upper = int(members[0].sum())
        tiles.append(titled(tile, f"{title}: {used}, {upper} in the upper region"))
    return np.vstack([np.hstack(tiles[:2]), np.hstack(tiles[2:])])


def _openings(head: TrueHead) -> Image:
    """Figure 10: an open mouth and shut eyes."""
    methods: dict[str, Predict] = {
        "one function": whole(head),
        "one wide function": whole(head, 0.2),
        "three regions": planar(regions(head, kernel="gaussian", sharp=True, exact=True)),
        "default": informed(head, load_expressions()),
    }
    rows = []
    for title in ("jaw open", "laugh", "blink"):
        true = head.true(weights_of(head, EXPRESSIONS[title])[None])
        row = [titled(render(head, true[0]), f"true: {title}")]
        for name, predict in methods.items():
            found = predict(true[:, head.landmarks])
            rim = head.rims["mouth"]
            shown, wanted = (float(opening(head.vertices[rim] + moved[:, rim])[0]) for moved in (found, true))
            row.append(titled(render(head, found[0]), name if title == "blink" else f"{name}: {shown / wanted:.2f}"))
        rows.append(np.hstack(row))
    return np.vstack(rows)


def _errors(head: TrueHead) -> Image:
    """Figure 11: errors as colours."""
    methods: dict[str, Predict] = {
        "paper": planar(regions(head, kernel="gaussian", sharp=True, exact=True)),
        "with depth": regions(head, kernel="gaussian", sharp=True, exact=True),
        "bi-Laplacian": laplacian(head),
        "Blender's": blender_laplacian(head),
        "default": informed(head, load_expressions()),
    }
    return comparison(head, methods, ("smile", "blink", "brows up", "frown"))


def _expressions(take: Take, video: Path, paper: DriveSettings) -> Image:
    """Figure 9: the performer, the avatar by the paper's method, and that by default."""
    avatars: list[list[Image]] = []
    frames: NDArray[np.intp] | None = None
    for options in (DriveSettings(), paper):
        stage = open_stage(PuppetJob(video, Path("sheet.blend"), PuppetSettings(drive=options)))
        view = face_view(stage.head)
        report = puppet_head(stage.scene, stage.head, take, stage.settings)
        setup_preview(stage.scene, stage.head, (_TILE, _TILE), view)
        if frames is None:
            frames = np.flatnonzero(take.found)[select_distinct_frames(report.motion, _SHOWN)]
        pictures = render_frames(stage.scene, frames_of(stage.scene, take.times[frames]), (_TILE, _TILE))
        avatars.append([picture.copy() for picture in pictures])
    assert frames is not None
    wanted = set(frames.tolist())
    with VideoSource(video) as source:
        faces = [draw_face(f.image, take.landmarks[f.index], _TILE) for f in source if f.index in wanted]
    trios = [
        (titled(face, "performer"), np.hstack([titled(theirs, "Yao et al. 2019"), titled(ours, "default")]))
        for face, ours, theirs in zip(faces, *avatars, strict=True)
    ]
    return contact_sheet(trios, columns=2, gap=8)
