"""Settings of the steps Regions and Control Points, and what their panels remember while Blender runs."""

import bpy
from bpy.app.handlers import persistent
from bpy.props import BoolProperty, CollectionProperty, FloatProperty, IntProperty, StringProperty

from ..blender.registering import watch
from ..core.control_points.greedy import DEFAULT_TOLERANCE
from ..core.heads.checks import Finding
from ..core.landmarks import IBUG68_INDICES, N_LANDMARKS


class FacemimeSteps(bpy.types.PropertyGroup):
    """What regions and control points show, and how control points are chosen."""

    show_regions: BoolProperty(
        name="Show Regions", description="Draw the regions' colours over the head, outside Weight Paint mode"
    )
    regions_opacity: FloatProperty(name="Opacity", subtype="FACTOR", default=0.5, min=0.0, max=1.0)
    smooth_repeat: IntProperty(
        name="Repeat", description="How often the borders are smoothed", default=3, min=1, max=50
    )
    show_points: BoolProperty(
        name="Show Points", description="Draw the landmarks over the head, control points coloured"
    )
    tolerance: FloatProperty(
        name="Tolerance",
        description="How far a landmark that is no control point may end from where it was, of the face's width",
        subtype="PERCENTAGE",
        default=100.0 * DEFAULT_TOLERANCE,
        min=0.01,
        max=100.0,
        soft_max=10.0,
    )
    max_points: IntProperty(name="At Most", description="Control points", default=N_LANDMARKS, min=3, max=N_LANDMARKS)
    landmark: IntProperty(name="Landmark", description="The one picked in the list or on the head", min=-1, default=-1)
    only_chosen: BoolProperty(name="Only Control Points", description="List no other landmarks", default=True)


class FacemimeFinding(bpy.types.PropertyGroup):
    """What the last check found wrong, what to do, and the operator that does it, without its prefix."""

    problem: StringProperty()
    remedy: StringProperty()
    step: StringProperty()


class FacemimeLandmark(bpy.types.PropertyGroup):
    """A line of the list of landmarks; its place is the landmark's, its name the iBUG number."""


class FacemimeMemory(bpy.types.PropertyGroup):
    """What panels remember until Blender ends."""

    checked: StringProperty(description="Name of the head that was checked last")
    findings: CollectionProperty(type=FacemimeFinding)
    landmarks: CollectionProperty(type=FacemimeLandmark)


def keep_findings(manager: bpy.types.WindowManager, name: str, findings: list[Finding]) -> None:
    """Let the panel show what the check of the head `name` found."""
    memory = manager.facemime
    memory.checked = name
    memory.findings.clear()
    for finding in findings:
        line = memory.findings.add()
        line.problem, line.remedy, line.step = finding.problem, finding.remedy, finding.step


@persistent
def list_landmarks(*_: object) -> None:
    """Give each window manager its 66 lines; a panel may not write them when it draws."""
    for manager in bpy.data.window_managers:
        landmarks = manager.facemime.landmarks
        if len(landmarks) != N_LANDMARKS:
            landmarks.clear()
            for number in IBUG68_INDICES:
                landmarks.add().name = str(number)


CLASSES = (FacemimeSteps, FacemimeFinding, FacemimeLandmark, FacemimeMemory)
POINTERS = (
    (bpy.types.Scene, "facemime_steps", FacemimeSteps),
    (bpy.types.WindowManager, "facemime", FacemimeMemory),
)
HANDLERS = {"load_post": list_landmarks}
TIMERS = (list_landmarks,)


def register() -> None:
    """Add settings and memory; the lines come with the next event, as nothing may be written while add-ons start."""
    watch(list_landmarks, 0.0)
