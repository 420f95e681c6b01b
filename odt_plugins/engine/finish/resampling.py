"""Stage 3, on request: vertices are added and removed where nothing else helps.

The paper minimises over meshes with at most N vertices (Section 2); here N may grow as asked.
`resampling` gives the passes of one round, `after_resampling` the phases that follow.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, replace

import numpy as np

from odt_plugins.engine.cells.cost import Cost
from odt_plugins.engine.cells.extremes import Bounds
from odt_plugins.engine.cells.measures import DIHEDRAL, NO_CELL, QUALITY, STEP
from odt_plugins.engine.compiled.threads import pieces
from odt_plugins.engine.finish.phases import Phase, tail
from odt_plugins.engine.moves import insertion
from odt_plugins.engine.moves.insertion import Step
from odt_plugins.engine.moves.passes import grow, measures
from odt_plugins.engine.moves.worth import Weights, worth_of_cells
from odt_plugins.engine.odt.rounds import Log
from odt_plugins.engine.policy import POLICY
from odt_plugins.engine.record.figures import COS_SMALL, Figures, cell_shapes, figures
from odt_plugins.engine.topology.complex import Complex, make_complex
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray, LongArray
from odt_plugins.mesh.numbering import most_vertices
from odt_plugins.mesh.quantiles import quantile
from odt_plugins.objectives import AIMS, Objective


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
    if AIMS[objective].by_angles:
        return ANGLES
    own = (ALTITUDES,) if AIMS[objective].by_altitude else ()
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
    height = few * float(shapes[:, 3].min()) if AIMS[objective].by_altitude else 0.0
    if reach > 0.0:
        least, sharp = 0.0, min(float(sine.min()) + reach, HIGHEST)
        worst = POLICY.insertion_angles
    return Weights(
        float(q.mean()), low, high, tail, POLICY.insertion_flat, COS_SMALL,
        POLICY.small_angle_price, least, sharp, height, worst,
    )


def after_resampling(objective: Objective = "radius_ratio") -> tuple[Phase, ...]:
    """Phases around the worst cells after a round of insertion: the mean, then the tail."""
    aim = AIMS[objective]
    general = (Phase(2.0, 0.1, 2, 3), Phase(4.0, 0.03, 2, 3, 1)) if aim.mean is None else ()
    own = () if aim.by_ratios else tail(3, objective)
    return (Phase(0.5, 0.1, 3, 3), *general, *own)


BATCH = 1 << 8
"""Cells after which a pass may end; the pieces in which a kernel sees them may be shorter."""


@dataclass(kw_only=True)
class SpareComplex(Complex):
    """A complex whose last points are free slots for new vertices.

    Attributes
    ----------
    first : (1,) int64     first free slot for a new vertex
    stays : (n,) bool      vertices that must not be removed, though they may move
    """

    first: LongArray
    stays: BoolArray


def with_spare_vertices(
    points: FloatArray, cells: IntArray, regions: IntArray, locked: BoolArray, boundary: BoolArray,
    stays: BoolArray, insert: bool | float,
) -> SpareComplex:
    """Build a complex with room for more vertices.

    Parameters
    ----------
    points : (n, 3) float64, cells : (m, 4) int32, regions : (m,) int32
    locked, boundary : (n,) bool       see ``Complex``
    stays : (n,) bool             vertices that must not be removed
    insert : bool or float        how many may come, see ``numbering.most_vertices``
    """
    n = len(points)
    spare = most_vertices(n, insert) - n
    mesh = make_complex(
        np.concatenate([points, np.zeros((spare, 3))]),
        cells,
        regions,
        np.concatenate([locked, np.ones(spare, dtype=bool)]),
        np.concatenate([boundary, np.zeros(spare, dtype=bool)]),
    )
    return SpareComplex(
        **vars(mesh),
        first=np.array([n], dtype=np.int64),
        stays=np.concatenate([stays, np.zeros(spare, dtype=bool)]),
    )


def resample(
    mesh: SpareComplex, step: Resampling, scale: Weights, bounds: Bounds, most: int
) -> tuple[int, int]:
    """Insert and remove vertices at the worst cells.

    Parameters
    ----------
    mesh : SpareComplex        changed in place
    step : Resampling
    scale : Weights            what cells are worth
    bounds : Bounds
    most : int                 operations that may be tried

    Returns
    -------
    taken, tried : int         operations that stayed, and that were tried
    """
    q = measures(mesh, step.order)
    count = 1 + int(min(step.share * (q < NO_CELL).sum(), most / step.looks))
    order = np.argsort(q, kind="stable")[:count].astype(np.int32)
    mesh.status[:] = 0
    ledger, done = make_ledger(mesh, scale), np.zeros(len(mesh.cells), dtype=bool)
    taken = seen = 0
    for stop in range(BATCH, len(order) + BATCH, BATCH):
        start, stayed = seen, taken
        while seen < min(stop, len(order)):
            first, last = next(pieces(seen, min(stop, len(order)), costly=True))
            found, looked_at = insertion.insertion_pass(
                mesh.tets, order[first:last], step.step, bounds, scale, ledger, done,
            )
            taken += int(found)
            seen += int(looked_at)
            if mesh.full:
                grow(mesh)
                more = len(mesh.cells) - len(done)
                ledger = ledger._replace(
                    worth=np.append(ledger.worth, np.zeros(more)),
                    marks=np.append(ledger.marks, np.zeros(more, np.int64)),
                )
                done = np.append(done, np.zeros(more, dtype=bool))
        if taken - stayed < POLICY.insertion_enough * (seen - start):
            break
    return taken, seen * step.looks


def make_ledger(mesh: SpareComplex, scale: Weights) -> insertion.Ledger:
    """What the cells are worth, before any is changed."""
    room = len(mesh.cells)
    worth = np.zeros(room)
    worth_of_cells(mesh.tets, scale, mesh.used, worth)
    return insertion.Ledger(
        mesh.first, mesh.stays, worth, np.zeros(room, np.int64), np.zeros(1, np.int64),
        np.empty(1 << 13, np.int64), np.empty(1 << 13),
    )


def resample_in_rounds(
    mesh: SpareComplex, before: Figures, objective: Objective, *,
    limits: Callable[[Figures], Bounds],
    settle: Callable[[Complex, tuple[Phase, ...], Bounds], None],
    offer: Callable[[Complex], bool], report: Callable[[float], None], log: Log,
) -> None:
    """Add and remove vertices, in rounds with finishing at the end of each.

    A phase stays if the mesh is a good one then, or the score rises. Where the round does not raise
    it, its phases are run again and make no small angle: few vertices gain less than those cost.

    Parameters
    ----------
    mesh : SpareComplex
    before : Figures            of this mesh
    objective : str             what finishing improves
    limits : callable           bounds that keep the extremes of some figures
    settle : callable           runs phases of finishing within bounds
    offer : callable            is shown the mesh after every step; says whether it is a good one
    report : callable           is told the share that is done
    log : Log
    """
    angles = AIMS[objective].by_angles
    share = POLICY.insertion_angles_effort if angles else POLICY.insertion_effort
    effort = POLICY.insertion_least_effort + int(share * mesh.count())
    for done in range(POLICY.insertion_rounds):
        report(done / POLICY.insertion_rounds)
        start = before.score
        taken = 0
        for step in resampling(objective):
            shapes = cell_shapes(mesh.points, mesh.mesh_arrays()[0])
            stayed, tried = resample(
                mesh, step, weights(shapes, objective, step.reach), limits(before),
                max(effort, 0),
            )
            taken += stayed
            effort -= tried
        if taken == 0:
            break
        resampled = mesh, _figures(mesh, objective), offer(mesh)
        for least in (None, POLICY.small_angle):
            mesh, before, good = resampled
            for phase in after_resampling(objective):
                settled = deepcopy(mesh)
                settle(settled, (replace(phase, least=least),), limits(before))
                now, also = _figures(settled, objective), offer(settled)
                if (also, now.score) > (good, before.score):
                    mesh, before, good = settled, now, also
            if before.score > start:
                break
        log.add("rounds of insertion", 1)
        if effort <= 0 or before.score - start < POLICY.insertion_worth:
            break
    report(1.0)


def _figures(mesh: Complex, objective: Objective) -> Figures:
    return figures(mesh.points, mesh.mesh_arrays()[0], objective)
