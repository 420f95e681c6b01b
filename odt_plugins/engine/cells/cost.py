"""What a cell costs: its ODT energy, or a power of its measure."""

from __future__ import annotations

import math
from typing import NamedTuple

from odt_plugins.engine.compiled.kernel import kernel

ENERGY = 0
"""In the place of a measure: the ODT energy."""


class Cost(NamedTuple):
    """What a cell costs.

    Attributes
    ----------
    objective : int    ENERGY, or the measure m in the cost; a number of ``measures``
    power : float      exponent p of that cost; without meaning for the energy
    """

    objective: int
    power: float


@kernel
def is_energy(objective: int) -> bool:
    """Whether cells cost their ODT energy, which has no power and no least value but 0."""
    return objective == ENERGY


@kernel
def least_cost(objective: int) -> float:
    """Cost below which no cell is."""
    return 0.0 if is_energy(objective) else 1.0


SHIFT = 0.005
"""Cells much flatter than this are no longer worth their neighbours: the cost levels off there."""


@kernel
def quality_cost(q: float, power: float) -> float:
    """Cost ((1 + s)/(q + s))^power of a cell with the measure q, s = SHIFT; 1 for the best.

    The powers in use need no general power function.
    """
    q = (q + SHIFT) / (1.0 + SHIFT)
    if power == 0.5:
        return 1.0 / math.sqrt(q)
    if power == 1.0:
        return 1.0 / q
    square = 1.0 / (q * q)
    if power == 2.0:
        return square
    if power == 4.0:
        return square * square
    if power == 8.0:
        square *= square
        return square * square
    return q**-power
