"""Values of a rig's controls for a motion, corrected by evaluating the rig."""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np

from ...core.numeric.arrays import FloatArray
from ...core.rigs.rig_map import RigMap
from ...core.rigs.solver import RigSolver
from ..rigs import read_rig
from .setting import held
from .view import FaceView

CORRECTIONS = 2
"""Evaluations of the rig by which each frame is corrected."""


@dataclass(frozen=True)
class ControlMotion:
    """Changes of the channels from rest, (N, C), and the largest distance of a sampled vertex from its target in each
    frame, (N,), in the unit of the mesh.
    """

    values: FloatArray
    errors: FloatArray


def solve_motion(head: bpy.types.Object, found: RigMap, wanted: FloatArray) -> ControlMotion:
    """Solve for displacements (N, S, 3) of the sampled vertices; afterwards every channel is what it was.

    The pointer shows the progress. Raises HeadError if a control is missing.
    """
    solver, view = RigSolver(found), FaceView(head, read_rig(head))
    values, errors = np.empty((len(wanted), len(found.channels))), np.empty(len(wanted))
    manager = bpy.context.window_manager
    manager.progress_begin(0.0, max(len(wanted), 1))
    try:
        with held(found.channels) as controls:
            controls.write(np.zeros(len(found.channels)))
            rest = view.look().face

            def evaluate(changes: FloatArray) -> FloatArray:
                controls.write(changes)
                return view.look().face - rest

            for row, target in enumerate(wanted):
                manager.progress_update(row)
                values[row], shown = solver.corrected(target, evaluate, CORRECTIONS)
                errors[row] = np.linalg.norm(shown - target, axis=1).max()
    finally:
        manager.progress_end()
        view.close()
    return ControlMotion(values, errors)
