"""The schedule of insertion: passes of one round, and the phases that follow it."""

from __future__ import annotations

from dataclasses import dataclass

from odt_plugins.engine.cells.tetrahedron import DIHEDRAL, MEAN_RATIO, QUALITY, Cost
from odt_plugins.engine.finish.phases import Phase, tail
from odt_plugins.options import Objective


@dataclass(frozen=True)
class Resampling:
    """Passes of insertion and removal of vertices, see :mod:`odt_plugins.engine.moves.insertion`.

    Attributes
    ----------
    power : float     exponent p of the sum of costs that must fall
    share : float     part of the cells, worst first, that a pass looks at
    passes : int
    objective : int   the cell measure in the cost
    """

    power: float
    share: float
    passes: int
    objective: int = QUALITY

    @property
    def cost(self) -> Cost:
        """Cost of a cell."""
        return Cost(self.objective, self.power)


def resampling(objective: Objective = "radius_ratio") -> tuple[Resampling, ...]:
    """Passes of one round of insertion: for the quality, then for the very smallest angles."""
    return (
        Resampling(4.0, 0.02, 2, MEAN_RATIO if objective == "amips" else QUALITY),
        Resampling(4.0, 0.003 if objective == "min_dihedral" else 0.001, 2, DIHEDRAL),
    )


def after_resampling(objective: Objective = "radius_ratio") -> tuple[Phase, ...]:
    """Phases around the worst cells after a round of insertion: the mean, then the tail."""
    general = () if objective == "amips" else tail(3)
    own = () if objective == "radius_ratio" else tail(3, objective)
    return (Phase(0.5, 0.05, 3, 3), *general, *own)
