"""What becomes of strangers' characters: `python -m bench.characters FOLDER`, on the .glb files of a folder.

Each is imported, bound without marks and driven by the sample clip. Its parts are compared with what a person made of
them, by object and material. Eyes: what is still seen of them from the front when the performer's are shut, as a share
of what is seen at rest. ARKit's keys are made on each, and what their lids and lips leave open or pass through is
measured. Nothing of the characters is kept.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import bpy
import numpy as np

import facemime
from bench.report import Table, finish, parser
from facemime.blender.characters import objects_of, part_mesh, read_bones, read_kinds
from facemime.blender.heads.binding import bind_character
from facemime.blender.meshes import read_faces
from facemime.blender.rigs import read_rig
from facemime.core.binding.eye_contours import eye_openness
from facemime.core.drive.driver import HeadDriver
from facemime.core.drive.expression_keys import expression_keys
from facemime.core.drive.key_quality import key_qualities
from facemime.core.drive.key_sets import KEY_SETS
from facemime.core.heads.parts import Part
from facemime.core.landmarks import LOWER_LIDS, UPPER_LIDS
from facemime.core.takes.from_video import track_video
from facemime.core.takes.neutral import calibrate
from facemime.core.tracking.tracker import FaceTracker
from facemime.settings.values import SAMPLE

_EYES = {Part.EYE_RIGHT, Part.EYE_LEFT}
_TEETH = {Part.TEETH_UPPER, Part.TEETH_LOWER}
TRUTH: Mapping[str, Mapping[str, set[Part]]] = {
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
"""What a person made of the materials of each character, by a part of their names."""


@dataclass(frozen=True)
class Result:
    """Shares of vertices sorted right, seconds to bind, and so on, of a character."""

    right: float
    bones: int
    seconds: float
    open_shut: float
    made_eyes: float
    made_lips: float
    made_crossing: float
    made_worst: int


def main() -> int:
    """Run the benchmark; returns the exit status."""
    command = parser(__doc__.splitlines()[0])
    command.add_argument("folder", type=Path, metavar="FOLDER", help="folder with .glb files")
    arguments = command.parse_args()
    facemime.register()
    take = track_video(SAMPLE, FaceTracker.load()).finish()
    results = {path.stem: judge(path, take) for path in sorted(arguments.folder.glob("*.glb")) if path.stem in TRUTH}
    columns = (
        "character",
        "parts right %",
        "bones",
        "seen of shut eyes %",
        "seconds",
    )
    rows = [
        (name, 100 * r.right, r.bones, "" if np.isnan(r.open_shut) else 100 * r.open_shut, r.seconds)
        for name, r in results.items()
    ]
    numbers = {name: vars(result) for name, result in results.items()}
    made = [(name, 100 * r.made_eyes, 100 * r.made_lips, r.made_crossing, r.made_worst) for name, r in results.items()]
    figures = ("character", "eyes open %", "lips apart %", "crossing triangles", "at most")
    tables = [
        Table("Strangers' characters, bound without marks", columns, rows),
        Table("ARKit's keys, made on strangers' characters", figures, made),
    ]
    finish(arguments, tables, numbers)
    facemime.unregister()
    return 0


def judge(path: Path, take) -> Result:
    """Bind and drive a character."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.import_scene.gltf(filepath=str(path))
    meshes = [obj for obj in bpy.data.objects if obj.type == "MESH" and (obj.parent or not obj.name.startswith("Ico"))]
    start = perf_counter()
    head, _ = bind_character(meshes[0])
    seconds = perf_counter() - start
    _, bones = read_bones(head)
    right = np.concatenate([_right(obj, TRUTH[path.stem]) for obj in (head, *objects_of(head))])
    rig = read_rig(head)
    driver = HeadDriver(rig, calibrate(take))
    shapes = take.shape[take.found]
    lids = np.linalg.norm(shapes[:, UPPER_LIDS] - shapes[:, LOWER_LIDS], axis=2).mean(axis=1)
    shut = int(np.flatnonzero(take.found)[np.argmin(lids)])
    count = len(head.data.vertices)
    keys = KEY_SETS["arkit"]
    made = key_qualities(rig, keys, expression_keys(rig, keys)[1])
    return Result(
        right=float(right.mean()),
        bones=sum(bool(name) for name in (bones.head, bones.eye_right, bones.eye_left)),
        seconds=seconds,
        open_shut=_seen(head, rig.vertices, driver.frame(take.result(shut)).vertices[:count]),
        made_eyes=float(np.nanmax([quality.eyes for quality in made])),
        made_lips=float(np.nanmax([quality.lips for quality in made])),
        made_crossing=float(np.mean([quality.crossing for quality in made])),
        made_worst=max(quality.crossing for quality in made),
    )


def _right(obj: bpy.types.Object, truth: Mapping[str, set[Part]]) -> np.ndarray:
    """Whether each vertex of an object that has a face got one of the parts that its material says."""
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


def _seen(head: bpy.types.Object, rest: np.ndarray, shut: np.ndarray) -> float:
    """Share of the area of both eyes at rest that is still seen when they are shut; NaN without eyes of their own."""
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


if __name__ == "__main__":
    sys.exit(main())
