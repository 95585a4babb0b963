"""Operators that put the landmarks of the selected take in their places, and let the tracker learn from them."""

from typing import Any

import bpy
import numpy as np
from bpy.app.translations import pgettext_rpt as _

from ..blender.stubs import OperatorResult
from ..blender.viewports import free_box, redraw, viewport_of
from ..core.errors import FacemimeError, HeadError
from ..core.face.landmarks import N_LANDMARKS
from ..core.takes.correction import learn
from ..core.takes.pin_editor import doubtful_frames
from ..core.takes.pins import learns_from_pins, pins_of, with_learning
from ..sessions.landmark_edit import LandmarkEdit, frame_at, go_to_frame, write_pins
from ..settings import takes_store
from ..settings.performers import write_learnt
from .shared import report, require
from .takes import OnTake

_REACH = 14.0
"""Distance of the mouse within which a landmark is taken, in unscaled pixels."""
_ZOOM = 1.2
"""Factor of a step of the mouse wheel."""
_JUMP = 10
"""Number of frames of a step with Shift."""
_ENTER = {"RET", "NUMPAD_ENTER"}
_STEPS = {"LEFT_ARROW": -1, "RIGHT_ARROW": 1}
_PINNED = {"DOWN_ARROW": -1, "UP_ARROW": 1}
_ZOOMS = {"WHEELUPMOUSE": _ZOOM, "WHEELDOWNMOUSE": 1.0 / _ZOOM, "NUMPAD_PLUS": _ZOOM, "NUMPAD_MINUS": 1.0 / _ZOOM}


class FACEMIME_OT_edit_landmarks(OnTake, bpy.types.Operator):
    """Drag landmarks of the selected take to their places; frames nearby follow, and what was tracked is kept"""

    bl_idname = "facemime.edit_landmarks"
    bl_label = "Edit Landmarks"
    _edit: LandmarkEdit
    _mouse: np.ndarray[Any, np.dtype[np.float64]]
    _pans = False
    _moved = False

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Require a take, and that none is being edited."""
        free = LandmarkEdit.current is None
        return super().poll(context) and require(cls, free, "Press Enter or Esc in the viewport to end editing first")

    def work(self, context: bpy.types.Context) -> OperatorResult:
        """Show the current frame in a viewport, and wait for the mouse."""
        seen = viewport_of(context) if not bpy.app.background and context.window is not None else None
        if seen is None:
            raise HeadError("There is no 3D Viewport to edit landmarks in. Use facemime mend --pins instead.")
        line = takes_store.chosen(context.scene)
        self._edit = LandmarkEdit.current = LandmarkEdit(context.scene, line, seen.area.as_pointer())
        self._edit.look_at(free_box(seen.area, seen.region))
        self._edit.fit()
        self._mouse = np.zeros(2)
        context.workspace.status_text_set(
            _(
                "Drag: pin a landmark   X: release it   Left, Right: frame   Up, Down: frame with pins   N: next "
                "doubtful frame   Wheel, Middle Button, Home: view   Ctrl Z: undo   Enter: keep   Esc: discard"
            )
        )
        context.window_manager.modal_handler_add(self)
        redraw(context)
        redraw(context, "UI")
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Handle an event; one that is not for the editor is left to Blender."""
        if not self._look(context, event):
            self.cancel(context)
            return {"CANCELLED", "PASS_THROUGH"}
        edit = self._edit
        if edit.follow_scene(context.scene):
            redraw(context)
        if edit.held is not None or self._pans:
            self._drag(context, event)
        elif not edit.is_inside(self._mouse):
            return {"PASS_THROUGH"}
        elif event.type == "MOUSEMOVE":
            self._hover(context)
        elif event.value == "PRESS" and (event.type in _ENTER or event.type == "ESC"):
            return self._end(context, keep=event.type != "ESC")
        elif event.value == "PRESS" and not self._press(context, event):
            return {"PASS_THROUGH"}
        return {"RUNNING_MODAL"}

    def _look(self, context: bpy.types.Context, event: bpy.types.Event) -> bool:
        """Look where the viewport and the mouse are, and return whether editing goes on."""
        areas = () if context.screen is None or LandmarkEdit.current is not self._edit else context.screen.areas
        for area in areas:
            if area.as_pointer() == self._edit.area and area.type == "VIEW_3D":
                region = next(region for region in reversed(area.regions) if region.type == "WINDOW")
                self._edit.look_at(free_box(area, region))
                self._mouse = np.array([event.mouse_x - region.x, event.mouse_y - region.y], dtype=np.float64)
                return True
        return False

    def _hover(self, context: bpy.types.Context) -> None:
        under = self._edit.nearest(self._mouse, _REACH * context.preferences.system.ui_scale)
        if under != self._edit.under:
            self._edit.under = under
            redraw(context)

    def _press(self, context: bpy.types.Context, event: bpy.types.Event) -> bool:
        """Handle a key or a button, and return whether it means anything here."""
        edit, editor = self._edit, self._edit.editor
        if event.type == "LEFTMOUSE":
            self._hover(context)
            edit.held, self._moved = edit.under, False
        elif event.type == "MIDDLEMOUSE":
            self._pans = True
        elif event.type in _ZOOMS:
            edit.zoom(_ZOOMS[event.type], self._mouse)
        elif event.type == "HOME":
            edit.fit()
        elif event.type in _STEPS:
            editor.step(_STEPS[event.type] * (_JUMP if event.shift else 1))
            edit.show_in_scene(context.scene)
        elif event.type in _PINNED:
            editor.next_pinned(_PINNED[event.type])
            edit.show_in_scene(context.scene)
        elif event.type == "N":
            editor.next_doubtful()
            edit.show_in_scene(context.scene)
        elif event.type == "Z" and (event.ctrl or event.oskey):
            self._change(context, editor.redo() if event.shift else editor.undo())
        elif event.type in ("X", "DEL", "BACK_SPACE"):
            here = np.arange(N_LANDMARKS) if event.shift else np.array([-1 if edit.under is None else edit.under])
            self._change(context, editor.remove(here))
        else:
            return False
        redraw(context)
        return True

    def _drag(self, context: bpy.types.Context, event: bpy.types.Event) -> None:
        """Move the landmark that is held, or the view, until the button is released."""
        edit = self._edit
        if event.type == "MOUSEMOVE":
            if edit.held is None:
                edit.pan(np.array([event.mouse_x - event.mouse_prev_x, event.mouse_y - event.mouse_prev_y], float))
            else:
                self._pin(edit.held)
            redraw(context)
        elif event.value == "RELEASE" and event.type in ("LEFTMOUSE", "MIDDLEMOUSE"):
            edit.held, self._pans = None, False
            self._change(context, self._moved)
            self._moved = False

    def _pin(self, landmark: int) -> None:
        edit = self._edit
        if not self._moved:
            edit.editor.mark()
            self._moved = True
        x, y = edit.to_image(self._mouse).tolist()
        edit.editor.place(landmark, x, y)
        edit.changed()

    def _change(self, context: bpy.types.Context, changed: bool) -> None:
        """Save the pins, if they were changed."""
        if not changed:
            return
        self._edit.changed()
        try:
            self._edit.save(context.scene)
        except FacemimeError as error:
            report(self, str(error), "ERROR")
        redraw(context)

    def _end(self, context: bpy.types.Context, *, keep: bool) -> OperatorResult:
        editor = self._edit.editor
        changed = editor.changed
        if changed and not keep:
            editor.discard()
            self._change(context, True)
        self.cancel(context)
        return {"FINISHED"} if changed and keep else {"CANCELLED"}

    def cancel(self, context: bpy.types.Context) -> None:
        """Show the scene again."""
        self._edit.close()
        if context.workspace is not None:
            context.workspace.status_text_set(None)
        redraw(context)
        redraw(context, "UI")


class FACEMIME_OT_next_doubtful_frame(OnTake, bpy.types.Operator):
    """Go to the next of the frames of the selected take in which the tracker was least sure"""

    bl_idname = "facemime.next_doubtful_frame"
    bl_label = "Next Doubtful Frame"

    def work(self, context: bpy.types.Context) -> None:
        scene = context.scene
        take = takes_store.read(takes_store.chosen(scene), solved=False)
        places = [frame_at(scene, time) for time in take.times[doubtful_frames(take)].tolist()]
        if not places:
            report(self, "The tracker was sure of every frame of this take")
            return
        here = [number for number, place in enumerate(places) if abs(place - scene.frame_current_final) < 0.5]
        number = (here[0] + 1) % len(places) if here else 0
        go_to_frame(scene, places[number])
        report(self, "Doubtful frame {number} of {count}", number=number + 1, count=len(places))


class FACEMIME_OT_learn_from_pins(OnTake, bpy.types.Operator):
    """Let pins correct similar frames, too: in this take, in others, and live; click again to stop"""

    bl_idname = "facemime.learn_from_pins"
    bl_label = "Learn from Pins"

    def work(self, context: bpy.types.Context) -> None:
        scene = context.scene
        line = takes_store.chosen(scene)
        take = takes_store.read(line, solved=False)
        if learns_from_pins(take):
            write_pins(scene, line, with_learning(take, False))
            write_learnt(scene.facemime, ())
            report(self, "Pins correct only the frames around them")
            return
        if not pins_of(take):
            raise FacemimeError("This take has no pins. Use Edit Landmarks first.")
        if not (learnt := learn(take)):
            raise FacemimeError(
                "The pins do not predict each other, so similar frames would not become better. Pin the same part of "
                "the face in more frames."
            )
        write_pins(scene, line, with_learning(take, True))
        name = write_learnt(scene.facemime, learnt)
        report(self, "Similar frames are corrected, also live for {name}", name=name)
