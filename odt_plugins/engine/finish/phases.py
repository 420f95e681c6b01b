"""The schedule of the finishing stage."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from odt_plugins.engine.cells.cost import Cost
from odt_plugins.engine.cells.measures import DIHEDRAL, MEASURES, QUALITY, STEP
from odt_plugins.engine.policy import POLICY
from odt_plugins.engine.record.figures import EXTREMES
from odt_plugins.objectives import AIMS, Objective


@dataclass(frozen=True)
class Phase:
    """One descent of F_p, the sum of all cells' costs.

    Attributes
    ----------
    power : float    exponent p
    share : float    part of the cells, worst first, that it starts from
    rounds : int     most rounds of flips and smoothing
    sweeps : int     sweeps of smoothing in a round
    compound : int   passes of compound moves over the same share: before of triangles, afterwards
                     of tetrahedra, where polyhedra around it are filled anew before and after
    objective : int  the cell measure in the cost, see ``measures``
    guard : float or None
        no new cell gets a worse radius ratio than this share of the cells has when the phase
        starts; None: than the input (d = 3)
    least : float or None
        no new cell gets a smaller angle, in degrees, unless one that it replaces has such an
        angle, or many cells (``POLICY.many_small_angles``) have; nor a smaller angle than all
        cells have when the phase starts; None: than the input (d = 3)
    enough : float
        of the cells whose measure reaches this only a tenth of the share is worked on, in the
        case of triangles by compound moves
    count : int
        so many cells, worst first, in the place of the share; 0: the share (d = 3)
    hold : float
        factor on the best extremes (least radius ratio, smallest angle, 180 degrees less the
        largest) of all starts of phases that hold; a new cell may not be worse than factor x best,
        or than the worst cell present; 0: extremes of the input (d = 3)
    fills : bool
        whether the compound moves come with polyhedra that are filled anew (d = 3)
    flips : bool
        whether edges are flipped in its rounds
    name : str
        what the phase is for; phases with one name serve one purpose
    """

    power: float
    share: float
    rounds: int
    sweeps: int
    compound: int = 0
    objective: int = QUALITY
    guard: float | None = None
    least: float | None = None
    enough: float = 1.0
    count: int = 0
    hold: float = 0.0
    fills: bool = True
    flips: bool = True
    name: str = ""

    @property
    def cost(self) -> Cost:
        """Cost of a cell."""
        return Cost(self.objective, self.power)


@dataclass(frozen=True)
class Descent:
    """Phases that lead to a result.

    Attributes
    ----------
    phases : tuple of Phase
    hold : float or None    no new cell may get a smaller angle than this share of the cells has
                            when the descent starts; None: than the input
    """

    phases: tuple[Phase, ...]
    hold: float | None = None


GOOD_TRIANGLE = 0.93
"""Measure of a triangle in the plane around which hardly a compound move pays."""

ANGLES = Phase(2.0, 0.01, 2, 3, 3, DIHEDRAL, guard=0.01, enough=0.33, name="angles")
"""For the smallest and largest angles, which radius ratios alone do not mind enough: those below
about 25 degrees, or above 150."""

EXTREME_CELLS = tuple(
    Phase(power, 0.0, 1, 3, 3, measure, count=count, hold=0.995, name="extremes")
    for count, power, measure in (
        (2, 4.0, DIHEDRAL), (2, 2.0, QUALITY), (15, 2.0, DIHEDRAL), (15, 2.0, QUALITY),
    )
)
"""For the worst cells of all, by their angles and by their radius ratio.

One cell often has all extremes: what one of them gives up, a two-hundredth at most, is what the
others gain by.
"""


def bulk(dim: int, objective: Objective = "radius_ratio") -> tuple[Phase, ...]:
    """Phases for the mean: every cell, a small p; by the measure of "amips" the sum of energies."""
    power, rounds, sweeps = (2.0, 20, 2) if dim == 2 else (0.5, 6, 3)
    measure, mean = QUALITY, AIMS[objective].mean
    if mean is not None:
        power, measure = mean[dim - 2], MEASURES[objective]
    return (Phase(power, 1.0, rounds, sweeps, objective=measure, name="bulk"),)


def tail(dim: int, objective: Objective = "radius_ratio") -> tuple[Phase, ...]:
    """Phases for the worst cells: fewer and fewer of them, a larger and larger p."""
    aim = AIMS[objective]
    enough, rows = (GOOD_TRIANGLE, aim.triangles) if dim == 2 else (1.0, aim.cells)
    return tuple(
        Phase(*row, MEASURES[objective], enough=enough, name=f"tail {k}")
        for k, row in enumerate(rows, 1)
    )


def worst_cells() -> tuple[Phase, ...]:
    """Phases for radius ratios in space: the tail, angles, the very worst cells, and the way back.

    What the extremes cost is won back while they hold, and no new small angle is made; at last what
    the tail costs, while the 1 % quantile holds.
    """
    first, *others = tail(3)
    back = Phase(0.5, 1.0, 1, 3, name="regain")
    last = replace(back, guard=0.01)
    held = (replace(phase, hold=1.0, least=POLICY.small_angle) for phase in (back, *others, last))
    return first, ANGLES, *EXTREME_CELLS, *held


def polish(share: float) -> tuple[tuple[Phase, ...], ...]:
    """Phases for small angles alone, and to win back around them what they cost; no extreme falls.

    Few small angles are polished once more, less gently: what they cost is no loss to the 1 %
    quantile.

    Parameters
    ----------
    share : part of the cells with an angle below ``POLICY.small_angle``
    """
    if not 0.0 < share <= POLICY.many_small_angles:
        return ()
    most = POLICY.polished
    gentle = Phase(2.0, min(share, most), 2, 3, 3, DIHEDRAL, guard=0.01, name="polish")
    after = Phase(4.0, 2.0 * min(8.0 * share, most), 2, 3, 3, least=POLICY.small_angle,
                  name="after polish")
    if share > 0.25 * most:
        return ((gentle, after),)
    return (gentle, after), (replace(gentle, power=4.0, guard=1e-3), after)


def repair(worse: Sequence[str], small_angles: float) -> tuple[tuple[Phase, ...], ...]:
    """Phases for a mesh of tetrahedra that is good but for what it lost against the input.

    Of a few cells beyond the input's extremes the first touches hardly more than those: the others
    cost the 1 % quantile. Of more small angles than the input has all are worked on, where they are
    few enough to decide (``POLICY.many_small_angles``).

    Parameters
    ----------
    worse : names of the figures that got worse
    small_angles : part of the cells with an angle below ``POLICY.small_angle``
    """
    if "share_below_20" in worse and set(worse) <= {"share_below_20", *EXTREMES}:
        share = min(small_angles, POLICY.many_small_angles)
        again = Phase(1.0, 1.0, 3, 3, guard=0.0, least=POLICY.small_angle, name="after repair")
        return tuple(
            (Phase(power, share, 2, 3, 3, DIHEDRAL, guard=guard, name="repair"), again)
            for power, guard in ((2.0, 0.01), (2.0, 1e-3), (4.0, 0.0))
        )
    if not worse or not set(worse) <= EXTREMES:
        return ()
    measure = QUALITY if "min_quality" in worse else DIHEDRAL
    measure = STEP if set(worse) == {"min_altitude"} else measure
    gentle = Phase(4.0, 0.0003, 1, 3, 0, measure, name="repair")
    rest = (
        replace(gentle, share=share, rounds=3, compound=3) for share in (0.003, 0.01, 0.03, 0.1)
    )
    return tuple((phase,) for phase in (gentle, *rest))


def cautious(dim: int, objective: Objective = "radius_ratio") -> tuple[Phase, ...]:
    """Phases for a mesh that the others spoil: the mean comes first, then worse and worse cells."""
    general = (
        Phase(0.25, 1.0, 6, 3, name="cautious"),
        Phase(0.5, 0.3, 2, 3, name="cautious"),
        Phase(1.0, 0.1, 2, 3, 1, name="cautious"),
        Phase(2.0, 0.05, 2, 3, 3, name="cautious"),
    )
    return general if AIMS[objective].by_ratios else general + tail(dim, objective)


WORST = Phase(4.0, 0.015, 2, 3, 3, fills=False, name="worst")
"""Targets the cells below the 1 % quantile, where the mean rose and that figure fell.

Nothing is refilled: for flat cells the cost is nearly constant, so that a refilling would give a
good cell and the quantile for less of it.
"""


def without_flips(phase: Phase) -> Phase:
    """The same on the cells that there are: neither flips nor compound moves."""
    return replace(phase, compound=0, flips=False)


def moves_alone(phase: Phase) -> Phase:
    """The same by moves of vertices alone, which make no new small angle.

    The number of cells holds then: of one cell less every bad one is a larger share.
    """
    return replace(without_flips(phase), least=POLICY.small_angle)


def descents(dim: int, objective: Objective = "radius_ratio") -> tuple[Descent, ...]:
    """What follows the bulk; the best of the results is taken.

    Angles and altitudes cost radius ratios: the last descent of "min_dihedral" wins back what it
    can of them while the worst angles hold, that of "time_step" around all cells it touched.
    """
    aim = AIMS[objective]
    if aim.by_ratios:
        return (Descent(tail(2) if dim == 2 else worst_cells()),)
    if aim.mean is not None:
        (back,) = bulk(dim, objective)
        back = replace(back, rounds=1, hold=1.0, guard=0.01, name="regain")
        return (Descent(tail(dim, objective) + (dim == 3) * (back,)),)
    hold = aim.by_angles
    general, own = Descent(tail(dim)), Descent(tail(dim, objective), hold=0.0 if hold else None)
    if dim == 2:
        return general, own
    return general, own, Descent(
        (Phase(2.0, 0.03, 2, 3, 3, name="regain"),), hold=0.01 if hold else None
    )
