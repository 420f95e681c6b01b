"""The schedule of the finishing stage."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from odt_plugins.engine.tetrahedron import DIHEDRAL, QUALITY


@dataclass(frozen=True)
class Phase:
    """One descent of F_p, the sum of all cells' costs.

    Attributes
    ----------
    power : float    exponent p
    share : float    part of the cells, worst first, that it starts from
    rounds : int     most rounds of flips and smoothing
    sweeps : int     sweeps of smoothing in a round
    compound : int   passes of compound moves over the same share afterwards (d = 3)
    objective : int  the cell measure in the cost, see ``tetrahedron.tet_cost``
    """

    power: float
    share: float
    rounds: int
    sweeps: int
    compound: int = 0
    objective: int = QUALITY


def bulk(dim: int) -> tuple[Phase, ...]:
    """Phases for the mean: every cell, a small p."""
    return (Phase(2.0, 1.0, 20, 2),) if dim == 2 else (Phase(0.5, 1.0, 6, 3),)


def repair(worse: Sequence[str]) -> tuple[Phase, ...]:
    """Phases for a mesh of tetrahedra that is good but for a few cells beyond the input's extremes.

    Parameters
    ----------
    worse : names of the figures that got worse
    """
    if not worse or not set(worse) <= {"min_quality", "min_angle", "max_angle"}:
        return ()
    measure = QUALITY if "min_quality" in worse else DIHEDRAL
    return tuple(Phase(4.0, share, 3, 3, 3, measure) for share in (0.003, 0.01, 0.03, 0.1))


def cautious() -> tuple[Phase, ...]:
    """Phases for a mesh that the others spoil: the mean comes first, then worse and worse cells."""
    return (
        Phase(0.25, 1.0, 6, 3),
        Phase(0.5, 0.3, 2, 3),
        Phase(1.0, 0.1, 2, 3, 1),
        Phase(2.0, 0.05, 2, 3, 3),
    )


def tail(dim: int) -> tuple[Phase, ...]:
    """Phases for the worst cells: fewer and fewer of them, a larger and larger p."""
    if dim == 2:
        return (Phase(4.0, 0.05, 10, 2), Phase(8.0, 0.01, 10, 2), Phase(16.0, 0.003, 10, 2))
    return (Phase(2.0, 0.1, 2, 3), Phase(4.0, 0.03, 2, 3, 3), Phase(8.0, 0.002, 2, 3))
