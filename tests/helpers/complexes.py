"""Tetrahedral meshes as the kernels change them, and whether they are sound."""

from __future__ import annotations

import numpy as np
import pytest
import tet_meshes as tm

from odt_plugins.engine.cells.tetrahedron import (
    QUALITY,
)
from odt_plugins.engine.moves import compound
from odt_plugins.engine.moves.passes import measures
from odt_plugins.engine.topology.complex import make_complex

OPEN = np.array([0.0, 1.0, -1.0, 0.0, 1.0, -1.0])


def complex_of(points, cells, regions=None):
    n = len(points)
    rim = np.zeros(n, dtype=bool)
    labels = np.zeros(len(cells), dtype=np.int32) if regions is None else regions
    for facet, owners in tm.facets_of(cells).items():
        if len(owners) == 1 or labels[owners[0]] != labels[owners[1]]:
            rim[list(facet)] = True
    return make_complex(points.copy(), cells, labels, rim.copy(), rim)


def assert_sound(mesh, points, volume):
    cells, _ = mesh.mesh_arrays()
    volumes = tm.signed_volumes(points, cells)
    assert (volumes > 0).all()
    assert volumes.sum() == pytest.approx(volume, rel=1e-12)
    live = mesh.live()
    rank = np.full(len(mesh.cells) + 1, -1)
    rank[live] = np.arange(len(live))
    assert np.array_equal(rank[mesh.neighbors[live]], tm.brute_neighbors(cells))
    assert len(np.unique(mesh.free[: mesh.slots[1]])) == mesh.slots[1]
    assert mesh.slots[0] - mesh.slots[1] == len(live)


def contents(mesh):
    live = mesh.live()
    stack = mesh.free[: mesh.slots[1]]
    return [a.tobytes() for a in (mesh.points, mesh.cells[live], mesh.neighbors[live], live,
                                  mesh.regions[live], mesh.slots, stack)]


def run_pass(mesh, power=4.0, bounds=OPEN, tried=None, measure=QUALITY):
    order = np.argsort(measures(mesh, measure), kind="stable")[:60].astype(np.int32)
    mesh.status[:] = 0
    return compound.compound_pass(
        mesh.points, mesh.cells, mesh.neighbors, mesh.regions, mesh.locked, mesh.status, order,
        mesh.slots, mesh.free, measure, power, 10, bounds,
        np.zeros(len(mesh.cells), dtype=bool) if tried is None else tried)
