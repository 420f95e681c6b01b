"""The boundary of a tetrahedral mesh that slides, as it travels through the kernels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from odt_plugins.engine.ground.closest import Ground
from odt_plugins.engine.ground.lines import Lines
from odt_plugins.engine.ground.sheet import LOCKED, Limits, Sheet
from odt_plugins.engine.policy import POLICY
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray


class Skin(NamedTuple):
    """The boundary of a tetrahedral mesh, on its way over the input surface.

    Attributes
    ----------
    sheet : Sheet           shares its points with the mesh
    ground : Ground, lines : Lines, limits : Limits
    stays : (e,) bool       edges of the sheet that are not flipped
    volume : (n + 1, 2) float64
        [change of the volume so far, largest change] of the mesh, then for every vertex
        [change so far, part of the largest change that is its own]
    most : float            the largest change at the end
    fan : (n,) int32        a triangle of the sheet around every vertex, -1 inside; kept up to date
    """

    sheet: Sheet
    ground: Ground
    lines: Lines
    limits: Limits
    stays: BoolArray
    volume: FloatArray
    most: float
    fan: IntArray

    @property
    def movable(self) -> BoolArray:
        """Vertices (n,) that may slide."""
        return np.asarray(self.sheet.kind != LOCKED)

    def allow(self, everything: bool) -> None:
        """Set the largest change of the volume: all of it, or all but the reserve."""
        self.volume[0, 1] = self.most if everything else (1.0 - POLICY.slide_reserve) * self.most
