"""One phase of stage 2 on a mesh of any kind: flips and sweeps in turn, from the worst cells on.

F_p is the sum over all cells of about m^-p, m a measure of their shape.  Flips and moves lower the
same sum, so neither undoes the work of the other.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from odt_plugins.engine.finish.phases import Phase
from odt_plugins.engine.topology.active import spread
from odt_plugins.engine.topology.star import Stars
from odt_plugins.mesh.arrays import BoolArray, ByteArray, FloatArray, IntArray


class Descending(Protocol):
    """A mesh under one phase: how tetrahedra, planar and curved triangles do each step of it.

    Attributes
    ----------
    gain : float    a vertex whose star gained less than this part of F_p wakes no neighbour
    """

    gain: float

    @property
    def points(self) -> FloatArray:
        """Coordinates (n, d), as they are now."""
        ...

    @property
    def cells(self) -> IntArray:
        """Cells (m, d + 1), or the slots of them, as they are now."""
        ...

    @property
    def status(self) -> ByteArray:
        """PENDING for every cell at which flips are to be tried, (m,)."""
        ...

    def worst(self) -> BoolArray:
        """Make the cells pending from which the phase starts; the vertices to move first, (n,)."""
        ...

    def flip(self, active: BoolArray) -> int:
        """Flip at the pending cells, which no longer are; returns the number of flips.

        Parameters
        ----------
        active : (n,) bool    vertices to move next; those of new cells may be added
        """
        ...

    def stars(self) -> Stars:
        """Stars of the vertices for the sweeps that follow the flips."""
        ...

    def sweep(self, stars: Stars, active: BoolArray, moved: FloatArray) -> int:
        """Move the active vertices once; returns the number of moves.

        Parameters
        ----------
        moved : (n,) float64    OUT: part of F_p that the star of each gained, 0 before
        """
        ...

    def settled(self, flips: int, woke: int) -> bool:
        """Whether nothing is left to do after a round of so many flips.

        Parameters
        ----------
        woke : int    vertices that woke their neighbours in the last sweep
        """
        ...


def finish_phase(mesh: Descending, phase: Phase) -> tuple[int, int]:
    """Lower F_p, in place, until nothing gains or the rounds of the phase are over.

    Returns
    -------
    flips, moves : int    edges that were flipped, moves of vertices
    """
    active = mesh.worst()
    moved = np.zeros(len(mesh.points))
    flips = moves = 0
    for _ in range(phase.rounds):
        flipped = mesh.flip(active) if phase.flips else 0
        flips += flipped
        stars = mesh.stars()
        woke = 0
        for _ in range(phase.sweeps):
            moved[:] = 0.0
            moves += mesh.sweep(stars, active, moved)
            woke = spread(
                mesh.cells, stars.indptr, stars.indices, moved, mesh.gain, active, mesh.status
            )
            if woke == 0:
                break
        if mesh.settled(flipped, woke):
            break
    return flips, moves
