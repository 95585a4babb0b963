"""What a running session shows: its status as text, and a preview of its source in the corner of the viewport, with the
landmarks coloured by confidence.

The worker has already drawn the landmarks into the preview; this module only uploads it to the graphics card.
"""

from __future__ import annotations

import bpy
import numpy as np

from ..blender.messages import displayable
from ..blender.messages import interface as _
from ..blender.stubs import Icon
from ..blender.viewports import free_box, viewport_drawn
from ..core.errors import messages
from ..core.streams.source import StreamSource
from ..core.tracking.result import is_hidden
from ..operators.preview_place import MARGIN, Box, has_preview, preview_box
from ..operators.puppet import running
from ..sessions.live import LiveSession
from ..sessions.tracking import TrackingSession
from .drawing import Picture, draw_lines, draw_plate, draw_text, draw_wrapped

_STAGES = messages(
    {
        "wait": "the source",
        "track": "tracking",
        "drive": "deformation",
        "hand over": "the viewport",
        "redraw": "the viewport",
        "write": "writing to the mesh",
    }
)
_GRIP_COLOUR = (1.0, 1.0, 1.0, 0.8)
_RED = (1.0, 0.25, 0.2, 1.0)


def draw_progress(layout: bpy.types.UILayout, session: TrackingSession) -> None:
    """Draw how far a whole video has been tracked, and a button that stops."""
    text = _("{done} of {total} frames").format(done=session.done, total=session.total)
    split = layout.split(factor=0.6, align=True)
    split.progress(factor=session.done / max(session.total, 1), text=text, translate=False)
    split.operator("facemime.stop_tracking", text="Stop", icon="SNAP_FACE", depress=True)


def countdown_text(session: LiveSession) -> str:
    """Return the seconds left in a countdown, or at its end what to do; "" without a countdown."""
    left = session.countdown
    if left is None:
        return ""
    if left > 0.0:
        return str(int(left) + 1)
    calibration = session.calibrating.current
    return _("Now") if calibration is not None and calibration.range_of else _("Hold Still")


def _hidden() -> str:
    return _("The mouth is covered and stays as it was")


def summary(session: LiveSession) -> tuple[str, Icon]:
    """Return the most important line about a session, and its icon: what is wrong, or otherwise how fast it is."""
    worker, latest = session.worker, session.shown
    if (error := worker.message or (worker.recording_error and str(worker.recording_error))) and error:
        return error, "ERROR"
    if latest is None:
        return displayable(worker.source.waiting), "TIME"
    if not latest.result.found:
        return _("No face in view"), "QUESTION"
    if worker.first.neutral is None:
        return _("Keep a relaxed face"), "TIME"
    if is_hidden(latest.result.landmark_confidence):
        return _hidden(), "HIDE_ON"
    if session.recorder.recording is not None:
        count, dropped = session.recorder.recording.frames, session.recorder.recording.dropped
        if dropped:
            return _("{count} frames recorded, {dropped} skipped").format(count=count, dropped=dropped), "REC"
        return _("{count} frames recorded").format(count=count), "REC"
    return session.stopwatch.text, "PREVIEW_RANGE"


def status_lines(session: LiveSession) -> list[tuple[str, Icon]]:
    """Return (text, icon) of each line: errors, then the delay, then the counts."""
    worker = session.worker
    lines: list[tuple[str, Icon]] = []
    if worker.message:
        lines.append((worker.message, "ERROR"))
    if worker.recording_error is not None:
        lines.append((str(worker.recording_error), "ERROR"))
    lines += _stream_lines(session)
    latest = session.shown
    if latest is None:
        return [*lines, (displayable(worker.source.waiting), "TIME")]
    if not latest.result.found:
        lines.append((_("No face in view"), "QUESTION"))
    elif worker.first.neutral is None:
        lines.append((_("Using the first second as the neutral face"), "TIME"))
    elif is_hidden(latest.result.landmark_confidence):
        lines.append((_hidden(), "HIDE_ON"))
    for person, heads in sorted(latest.people.items()):
        lines.append((_who_drives(session, _("Person {number}").format(number=person + 1), heads), "USER"))
    counts = worker.counts
    lines.append((session.stopwatch.text, "PREVIEW_RANGE"))
    if slowest := session.stopwatch.slowest():
        lines.append((_("Slowest step: {name}").format(name=_(_STAGES[slowest])), "BLANK1"))
    numbers = {"tracked": counts.tracked, "dropped": counts.dropped, "lost": counts.lost}
    lines.append((_("{tracked} tracked, {dropped} dropped, {lost} lost").format(**numbers), "BLANK1"))
    return lines


def _who_drives(session: LiveSession, sender: str, heads: tuple[int, ...]) -> str:
    """Return a sender and the heads that it drives, if there are several."""
    shown = session.heads
    names = [shown[head].obj.name for head in heads if head < len(shown) and not shown[head].gone]
    return f"{sender}: {', '.join(names)}" if len(shown) > 1 and names else sender


def received() -> StreamSource | None:
    """Return the stream that drives the running puppet; None if it is driven by something else."""
    session = running()
    source = None if session is None else session.worker.source
    return source if isinstance(source, StreamSource) else None


def _stream_lines(session: LiveSession) -> list[tuple[str, Icon]]:
    """Return the counts of packets received over the network, and of frames sent."""
    source, output = session.worker.source, session.worker.output
    lines: list[tuple[str, Icon]] = []
    if isinstance(source, StreamSource):
        counts = source.counts
        wrong = counts.malformed + counts.refused + counts.flooded
        numbers = {"received": counts.received, "wrong": wrong, "lost": counts.lost}
        lines.append((_("{received} packets, {wrong} refused, {lost} frames lost").format(**numbers), "URL"))
        lines += [(_who_drives(session, name, source.driven.get(name, ())), "USER") for name in source.senders]
    for sender in (output, session.displays.vertices):
        if sender is None:
            continue
        text = sender.message or _("{count} frames sent").format(count=sender.sent)
        lines.append((text, "ERROR" if sender.message else "EXPORT"))
    return lines


_picture = Picture()


def _draw() -> None:
    session = running()
    if session is None:
        _picture.clear()
        return
    context, latest, seen = bpy.context, session.shown, viewport_drawn(bpy.context)
    if seen is None or context.screen is None:
        return
    scale = context.preferences.system.ui_scale
    if latest is not None and latest.preview is not None and has_preview(context.screen, seen.region):
        height, width = latest.preview.shape[:2]
        box = preview_box(seen.area, seen.region, (height, width))
        _picture.draw(latest.number, latest.preview, box[:2], box[2:])
        _draw_grip(box, scale)
        draw_plate(session.stopwatch.text, (box.left, box.bottom + box.height + 6 * scale), 11 * scale)
    free = free_box(seen.area, seen.region)
    span = free.left, free.right
    _draw_countdown(span, seen.region.height, session, scale)
    if session.recorder.recording is not None:
        _draw_recording(span, free.top, session.recorder.recording.seconds, scale)


def _draw_grip(box: Box, scale: float) -> None:
    """Draw two strokes in the corner that resizes the preview."""
    corner = np.array([box.left + box.width, box.bottom + box.height]) - 3.0 * scale
    ends = [[corner - (reach * scale, 0.0), corner - (0.0, reach * scale)] for reach in (6.0, 11.0)]
    draw_lines(np.array(ends), _GRIP_COLOUR)


def _draw_countdown(span: tuple[float, float], height: float, session: LiveSession, scale: float) -> None:
    if not (text := countdown_text(session)):
        return
    middle = sum(span) / 2, height / 2 - 36 * scale
    draw_text(text, middle, 96 * scale, centred=True)
    width = span[1] - span[0] - 2 * MARGIN * scale
    draw_wrapped(_(session.task), (middle[0], middle[1] - 40 * scale), 18 * scale, width)


def _draw_recording(span: tuple[float, float], height: float, seconds: float, scale: float) -> None:
    text = f"REC {int(seconds) // 60:02d}:{seconds % 60:04.1f}"
    draw_text(text, (sum(span) / 2, height - 40 * scale), 20 * scale, _RED, centred=True)


def unregister() -> None:
    """Free the texture."""
    _picture.clear()


OVERLAYS = {_draw: "POST_PIXEL"}
