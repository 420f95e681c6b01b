"""The input of a run as the engine works on it, and the way back to the caller's numbering."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from odt_plugins.engine.record.memory import State
from odt_plugins.engine.run.outcome import Outcome
from odt_plugins.engine.topology.frame import Frame, make_frame
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.mesh.numbering import new_numbers
from odt_plugins.mesh.simplex import SimplexMesh


@dataclass(frozen=True)
class Start:
    """The input without its frozen cells, in inner numbering and coordinates.

    Attributes
    ----------
    mesh : SimplexMesh              as the caller gave it
    frame : Frame
    points : (k, D) float64
    cells : (m1, d + 1) int32, regions : (m1,) int32
    """

    mesh: SimplexMesh
    frame: Frame
    points: FloatArray
    cells: IntArray
    regions: IntArray

    def pairs(self, edges: IntArray) -> IntArray:
        """Inner numbers of the caller's edges (q, 2); without those that are not inside."""
        number = np.full(len(self.mesh.points), -1, dtype=np.int32)
        number[self.frame.vertices] = np.arange(len(self.points), dtype=np.int32)
        inner = number[edges]
        return inner[(inner >= 0).all(axis=1)]

    def placed(self, state: State) -> Outcome:
        """A state in the caller's numbering, with the frozen cells.

        A vertex that did not move keeps its bits. Vertices keep their index, or their order when
        some have gone; new ones stand at the end.
        """
        mesh, frame = self.mesh, self.frame
        points = mesh.points.copy()
        n = len(self.points)
        moved = (state.points[:n] != self.points).any(axis=1)
        points[frame.vertices[moved]] = frame.outside(state.points[:n][moved])
        regions = np.concatenate([mesh.regions[mesh.frozen], state.regions])
        used = np.zeros(len(state.points), dtype=np.bool_)
        used[state.cells] = True
        new = n + np.flatnonzero(used[n:])
        if used[:n].all() and not len(new):
            cells = np.concatenate([mesh.cells[mesh.frozen], frame.vertices[state.cells]])
            return Outcome(points, np.ascontiguousarray(cells), regions)
        left = np.ones(len(points), dtype=np.bool_)
        left[frame.vertices[~used[:n]]] = False
        kept = np.flatnonzero(left)
        origin = np.concatenate([kept, np.full(len(new), -1, dtype=np.int64)])
        outer = new_numbers(origin, len(points))
        inner = np.full(len(state.points), -1, dtype=np.int32)
        inner[:n] = outer[frame.vertices]
        inner[new] = len(kept) + np.arange(len(new))
        cells = np.concatenate([outer[mesh.cells[mesh.frozen]], inner[state.cells]])
        points = np.concatenate([points[kept], frame.outside(state.points[new])])
        return Outcome(points, np.ascontiguousarray(cells), regions, origin=origin)


def make_start(mesh: SimplexMesh) -> Start:
    """Number the cells that may change along a curve, and scale them."""
    frame, cells = make_frame(mesh)
    return Start(
        mesh, frame, frame.inside(mesh.points[frame.vertices]), cells,
        np.ascontiguousarray(mesh.regions[frame.active]),
    )
