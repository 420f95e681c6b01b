"""Stage 3, on request: vertices are added and removed where nothing else helps.

The paper minimises over meshes with at most N vertices (Section 2); here N may grow by a tenth.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import numpy as np

from odt_plugins.engine.cells.extremes import Bounds
from odt_plugins.engine.compiled.threads import pieces
from odt_plugins.engine.finish.phases import Phase
from odt_plugins.engine.finish.resampling_schedule import (
    Resampling,
    after_resampling,
    resampling,
)
from odt_plugins.engine.moves import insertion
from odt_plugins.engine.moves.passes import NO_CELL, grow, measures
from odt_plugins.engine.odt.rounds import Log
from odt_plugins.engine.policy import POLICY
from odt_plugins.engine.record.figures import Figures, figures
from odt_plugins.engine.topology.complex import Complex, make_complex
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray, LongArray
from odt_plugins.mesh.numbering import most_vertices
from odt_plugins.options import Objective


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
    stays: BoolArray,
) -> SpareComplex:
    """Build a complex with room for a tenth more vertices.

    Parameters
    ----------
    points : (n, 3) float64, cells : (m, 4) int32, regions : (m,) int32
    locked, boundary : (n,) bool       see ``Complex``
    stays : (n,) bool             vertices that must not be removed
    """
    n = len(points)
    spare = most_vertices(n) - n
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
    mesh: SpareComplex, step: Resampling, scale: float, bounds: Bounds
) -> int:
    """Insert and remove vertices at the worst cells.

    Parameters
    ----------
    mesh : SpareComplex        changed in place
    step : Resampling
    scale : float              of the step's share
    bounds : Bounds

    Returns
    -------
    int                        operations that stayed
    """
    taken = 0
    tried = np.zeros(len(mesh.cells), dtype=bool)
    for _ in range(step.passes):
        tried = np.concatenate([tried, np.zeros(len(mesh.cells) - len(tried), dtype=bool)])
        q = measures(mesh, step.objective)
        count = 1 + int(scale * step.share * (q < NO_CELL).sum())
        q[tried[: len(q)]] = np.inf
        order = np.argsort(q, kind="stable")[:count].astype(np.int32)
        mesh.status[:] = 0
        for first, last in pieces(0, len(order), costly=True):
            taken += int(insertion.insertion_pass(
                mesh.tets, mesh.first, mesh.stays, order[first:last], step.cost,
                POLICY.quality_ring, bounds, tried,
            ))
        if mesh.full:
            grow(mesh)
    return taken


def resample_in_rounds(
    mesh: SpareComplex, before: Figures, objective: Objective, *,
    limits: Callable[[Figures], Bounds],
    settle: Callable[[Complex, tuple[Phase, ...], Bounds], None],
    offer: Callable[[Complex], Any], report: Callable[[float], None], log: Log,
) -> None:
    """Add and remove vertices, in rounds with finishing at the end of each.

    Nothing may pass the extremes ``before``.  A round that costs more than noise of their mean, or
    of their 1 % quantile for no gain in the score, is taken back, and the next one looks at fewer
    cells.

    Parameters
    ----------
    mesh : SpareComplex
    before : Figures            of this mesh
    objective : str             what finishing improves
    limits : callable           bounds that keep the extremes of some figures
    settle : callable           runs phases of finishing within bounds
    offer : callable            is shown the mesh after every round that stayed
    report : callable           is told the share that is done
    log : Log
    """
    noise = POLICY.insertion_noise + POLICY.insertion_noisy_cells / len(mesh.live())
    scale = 1.0
    for done in range(POLICY.insertion_rounds):
        report(done / POLICY.insertion_rounds)
        changed = deepcopy(mesh)
        for step in resampling(objective):
            resample(changed, step, scale, limits(before))
        settle(changed, after_resampling(objective), limits(_figures(changed, objective)))
        now = _figures(changed, objective)
        gains = now.score >= before.score
        if objective == "radius_ratio":
            gains |= before.p1_quality - now.p1_quality <= noise
            gains &= before.mean_quality - now.mean_quality <= noise
        if not gains:
            log.add("insertions taken back", 1)
            scale *= POLICY.insertion_less
            continue
        mesh = changed
        offer(mesh)
    report(1.0)


def _figures(mesh: Complex, objective: Objective) -> Figures:
    return figures(mesh.points, mesh.mesh_arrays()[0], objective)
