"""What a tetrahedron is worth: its share in the figures of a mesh, to the first order.

The mean of the radius ratio changes by (q - mean) / m when a cell comes, the 1 % quantile by what
crosses it over the density of q there, and the share of small angles by the cells that have one.
Sums of such shares over a few cells tell what a change there does to the score of the whole mesh.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from odt_plugins.engine.cells.extremes import Extremes
from odt_plugins.engine.cells.measures import cell_altitude, cell_extremes
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.topology.tets import Tets
from odt_plugins.mesh.arrays import FloatArray, IntArray


class Weights(NamedTuple):
    """What counts, in units of the radius ratio of one cell.

    Attributes
    ----------
    mean : float         radius ratio at which a further cell is worth nothing
    low, high : float    radius ratios between which the price of a poor cell falls to nothing
    tail : float         price of a poor cell
    depth : float        further price of a cell with the radius ratio 0; falls to nothing at low
    large : float        cosine of the angle below which an angle is small
    small : float        price of a cell with a small angle
    least : float        radius ratio of the very worst cells
    sharp : float        sine of the smallest or largest angle of the cells that are worst there
    height : float       least altitude below which cells are worst too; 0: altitudes do not count
    worst : float        a fifteenth of the further price of half of any of them
    """

    mean: float
    low: float
    high: float
    tail: float
    depth: float
    large: float
    small: float
    least: float
    sharp: float
    height: float
    worst: float


SOFT = 0.015
"""Cosines over which the price of a small angle falls to nothing."""


@kernel
def _excess(x: float, least: float) -> float:
    """How far x lies below least, more and more."""
    if x >= least:
        return 0.0
    ratio = least / max(x, 0.1 * least)
    ratio *= ratio
    return ratio * ratio - 1.0


@kernel
def worth_of(found: Extremes, weights: Weights) -> float:
    """Worth of a cell with these extremes, whatever its altitudes."""
    q, large, small = found.quality, found.large, found.small
    total = q - weights.mean
    if q < weights.high:
        total -= weights.tail * min((weights.high - q) / (weights.high - weights.low), 1.0)
        total -= weights.depth * max(1.0 - q / weights.low, 0.0)
    if large > weights.large - SOFT:
        total -= weights.small * min((large - weights.large + SOFT) / SOFT, 1.0)
    cosine = max(large, -small)
    sine = math.sqrt(max(1.0 - cosine * cosine, 0.0))
    return total - weights.worst * (_excess(q, weights.least) + _excess(sine, weights.sharp))


@kernel
def worth_of_cell(
    points: FloatArray, cells: IntArray, c: int, found: Extremes, weights: Weights
) -> float:
    """Worth of cell c, with the extremes that were found."""
    total = worth_of(found, weights)
    if weights.height > 0.0:
        altitude = cell_altitude(points, cells, c)
        total -= weights.worst * _excess(altitude, weights.height)
    return total


@kernel
def worth_of_cells(tets: Tets, weights: Weights, stop: int, worth: FloatArray) -> None:
    """Write the worth of every cell below ``stop``, 0 for a free slot."""
    for c in range(stop):
        worth[c] = 0.0
        if tets.cells[c, 0] >= 0:
            # as the numbers of cells are: for another type it would be compiled once more
            found = cell_extremes(tets.points, tets.cells, c)
            worth[c] = worth_of_cell(tets.points, tets.cells, c, found, weights)
