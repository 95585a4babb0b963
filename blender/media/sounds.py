"""Short sounds for performers, who look at the camera rather than at the screen."""

from __future__ import annotations

from typing import Any

_PITCH = 880.0
"""Frequency in hertz."""
_SECONDS = 0.2
_FADE = 0.05
"""Seconds of the fade at the end."""
_VOLUME = 0.3


class _Output:
    """The audio device, which is opened once, and the sound that is played."""

    device: Any = None
    playing: Any = None


def beep() -> bool:
    """Play a short tone, and return whether there is an audio device for it."""
    try:
        import aud
    except ImportError:  # Blender was built without it, as some of Debian's are
        return False
    try:
        _Output.device = _Output.device or aud.Device()
        tone = aud.Sound.sine(_PITCH).limit(0.0, _SECONDS).fadeout(_SECONDS - _FADE, _FADE).volume(_VOLUME)
        _Output.playing = _Output.device.play(tone)
    except aud.error:  # type: ignore[misc]  # it is an exception
        return False
    return True
