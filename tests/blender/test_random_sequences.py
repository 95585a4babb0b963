"""Random sequences of operators: Blender does not crash, nothing is left running, and everything can be undone."""

import threading

import bpy
import numpy as np
import pytest

from facemime.blender.heads.new_heads import add_head
from facemime.blender.meshes import is_head, read_vertices
from facemime.core.takes.file import save_take
from facemime.operators.puppet import running
from facemime.sessions.session import Session
from facemime.settings.preferences import preferences
from tests.fuzz.steps import OURS
from tests.helpers.live_ticks import attend
from tests.helpers.takes import performance
from tests.helpers.thorough import first_of

STEPS = 20


@pytest.fixture(scope="module")
def take(tmp_path_factory) -> str:
    """A recorded take, which needs neither a camera nor the tracker."""
    path = tmp_path_factory.mktemp("take") / "take.facetake"
    save_take(performance(), path)
    return str(path)


def press(rng: np.random.Generator) -> None:
    """Press a random enabled button; an error that it reports is fine."""
    name = str(rng.choice(BUTTONS))
    operator = getattr(bpy.ops.facemime, name)
    if not operator.poll():
        return
    try:
        operator(**{key: rng.choice(values).item() for key, values in CHOICES.get(name, {}).items()})
    except RuntimeError as error:
        assert "Traceback" not in str(error), error
    bpy.ops.ed.undo_push(message=name)


BUTTONS = (
    *("add_head", "bind_landmarks", "propose_regions", "check_head", "clear_marks", *["puppet"] * 6, "stop_puppet"),
    *("paint_region", "leave_painting", "mirror_regions", "smooth_regions", "use_all_landmarks", "calibrate"),
    *("add_control_point", "drop_control_point", "add_performer", "remove_performer", "reset_calibration"),
    *(*["record_take"] * 4, *["rerecord_take"] * 3, "show_take", "trim_take", "mend_take", "renew_neutral"),
    *("pack_take", "find_takes", "remove_take", "bake_take"),
)
CHOICES = {
    "paint_region": {"region": ("UPPER", "MIDDLE", "LOWER")},
    "mirror_regions": {"source": ("left", "right")},
    "smooth_regions": {"repeat": (1, 3)},
    "rerecord_take": {"start": (1, 5), "end": (8, 20), "lead": (0.0, 0.1)},
    "trim_take": {"start": (0.0, 0.5), "end": (0.4, 9.0)},
    "calibrate": {"pose": ("NEUTRAL", "RANGE"), "countdown": (0.0, 5.0)},
}


def change_mode(rng: np.random.Generator) -> None:
    """Change the mode."""
    if bpy.context.active_object is not None and bpy.ops.object.mode_set.poll():
        kinds = ("OBJECT", "EDIT", "SCULPT") if bpy.context.active_object.type == "MESH" else ("OBJECT",)
        bpy.ops.object.mode_set(mode=str(rng.choice(kinds)))


def change_scene(rng: np.random.Generator) -> None:
    """Delete, copy, rename or edit the active object."""
    obj = bpy.context.active_object
    if obj is None or bpy.context.mode != "OBJECT":
        return
    kind = rng.integers(4)
    if kind == 0:
        bpy.data.objects.remove(obj)
    elif kind == 1:
        bpy.ops.object.duplicate()
    elif kind == 2:
        obj.name = f"Renamed {rng.integers(9)}"
    else:
        bpy.ops.mesh.primitive_cube_add()
    bpy.ops.ed.undo_push(message="scene")


def go_back(rng: np.random.Generator) -> None:
    """Undo or redo."""
    operator = bpy.ops.ed.undo if rng.random() < 0.7 else bpy.ops.ed.redo
    if operator.poll():
        operator()


def tick(rng: np.random.Generator) -> None:
    """Tick the timer, and change a setting."""
    settings, steps = bpy.context.scene.facemime, bpy.context.scene.facemime_steps
    settings.strength_lower = rng.uniform(0.0, 3.0)
    settings.mirror, settings.keep_pose = rng.random() < 0.5, rng.random() < 0.3
    steps.landmark = int(rng.integers(-1, 66))
    steps.show_regions = steps.show_points = rng.random() < 0.5
    session = running()
    for _ in range(3):
        if session is None or session.operator is None:
            break
        session.operator.modal(bpy.context, EVENT)
    attend()


class EVENT:
    """A tick of the timer."""

    type, value = "TIMER", "NOTHING"
    ctrl = oskey = False
    mouse_x = mouse_y = 0


ACTIONS = (press, press, press, tick, tick, change_mode, change_scene, go_back)


@pytest.mark.thorough
@pytest.mark.parametrize("first", first_of(range(0, 100, 10)))
def test_random_sequences_do_not_break_blender(take, first, tmp_path):
    preferences().takes_folder = str(tmp_path)
    for seed in range(first, first + 10):
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
        source = bpy.context.scene.facemime.source
        source.kind, source.take, source.speed = "TAKE", take, 10.0
        rng = np.random.default_rng(seed)
        rest = read_vertices(add_head(bpy.context).data)
        bpy.ops.facemime.import_take(filepath=take)
        bpy.ops.ed.undo_push(message="head")
        for _ in range(STEPS):
            ACTIONS[rng.integers(len(ACTIONS))](rng)
        if Session.current is not None:
            Session.current.close()
        attend()
        assert Session.current is None, f"seed {seed}"
        left = [thread.name for thread in threading.enumerate() if thread.name.startswith("facemime")]
        assert left == [], f"seed {seed}"
        go_all_the_way_back(seed, rest)
    preferences().property_unset("takes_folder")


def go_all_the_way_back(seed: int, rest: np.ndarray) -> None:
    """Undo all steps, and check the rest shape of each head after every one."""
    for _ in range(3 * STEPS):
        for obj in bpy.data.objects:
            if is_head(obj) and obj.mode != "EDIT":
                np.testing.assert_array_equal(read_vertices(obj.data), rest, err_msg=f"seed {seed}")
        if not bpy.ops.ed.undo.poll():
            break
        bpy.ops.ed.undo()


def test_every_operator_is_in_the_random_sequences_of_the_fuzzer():
    registered = set(dir(bpy.ops.facemime))
    assert len(registered) > 60 and registered - OURS.keys() == set()
    # The other steps are changes to properties, which operators do not make.
    assert OURS.keys() - registered == {"tick", "how_to_bake", "write garbage", "garble selection", "take the pose"}
