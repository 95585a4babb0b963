"""Mixins and helpers for operators: error reports, polling, file selection."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar, TypeAlias

import bpy
from bpy.props import BoolProperty, CollectionProperty, StringProperty

from ..blender.heads.family import character_in, heads_of, is_character
from ..blender.meshes import can_be_driven, is_head, object_of
from ..blender.messages import displayable
from ..blender.stubs import OperatorMixin, OperatorResult, ReportLevel
from ..core.errors import FacemimeError, Message, SourceError
from ..core.files.capture import check_readable, require_utf8_name
from ..sessions.session import Session


def report(operator: bpy.types.Operator, template: str, level: ReportLevel = "INFO", /, **values: Any) -> None:
    """Report a message, translated; `template` and `values` are those of `Message`."""
    operator.report({level}, displayable(Message(template, **values)))


@contextmanager
def reporting_range(operator: bpy.types.Operator, scene: bpy.types.Scene) -> Iterator[None]:
    """Report at the end if the frame range of a scene was changed."""
    before = scene.frame_start, scene.frame_end
    yield
    if before != (scene.frame_start, scene.frame_end):
        first, last = scene.frame_start, scene.frame_end
        report(
            operator,
            "The scene's frame range is now that of the take: frames {first} to {last}",
            first=first,
            last=last,
        )


Need: TypeAlias = Callable[[type[bpy.types.Operator], bpy.types.Context], bool]
"""Takes an operator and the context, and returns for `poll` whether a condition is met, as `require` does."""


class ReportsErrors(OperatorMixin):
    """Mixin: runs the operator's `work`, and reports a `FacemimeError` as an error; other exceptions are not caught.

    `work` returns None if the operator has finished, and otherwise its result, such as RUNNING_MODAL.
    """

    bl_options = {"REGISTER", "UNDO"}
    """Most operators change data of the file; those that do not leave out UNDO."""
    needs: ClassVar[tuple[Need, ...]] = ()
    """What `poll` requires, in this order."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Require what the operator needs."""
        return all(need(cls, context) for need in cls.needs)

    def work(self, context: bpy.types.Context) -> OperatorResult | None:
        """Do what the operator is for."""
        raise NotImplementedError

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Run `work`."""
        return self.reporting(self.work, context)

    def reporting(
        self, work: Callable[[bpy.types.Context], OperatorResult | None], context: bpy.types.Context
    ) -> OperatorResult:
        """Return the result of `work(context)`, or report the error that it raises and return CANCELLED.

        A result of None stands for FINISHED.
        """
        try:
            return work(context) or {"FINISHED"}
        except FacemimeError as error:
            report(self, str(error), "ERROR")
            return {"CANCELLED"}


def require(operator: type[bpy.types.Operator], met: bool, message: str) -> bool:
    """Return for `poll` whether a condition is met; otherwise set the poll message: in English, what to do first."""
    if not met:
        operator.poll_message_set(message)
    return met


def require_object_mode(operator: type[bpy.types.Operator], context: bpy.types.Context) -> bool:
    """Require Object Mode, as `require` does."""
    return require(operator, context.mode == "OBJECT", "Switch to Object Mode first")


def require_left_edit_mode(operator: type[bpy.types.Operator], context: bpy.types.Context) -> bool:
    """Require a mode other than Edit Mode, in which vertex groups cannot be written; as `require` does."""
    return require(operator, context.mode != "EDIT_MESH", "Leave Edit Mode first")


def require_no_session(operator: type[bpy.types.Operator], context: bpy.types.Context) -> bool:
    """Require that neither a puppet nor a take moves a head, as `require` does."""
    return require(operator, Session.running() is None, "A puppet is already running. Stop it first")


def heads_in(context: bpy.types.Context) -> list[bpy.types.Object]:
    """Return the heads to be driven: those to which the active object and then the other selected ones lead; otherwise
    the only head there is, unless a character without one is selected.
    """
    chosen = [obj for obj in (context.active_object, *context.selected_objects) if obj is not None]
    if heads := heads_of(chosen, context.view_layer.objects):
        return heads
    there = [obj for obj in context.view_layer.objects if can_be_driven(obj) and obj.visible_get()]
    return there if len(there) == 1 and not any(map(is_character, context.selected_objects)) else []


def subject(context: bpy.types.Context) -> bpy.types.Object | None:
    """Return the object that panels and operators on a head are about.

    That is the head to which the active object leads, or the active mesh; otherwise the only head there is.
    """
    obj = context.active_object
    if obj is not None and obj.type == "MESH" and (context.mode != "OBJECT" or can_be_driven(obj)):
        return obj
    if obj is not None and (heads := heads_of([obj], context.view_layer.objects)):
        return heads[0]
    if obj is not None and obj.type == "MESH":
        return obj
    return next(iter(heads_in(context)), obj)


def required_subject(context: bpy.types.Context) -> bpy.types.Object:
    """Return the object that `subject` finds. Raise a HeadError if there is none, which `poll` prevents."""
    return object_of(subject(context))


def require_heads(operator: type[bpy.types.Operator], context: bpy.types.Context) -> bool:
    """Require a head that can be driven, as `require` does."""
    return require(operator, bool(heads_in(context)), "Select a head, or add one in the Head panel")


class AsksForFile(ReportsErrors):
    """Mixin: asks for a file before it runs; the operator's `filter_glob` selects which files are shown."""

    filepath: StringProperty(name="File", subtype="FILE_PATH", options={"SKIP_SAVE"})

    @property
    def path(self) -> Path:
        """The selected file; SourceError if there is none, it must not be read, or its name is not valid."""
        return _selected(self.filepath)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Open the file browser."""
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}


def _selected(name: str) -> Path:
    path = Path(bpy.path.abspath(name))
    if not path.name or os.path.isdir(path):  # the file browser returns its folder if nothing is selected
        raise SourceError("No file was selected. Select one, or enter its name.")
    require_utf8_name(path)
    check_readable(path)
    return path


class AsksForFiles(AsksForFile):
    """Mixin: asks for one or several files of a folder."""

    files: CollectionProperty(type=bpy.types.OperatorFileListElement, options={"HIDDEN", "SKIP_SAVE"})
    directory: StringProperty(subtype="DIR_PATH", options={"HIDDEN", "SKIP_SAVE"})

    @property
    def paths(self) -> list[Path]:
        """The selected files; SourceError as for `path`."""
        names = [os.path.join(self.directory, file.name) for file in self.files if file.name]
        return [_selected(name) for name in names or [self.filepath]]


class AsksForFileToWrite(AsksForFile):
    """Mixin: asks for a file to write; the file browser warns before it replaces one."""

    bl_options = {"REGISTER"}
    check_existing: BoolProperty(default=True, options={"HIDDEN", "SKIP_SAVE"})

    def path_ending(self, suffix: str) -> Path:
        """Return the selected file, with `suffix` appended unless its name ends with it."""
        path = self.path
        return path if path.suffix.lower() == suffix else path.with_name(path.name + suffix)


def require_mesh(operator: type[bpy.types.Operator], context: bpy.types.Context) -> bool:
    """Require an active mesh, or an object that leads to a head, as `require` does."""
    obj = subject(context)
    return require(operator, obj is not None and obj.type == "MESH", "Select a head mesh")


class OnMesh(ReportsErrors):
    """Mixin: requires an active mesh, or an object that leads to a head: see `subject`."""

    needs: ClassVar[tuple[Need, ...]] = (require_mesh,)


def chosen_character(context: bpy.types.Context) -> bpy.types.Object | None:
    """Return the head to which the active object leads, an object of the character that is meant, or otherwise the
    active mesh, which the search refuses with its reason; None without any.
    """
    active = context.active_object
    heads = [] if active is None else heads_of([active], context.view_layer.objects)
    mesh = active if active is not None and active.type == "MESH" else None
    return heads[0] if heads else character_in(context) or mesh


def require_character(operator: type[bpy.types.Operator], context: bpy.types.Context) -> bool:
    """Require a character, of which any object may be selected, as `require` does."""
    return require(operator, chosen_character(context) is not None, "Select a character, or any object of it")


class OnCharacter(ReportsErrors):
    """Mixin: requires a character, of which any object may be selected: see `chosen_character`."""

    needs: ClassVar[tuple[Need, ...]] = (require_character,)


class OnHead(OnMesh):
    """Mixin: requires an active head outside Edit Mode, where vertex groups cannot be written.

    If `needs_landmarks` is false, a head that is bound only by its shape keys also counts.
    """

    needs_landmarks = True

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Require an active head outside Edit Mode."""
        bound = is_head if cls.needs_landmarks else can_be_driven
        return (
            super().poll(context)
            and require(cls, bound(required_subject(context)), "Find the face first, in the Head panel")
            and require_left_edit_mode(cls, context)
        )
