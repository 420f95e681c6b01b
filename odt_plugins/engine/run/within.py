"""What a mesh that was cut from a larger one is told of it."""

from __future__ import annotations

import math
from collections.abc import Container
from typing import NamedTuple

from odt_plugins.engine.record.figures import Figures
from odt_plugins.mesh.arrays import BoolArray, IntArray
from odt_plugins.mesh.simplex import SimplexMesh


class Within(NamedTuple):
    """How a mesh lies within a larger one; by itself, it is the whole.

    Attributes
    ----------
    cut : (n,) bool or None       vertices of the cut that a later run may move: where the boundary
                                  does not slide, the worst cells are looked for away from them
    whole : Figures or None       of the larger mesh: its extremes are those that no cell may pass,
                                  and the promise is left to its judge
    without : container of str    phases of stage 2 that are left out, where the boundary does not
                                  slide
    share : float                 part of the allowed change of the volume that a boundary that
                                  slides may use, where none of it can be given back
    sized : SimplexMesh or None   one with the volumes that regions are to have where the boundary
                                  slides; those of the mesh itself unless given
    fresh : (n,) bool or None     vertices that no run has moved yet, when others were: stage 1
                                  works around these, where finishing follows and the boundary does
                                  not slide
    part : float                  what guards of phases, shares of the cells, are divided by, where
                                  the boundary does not slide: the worst cells of so much of the
                                  larger mesh are all here; less where cells at a cut are among them
    tail : float                  1 % quantile of the radius ratio below which vertices are added on
                                  request
    """

    cut: BoolArray | None = None
    whole: Figures | None = None
    without: Container[str] = frozenset()
    share: float = 1.0
    sized: SimplexMesh | None = None
    fresh: BoolArray | None = None
    part: float = 1.0
    tail: float = math.inf

    def numbered(self, vertices: IntArray) -> Within:
        """The same with ``vertices`` (k,) of these in their order; a cut without any is none."""
        cut = None if self.cut is None or not self.cut.any() else self.cut[vertices]
        return self._replace(cut=cut, fresh=None if self.fresh is None else self.fresh[vertices])


WHOLE = Within()
"""A mesh by itself."""
