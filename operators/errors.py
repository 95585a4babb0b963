"""How operators tell users of errors."""

from collections.abc import Callable

import bpy

from ..core.errors import FacemimeError


class ReportsErrors:
    """Mixin: turns the errors that users can cause into a report and CANCELLED; the rest go up with a traceback."""

    def reporting(self, work: Callable[[bpy.types.Context], set[str]], context: bpy.types.Context) -> set[str]:
        """Return what `work` returns, or CANCELLED after a report."""
        try:
            return work(context)
        except FacemimeError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
