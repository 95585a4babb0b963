"""Remedies that name buttons of the window, as a reader of the terminal can follow them."""

from __future__ import annotations

_MARKS = "--mark 36=VERTEX or --mark 36=X,Y,Z, in Blender's coordinates"
REMEDIES = {
    "Mark the corners of eyes and mouth, nose and chin.": (
        f"Give at least four points with bind: {_MARKS}; facemime bind --help lists them."
    ),
    "Mark the corners of the eyes, and find the face again.": f"Give the corners of the eyes with bind: {_MARKS}.",
    "Mark eyes, nose and mouth.": "Use eyes, nose and mouth.",
    "Mark it again.": "Correct --mark.",
    "Choose its file under Key.": "Give its file with --key; facemime receive --new-key FILE makes one.",
    "Choose protocol ": "Choose --protocol ",
    "Choose one of these senders.": "Choose one of these with --sender.",
    "listen on 0.0.0.0": "use --listen 0.0.0.0",
    "Mark them again; left and right are the head's own.": "Correct --mark; left and right are the head's own.",
    "Use Open Lips, which cuts the mesh between them, or model a slit.": (
        "Use bind with --cut-open, which cuts the mesh between them, or model a slit."
    ),
    "Use Open Eyes, which cuts the mesh along the lids, or model separate eyes.": (
        "Use bind with --cut-open, which cuts the mesh along the lids, or model separate eyes."
    ),
    "Use Find Face instead.": "Use bind instead.",
    "Find its face instead, or add such keys.": "Use bind instead, or add such keys.",
    "Find its face in Head > Your Own Head, or use the built-in head.": "Use bind, or the built-in head.",
    "Delete them in Edit Mode, where they are selected, and find the face again.": (
        "Delete them in Blender, and run bind again."
    ),
    "Set these parts to Skin, or find the face again.": "Run bind again, or set these parts to Skin in Blender.",
    "Paint their regions over them, or find the face again.": "Paint their regions over them in Blender.",
    "or use Reset Regions.": "or use Reset Regions, in Blender.",
    "and find the face again.": "and run bind again.",
    "or find the face again.": "or run bind again.",
    "Find the face again.": "Run bind again.",
}
"""Remedies of the terminal by those of the window; of two that fit, the first one."""


def for_terminal(message: str) -> str:
    """Return a message with remedies that do not need a window."""
    for window, terminal in REMEDIES.items():
        message = message.replace(window, terminal)
    return message
