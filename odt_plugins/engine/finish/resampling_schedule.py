"""The schedule of insertion: passes of one round, and the phases that follow it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from odt_plugins.engine.cells.tetrahedron import DIHEDRAL, QUALITY, Cost
from odt_plugins.engine.finish.phases import Phase, tail
from odt_plugins.engine.moves.insertion import Step
from odt_plugins.engine.moves.worth import Weights
from odt_plugins.engine.policy import POLICY
from odt_plugins.engine.record.figures import COS_SMALL
from odt_plugins.mesh.arrays import FloatArray
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
    """

    power: float
    share: float
    looks: int
    objective: int = QUALITY
    order: int = QUALITY
    price: float = 0.5
    best: bool = False

    @property
    def step(self) -> Step:
        """The same as a kernel takes it."""
        return Step(Cost(self.objective, self.power), POLICY.quality_ring, self.looks,
                    not self.best, self.price, 0.1 * self.price)


def resampling(objective: Objective = "radius_ratio") -> tuple[Resampling, ...]:
    """Passes of one round of insertion: for the mean, the quality, the very smallest angles."""
    if objective == "min_dihedral":
        return (
            Resampling(2.0, 0.05, 7, order=DIHEDRAL, price=1.0),
            Resampling(4.0, 0.02, 7, DIHEDRAL, DIHEDRAL, 1.0),
            Resampling(2.0, 0.003, 15, order=DIHEDRAL, best=True),
            Resampling(4.0, 0.003, 15, DIHEDRAL, DIHEDRAL, best=True),
        )
    return (
        Resampling(2.0, 0.5, 2, price=1.0),
        Resampling(2.0, 0.15, 7),
        Resampling(4.0, 0.001, 15, best=True),
        Resampling(2.0, 0.001, 15, order=DIHEDRAL, best=True),
        Resampling(4.0, 0.001, 15, DIHEDRAL, DIHEDRAL, best=True),
    )


def weights(shapes: FloatArray, objective: Objective = "radius_ratio") -> Weights:
    """What cells are worth in a mesh with these :func:`figures.cell_shapes`."""
    q = shapes[:, 0]
    sine = np.sqrt(np.maximum(1.0 - np.abs(shapes[:, 1:]).max(axis=1) ** 2, 0.0))
    shares = POLICY.insertion_p1
    low, high = (float(x) for x in np.quantile(q, shares))
    high = max(high, low + 0.01)
    tail = min(POLICY.score_p1 * (high - low) / (shares[1] - shares[0]), POLICY.insertion_tail)
    few = POLICY.insertion_few
    sharp = few * float(sine.min())
    if objective == "min_dihedral":
        sharp = max(sharp, float(np.quantile(sine, POLICY.insertion_sines)))
    return Weights(
        float(q.mean()), low, high, tail, POLICY.insertion_flat, COS_SMALL,
        POLICY.small_angle_price, few * float(q.min()), sharp, POLICY.insertion_worst,
    )


def after_resampling(objective: Objective = "radius_ratio") -> tuple[Phase, ...]:
    """Phases around the worst cells after a round of insertion: the mean, then the tail."""
    general = () if objective == "amips" else (Phase(2.0, 0.1, 2, 3), Phase(4.0, 0.03, 2, 3, 1))
    own = () if objective == "radius_ratio" else tail(3, objective)
    return (Phase(0.5, 0.1, 3, 3), *general, *own)
