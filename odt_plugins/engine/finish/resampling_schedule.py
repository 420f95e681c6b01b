"""The schedule of insertion: passes of one round, and the phases that follow it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from odt_plugins.engine.cells.tetrahedron import DIHEDRAL, QUALITY, STEP, Cost
from odt_plugins.engine.finish.phases import Phase, tail
from odt_plugins.engine.moves.insertion import Step
from odt_plugins.engine.moves.worth import Weights
from odt_plugins.engine.policy import POLICY
from odt_plugins.engine.record.figures import COS_SMALL
from odt_plugins.mesh.arrays import FloatArray
from odt_plugins.mesh.quantiles import quantile
from odt_plugins.options import Objective


@dataclass(frozen=True)
class Resampling:
    """One pass of insertion and removal, see :mod:`odt_plugins.engine.moves.insertion`.

    Attributes
    ----------
    power : float     exponent p of the sum of costs that falls around a change
    share : float     part of the cells, worst first, that the pass looks at
    looks : int       operations at a cell that are tried
    objective : int   the cell measure in the cost
    order : int       the cell measure by which cells are the worst
    price : float     worth that a new vertex must gain
    best : bool       whether the best operation at a cell is taken, else the first that pays
    reach : float     sine above the least one up to which angles outweigh all else; 0: as usual
    """

    power: float
    share: float
    looks: int
    objective: int = QUALITY
    order: int = QUALITY
    price: float = 0.5
    best: bool = False
    reach: float = 0.0

    @property
    def step(self) -> Step:
        """The same as a kernel takes it."""
        return Step(Cost(self.objective, self.power), POLICY.quality_ring, self.looks,
                    not self.best, self.price, 0.1 * self.price)


ANGLES = tuple(
    Resampling(power, share, 15, DIHEDRAL, DIHEDRAL, reach=0.2)
    for power, share in ((4.0, 0.03), (2.0, 0.01))
)
"""For the smallest and largest angles, whatever they cost."""

ALTITUDES = Resampling(16.0, 0.003, 15, STEP, STEP, best=True)
"""For the least altitudes."""


def resampling(objective: Objective = "radius_ratio") -> tuple[Resampling, ...]:
    """Passes of one round of insertion: for the mean, the quality, the angles."""
    if objective == "min_dihedral":
        return ANGLES
    own = (ALTITUDES,) if objective == "time_step" else ()
    return (
        *own,
        Resampling(2.0, 0.5, 2, price=1.0),
        Resampling(2.0, 0.15, 7),
        Resampling(4.0, 0.001, 15, best=True),
        Resampling(2.0, 0.001, 15, order=DIHEDRAL, best=True),
        Resampling(4.0, 0.001, 15, DIHEDRAL, DIHEDRAL, best=True),
    )


HIGHEST = 0.9
"""Sine beyond which no angle is among the worst; that of the regular cell is .943."""


def weights(
    shapes: FloatArray, objective: Objective = "radius_ratio", reach: float = 0.0
) -> Weights:
    """What cells are worth in a mesh with these :func:`figures.cell_shapes`."""
    q = shapes[:, 0]
    sine = np.sqrt(np.maximum(1.0 - np.abs(shapes[:, 1:3]).max(axis=1) ** 2, 0.0))
    shares = POLICY.insertion_p1
    low, high = (quantile(q, share) for share in shares)
    high = max(high, low + 0.01)
    tail = min(POLICY.score_p1 * (high - low) / (shares[1] - shares[0]), POLICY.insertion_tail)
    few, worst = POLICY.insertion_few, POLICY.insertion_worst
    least, sharp = few * float(q.min()), few * float(sine.min())
    height = few * float(shapes[:, 3].min()) if objective == "time_step" else 0.0
    if reach > 0.0:
        least, sharp = 0.0, min(float(sine.min()) + reach, HIGHEST)
        worst = POLICY.insertion_angles
    return Weights(
        float(q.mean()), low, high, tail, POLICY.insertion_flat, COS_SMALL,
        POLICY.small_angle_price, least, sharp, height, worst,
    )


def after_resampling(objective: Objective = "radius_ratio") -> tuple[Phase, ...]:
    """Phases around the worst cells after a round of insertion: the mean, then the tail."""
    general = () if objective == "amips" else (Phase(2.0, 0.1, 2, 3), Phase(4.0, 0.03, 2, 3, 1))
    own = () if objective == "radius_ratio" else tail(3, objective)
    return (Phase(0.5, 0.1, 3, 3), *general, *own)
