"""Runs inside Blender's window: evaluates what the tests ask for in a timer, between Blender's own events.

Each request is one line of JSON, {"code": text} or {"quit": status}; each answer one line with "value" or "error".
"""

import json
import os
import socket
import sys
import traceback

import bpy

_PERIOD = 0.002
_link = socket.socket(fileno=int(os.environ["FACEMIME_GUI_LINK"]))
_link.setblocking(False)
_received = bytearray()
_names = {"bpy": bpy}


def answer(code: str) -> dict:
    """Run statements in the window; the answer is what they assign to the name `value`."""
    _names.pop("value", None)
    try:
        with bpy.context.temp_override(window=bpy.context.window_manager.windows[0]):
            exec(code, _names)
        return {"value": _names.get("value")}
    except Exception:
        return {"error": traceback.format_exc()}


def tick() -> float:
    """Answer the requests since the last tick."""
    try:
        _received.extend(_link.recv(1 << 20))
    except BlockingIOError:
        return _PERIOD
    while (end := _received.find(b"\n")) >= 0:
        request = json.loads(_received[:end])
        del _received[: end + 1]
        if "quit" in request:
            sys.exit(request["quit"])
        _link.setblocking(True)
        _link.sendall(json.dumps(answer(request["code"]), default=repr).encode() + b"\n")
        _link.setblocking(False)
    return _PERIOD


preferences = bpy.context.preferences
preferences.view.show_splash = False
preferences.view.use_save_prompt = False
preferences.view.smooth_view = 0
preferences.view.filebrowser_display_type = "SCREEN"
preferences.system.viewport_aa = "OFF"
preferences.system.use_overlay_smooth_wire = False
bpy.app.timers.register(tick, persistent=True)
