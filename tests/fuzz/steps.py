"""The steps of random sequences: every operator of Facemime, and what users do to a scene in between."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace

import bpy

from facemime.core.puppet.sources import PacedSource
from facemime.operators.puppet import running
from tests.fuzz.scene_steps import BLENDERS, operator, pushed
from tests.fuzz.stage import Stage
from tests.helpers.live_ticks import attend

TIMER = SimpleNamespace(type="TIMER", value="NOTHING", ctrl=False, oskey=False, mouse_x=0, mouse_y=0)
CLICK = SimpleNamespace(type="LEFTMOUSE", value="PRESS", ctrl=False, oskey=False, mouse_x=0, mouse_y=0)
GARBAGE = ("text", 3.5, [1, 2, 3], {"a": 1}, 10**9, [-1] * 66, [10**6] * 66)
LONG_NAME = "a name of sixty letters, which is more than a file takes öäü/.."


def press(name: str, /, **options: Callable[[Stage], object]) -> Callable[[Stage], None]:
    """A step: an operator of Facemime whose poll succeeds."""

    def step(stage: Stage) -> None:
        operator = getattr(bpy.ops.facemime, name)
        chosen = {key: give(stage) for key, give in options.items()}
        if operator.poll():
            operator(**chosen)
            bpy.ops.ed.undo_push(message=name)

    return step


def one_of(*values: object) -> Callable[[Stage], object]:
    """Choose the value of an option."""
    return lambda stage: stage.any_of(values)


def file(name: str) -> Callable[[Stage], str]:
    """Choose the path of a file."""
    return lambda stage: str(getattr(stage.files, name))


def new_file(suffix: str) -> Callable[[Stage], str]:
    """Choose a path for output."""
    return lambda stage: str(stage.files.out / f"{stage.rng.integers(4)}{suffix}")


def any_object(stage: Stage) -> str:
    """Choose the name of an object, or of none."""
    return getattr(stage.any_of([*bpy.data.objects, None]), "name", "none")


def tick(stage: Stage) -> None:
    """Send frames, ticks of the timer, a click, or the change of a slider."""
    settings, steps = bpy.context.scene.facemime, bpy.context.scene.facemime_steps
    settings.strength_lower = stage.rng.uniform(0.0, 3.0)
    settings.mirror, settings.keep_pose = bool(stage.rng.random() < 0.5), bool(stage.rng.random() < 0.3)
    settings.source.kind = "TAKE"
    settings.source.take, settings.source.loop = str(stage.files.take), bool(stage.rng.random() < 0.8)
    steps.landmark = int(stage.rng.integers(-1, 66))
    steps.show_regions, steps.show_points = bool(stage.rng.random() < 0.5), bool(stage.rng.random() < 0.5)
    for _ in range(stage.rng.integers(1, 40)):
        session = running()
        if session is None:
            break
        PacedSource.pace.ask(lambda worker=session.worker: worker.running)
        if session.operator is None:
            session.step()
        else:
            session.operator.modal(bpy.context, stage.any_of((TIMER, TIMER, TIMER, CLICK)))
    attend()


OURS: dict[str, Callable[[Stage], None]] = {
    "add_head": press("add_head", units=one_of(False, True)),
    "bind_landmarks": press("bind_landmarks"),
    "propose_regions": press("propose_regions"),
    "check_head": press("check_head"),
    "clear_marks": press("clear_marks"),
    "mark_point": press("mark_point"),
    "set_landmark": press("set_landmark", number=one_of(0, 33, 60, 67)),
    "open_lips": press("open_lips"),
    "open_eyes": press("open_eyes"),
    "puppet": press("puppet"),
    "stop_puppet": press("stop_puppet"),
    "next_face": press("next_face"),
    "puppet_video": press("puppet_video", filepath=file("take")),
    "paint_region": press("paint_region", region=one_of("UPPER", "MIDDLE", "LOWER")),
    "leave_painting": press("leave_painting"),
    "mirror_regions": press("mirror_regions", source=one_of("left", "right")),
    "smooth_regions": press("smooth_regions", repeat=one_of(1, 3)),
    "calibrate": press("calibrate", pose=one_of("NEUTRAL", "RANGE"), countdown=one_of(0.0, 5.0)),
    "add_performer": press("add_performer"),
    "remove_performer": press("remove_performer"),
    "reset_calibration": press("reset_calibration"),
    "save_preset": press("save_preset", name=one_of("A", LONG_NAME)),
    "load_preset": press("load_preset", name=one_of("A", LONG_NAME)),
    "remove_preset": press("remove_preset", name=one_of("A", LONG_NAME)),
    "export_preset": press("export_preset", filepath=new_file(".json")),
    "import_preset": press("import_preset", filepath=new_file(".json")),
    "select_control_points": press("select_control_points", filepath=file("take"), max_points=one_of(5, 12)),
    "select_live_points": press("select_live_points", max_points=one_of(5, 12)),
    "add_control_point": press("add_control_point"),
    "drop_control_point": press("drop_control_point"),
    "use_all_landmarks": press("use_all_landmarks"),
    "record_take": press("record_take"),
    "rerecord_take": press("rerecord_take", start=one_of(1, 5), end=one_of(8, 20), lead=one_of(0.0)),
    "show_take": press("show_take"),
    "trim_take": press("trim_take", start=one_of(0.0, 0.5), end=one_of(0.4, 9.0)),
    "mend_take": press("mend_take", mirror=one_of(False, True)),
    "edit_landmarks": press("edit_landmarks"),
    "next_doubtful_frame": press("next_doubtful_frame"),
    "learn_from_pins": press("learn_from_pins"),
    "renew_neutral": press("renew_neutral"),
    "punch_in_take": press("punch_in_take", other=one_of("take", "Take", "none")),
    "pack_take": press("pack_take"),
    "find_takes": press("find_takes"),
    "remove_take": press("remove_take"),
    "import_take": press("import_take", filepath=file("take")),
    "export_take": press("export_take", filepath=new_file(".csv")),
    "bake_take": press("bake_take"),
    "teach_frame": press("teach_frame"),
    "suggest_frames": press("suggest_frames", count=one_of(1, 5)),
    "remove_example": press("remove_example"),
    "save_style": press("save_style", filepath=new_file(".facestyle")),
    "load_style": press("load_style", filepath=new_file(".facestyle")),
    "detect_key_map": press("detect_key_map"),
    "add_key_row": press("add_key_row"),
    "remove_key_row": press("remove_key_row"),
    "export_key_map": press("export_key_map", filepath=new_file(".json")),
    "import_key_map": press("import_key_map", filepath=new_file(".json")),
    "add_key_pose": press("add_key_pose"),
    "learn_key_map": press("learn_key_map"),
    "add_reference": press("add_reference"),
    "import_facegen": press("import_facegen", filepath=file("facegen")),
    "bind_keys": press("bind_keys"),
    "mark_face": press("mark_face", points=one_of("", "36,39,48,8")),
    "pick_landmark": press("pick_landmark"),
    "adjust_landmarks": press("adjust_landmarks"),
    "accept_points": press("accept_points"),
    "discard_points": press("discard_points"),
    "find_parts": press("find_parts"),
    "add_part": press("add_part", part=one_of("ON_HEAD", "ON_SKIN", "EYE_LEFT", "TEETH_LOWER")),
    "set_part": press("set_part", part=one_of("SKIN", "ON_HEAD", "EYE_RIGHT"), name=any_object),
    "remove_part": press("remove_part", name=any_object),
    "set_bone": press("set_bone", target=one_of("head", "eye_right", "eye_left")),
    "make_expression_keys": press("make_expression_keys", keys=one_of("vrm", "oculus")),
    "learn_controls": press("learn_controls"),
    "export_control_sheet": press("export_control_sheet", filepath=new_file(".html")),
    "add_face_rig": press("add_face_rig"),
    "rank_controls": press("rank_controls", take=one_of(-1, 0)),
    "mute_others": press("mute_others"),
    "add_corrections": press("add_corrections"),
    "remove_corrections": press("remove_corrections"),
    "take_from_animation": press("take_from_animation"),
    "export_gltf": press("export_gltf", filepath=new_file(".glb")),
    "add_sound": press("add_sound"),
    "stop_tracking": press("stop_tracking"),
    "clear_calibrations": press("clear_calibrations"),
    "choose_camera": press("choose_camera", camera=one_of("0", "none")),
    "open_viewer": press("open_viewer"),
    "copy_viewer_address": press("copy_viewer_address"),
    "copy_pairing_line": press("copy_pairing_line"),
    "renew_pairing_line": press("renew_pairing_line"),
    **{name: press(name) for name in (f"finish_parts_{number}" for number in range(7))},
    "tick": tick,
}


def how_to_bake(stage: Stage) -> None:
    """Choose the target of the next bake."""
    bake = bpy.context.scene.facemime_takes.bake
    bake.keys = str(stage.any_of(("new", "named", "mapped", "cache")))
    bake.nla, bake.max_keys = bool(stage.rng.random() < 0.4), int(stage.rng.integers(1, 5))


OURS["how_to_bake"] = how_to_bake


@pushed
def write_garbage(stage: Stage) -> None:
    """Write garbage to one of Facemime's custom properties."""
    if (mesh := stage.mesh()) is not None:
        name = str(stage.any_of(("facemime_landmarks", "facemime_vertex_count", "facemime_marks")))
        mesh[name] = stage.any_of(GARBAGE)


@pushed
def garble_selection(stage: Stage) -> None:
    """Change the control points that are stored with the mesh."""
    if (mesh := stage.mesh()) is not None and mesh.library is None:
        mesh["facemime_control_points"] = str(
            stage.any_of(("", "{}", "[1]", '{"format": "facemime-control-points-1"}'))
        )


@pushed
def take_the_pose(stage: Stage) -> None:
    """Change the pose target to another object or none."""
    posing = bpy.context.scene.facemime.posing
    posing.object = stage.any_of([*bpy.data.objects, None])
    posing.eye_left = stage.any_of([*bpy.data.objects, None, None])


OURS |= {"write garbage": write_garbage, "garble selection": garble_selection, "take the pose": take_the_pose}
OFTEN = (
    ("puppet",) * 8 + ("tick",) * 14 + ("add_head",) * 3 + ("bake_take", "puppet_video", "show_take", "import_take") * 2
)
STEPS = {**OURS, **BLENDERS, "add Suzanne": operator("mesh.primitive_monkey_add")}
STAND_INS = {"add_head": "add Suzanne"}
NAMES = [*OURS, *OFTEN, *BLENDERS, *["undo"] * 5, *["redo"] * 2]
