"""The last stage of finishing: the few small dihedral angles that are left, and those alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from odt_plugins.engine.cells.extremes import Bounds
from odt_plugins.engine.finish.phases import Phase, polish
from odt_plugins.engine.finish.volume import guarded, reached
from odt_plugins.engine.policy import POLICY
from odt_plugins.engine.record.figures import COS_SMALL, cell_shapes
from odt_plugins.engine.record.memory import Memory
from odt_plugins.engine.topology.complex import Complex
from odt_plugins.engine.topology.part import Part, around, inside
from odt_plugins.mesh.arrays import BoolArray, IntArray
from odt_plugins.mesh.chunks import Pool
from odt_plugins.objectives import AIMS

Settle = Callable[[Complex, tuple[Phase, ...], Bounds], None]
"""Runs phases of the finishing stage on a complex within bounds."""


def polish_small_angles(
    mesh: Complex | Part, bounds: Bounds, memory: Memory, name: str, settle: Settle,
    pool: Pool | None, cut: BoolArray | None = None,
) -> None:
    """Look after the small angles alone that a mesh has left, of tetrahedra and for radius ratios.

    Only what lies around them is touched, within the bounds of the whole mesh; states that are
    better go to the memory, and ``mesh`` is of no further use.

    Parameters
    ----------
    mesh : Complex or Part     as it was offered last
    bounds : Bounds
    memory : Memory
    name : str                 of the new states
    settle : callable
    pool                       see ``threads.run_ranges``
    cut : (n,) bool, optional  vertices whose cells wait for another run
    """
    work = inside(mesh)
    if not memory.states or work.dim == 2 or not AIMS[memory.objective].by_ratios:
        return
    small = _small(work, cut, pool)
    passes = polish(len(small) / max(work.count(), 1))
    if not passes:
        return
    held = bounds.within(reached(work, pool))
    limits = {phase: guarded(work, phase, held, pool) for phases in passes for phase in phases}
    part: Complex | Part = mesh
    if work.skin is None:
        near = np.zeros(len(mesh.points), dtype=np.bool_)
        near[small] = True
        part = around(mesh, near, POLICY.polished_rings) or mesh
    more = work.count() / inside(part).count()
    for phases in passes:
        if not len(_small(inside(part), cut, pool)):
            break
        for phase in phases:
            share = min(1.0, more * phase.share)
            local = replace(phase, share=share, guard=None, least=None)
            settle(inside(part), (local,), limits[phase])
        memory.offer(part, name)


def _small(mesh: Complex, cut: BoolArray | None, pool: Pool | None) -> IntArray:
    """Cells (k, 4) with a small angle, but those at the cut."""
    cells, _ = mesh.mesh_arrays()
    small = cells[cell_shapes(mesh.points, cells, pool)[:, 1] > COS_SMALL]
    return small if cut is None else small[~cut[small].any(axis=1)]
