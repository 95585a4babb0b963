"""Properties of the panels Regions and Control Points, and the state of panels until Blender quits."""

import bpy
from bpy.props import (
    BoolProperty,
    CollectionProperty,
    EnumProperty,
    FloatProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)

from ..blender.heads.family import face_candidates, heads_of, leads_to_face
from ..blender.messages import displayable, interface, translated
from ..blender.registering import watch
from ..blender.view_layers import select_alone
from ..core.control_points.selection import SelectionSettings
from ..core.face.landmarks import IBUG68_INDICES, N_LANDMARKS
from ..core.heads.checks import Finding
from .rna import with_settings
from .values import source_text


@with_settings(SelectionSettings)
class FacemimeSteps(bpy.types.PropertyGroup):
    """Display of regions and landmarks, and selection of control points."""

    show_regions: BoolProperty(
        name="Show Regions", description="Show the colours of the regions on the head, except in Weight Paint Mode"
    )
    regions_opacity: FloatProperty(
        name="Opacity", description="Opacity of the regions' colours", subtype="FACTOR", default=0.5, min=0.0, max=1.0
    )
    smooth_repeat: IntProperty(name="Repeat", description="Number of smoothing iterations", default=3, min=1, max=50)
    show_points: BoolProperty(
        name="Show Points", description="Show the landmarks on the head, with coloured control points"
    )
    arrows: EnumProperty(
        name="Arrows",
        description="Show on the face what the controls of its rig do",
        items=[
            ("NONE", "None", "Show no arrows"),
            ("SELECTED", "Selected", "Show how the control that is selected in the list moves the face"),
            ("ALL", "All", "Show where and how each control moves the face most"),
        ],
    )
    landmark: IntProperty(
        name="Landmark", description="Landmark selected in the list or on the head", min=-1, default=-1
    )
    only_chosen: BoolProperty(name="Only Control Points", description="List only control points", default=True)


class FacemimeFinding(bpy.types.PropertyGroup):
    """A problem found by the last check, its remedy, and the operator that fixes it, without its prefix."""

    problem: StringProperty()
    remedy: StringProperty()
    step: StringProperty()


class FacemimeLandmark(bpy.types.PropertyGroup):
    """An item of the list of landmarks, in their order; its name is the iBUG number."""


def _is_part(manager: bpy.types.WindowManager, obj: bpy.types.Object) -> bool:
    return leads_to_face(obj) or bool(heads_of([obj]))


def _make_active(manager: bpy.types.WindowManager, context: bpy.types.Context) -> None:
    """Select the face of the picked object; nothing is kept, as a stored pointer would keep a deleted head alive."""
    picked = manager.facemime_picked
    if picked is None:
        return
    manager.facemime_picked = None
    head = next(iter([*heads_of([picked]), *face_candidates(picked)]), picked)
    if context.mode == "OBJECT" and head.name in context.view_layer.objects:
        select_alone(context, head)


class FacemimeMemory(bpy.types.PropertyGroup):
    """State of panels until Blender quits."""

    checked: StringProperty(description="Name of the last head that was checked")
    findings: CollectionProperty(type=FacemimeFinding)
    landmarks: CollectionProperty(type=FacemimeLandmark)
    problem: StringProperty(description="Why the last puppet could not start or was stopped")
    problem_source: StringProperty(description="Settings of the source for which that holds")
    recorded: StringProperty(description="Name of the take that was recorded last and is not baked yet")
    unsure: StringProperty(description="Name of the last head on which the search was uncertain")
    wanted: StringProperty(description="iBUG numbers of the marks that would help most there")


def keep_problem(context: bpy.types.Context, problem: str) -> None:
    """Remember, for the current settings of the source, why a puppet could not start or was stopped; "" if it could."""
    memory = context.window_manager.facemime
    memory.problem = displayable(problem)
    memory.problem_source = displayable(source_text(context.scene.facemime.source)) if problem else ""


def problem_of(context: bpy.types.Context) -> str:
    """Return the known problem with the current source, or ""."""
    memory = context.window_manager.facemime
    if not memory.problem or memory.problem_source != displayable(source_text(context.scene.facemime.source)):
        return ""
    return str(memory.problem)


def keep_findings(manager: bpy.types.WindowManager, name: str, findings: list[Finding]) -> None:
    """Store the findings of a check of the named object for the panels."""
    memory = manager.facemime
    memory.checked = name
    memory.findings.clear()
    for finding in findings:
        line = memory.findings.add()
        line.problem, line.remedy = translated(finding.problem, interface), translated(finding.remedy, interface)
        line.step = finding.step


def list_landmarks(*_: object) -> None:
    """Fill the list of landmarks of each window manager, which a panel must not write while drawing."""
    for manager in bpy.data.window_managers:
        landmarks = manager.facemime.landmarks
        if len(landmarks) != N_LANDMARKS:
            landmarks.clear()
            for number in IBUG68_INDICES:
                landmarks.add().name = str(number)


POINTERS = (
    (bpy.types.Scene, "facemime_steps", FacemimeSteps),
    (bpy.types.WindowManager, "facemime", FacemimeMemory),
)
HANDLERS = {"load_post": list_landmarks}
TIMERS = (list_landmarks,)


def register() -> None:
    """Add the picker of heads, and fill the list of landmarks at the next event: no data may be written before."""
    # Within a property group, a function of Python here makes Blender 4.2 crash when it quits.
    bpy.types.WindowManager.facemime_picked = PointerProperty(
        name="Head",
        description="Head to drive; choose any part of a character",
        type=bpy.types.Object,
        poll=_is_part,
        update=_make_active,
    )
    watch(list_landmarks, 0.0)


def unregister() -> None:
    """Remove the picker."""
    del bpy.types.WindowManager.facemime_picked
