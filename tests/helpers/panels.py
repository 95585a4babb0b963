"""Panels drawn without a window."""

from types import SimpleNamespace

import bpy


class Layout:
    """Substitute for a layout: records every call and returns itself."""

    def __init__(self):
        self.calls = []

    def __getattr__(self, name):
        def call(*arguments, **options):
            self.calls.append((name, *arguments, *options.values()))
            return self

        return call

    def texts(self) -> str:
        """Return everything that was drawn as text."""
        return " ".join(str(part) for call in self.calls for part in call)


def draw(panel: type) -> str:
    """Return what `panel` draws in the current context."""
    layout = Layout()
    panel.draw(SimpleNamespace(layout=layout), bpy.context)
    return layout.texts()
