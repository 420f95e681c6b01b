"""Tetrahedral meshes as the kernels change them, and whether they are sound."""

from __future__ import annotations

import numpy as np
import pytest
import tet_meshes as tm

from odt_plugins.engine.cells.cost import Cost
from odt_plugins.engine.cells.extremes import FREELY, Bounds, Extremes
from odt_plugins.engine.cells.measures import QUALITY
from odt_plugins.engine.moves import compound
from odt_plugins.engine.moves.passes import measures
from odt_plugins.engine.topology.complex import make_complex
from odt_plugins.engine.topology.tets import FREE

OPEN = Bounds(FREELY, FREELY)


def extremes_of(points, cells):
    """Extremes of cells, by the twins."""
    angles = tm.dihedral_angles(points, cells)
    return Extremes(float(tm.quality(points, cells).min()),
                    float(np.cos(np.radians(angles.min()))),
                    float(np.cos(np.radians(angles.max()))))


def free_slots(mesh):
    return mesh.free[: mesh.slots[FREE]]


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
    assert len(np.unique(free_slots(mesh))) == len(free_slots(mesh))
    assert mesh.count() == len(live)


def contents(mesh):
    live = mesh.live()
    return [a.tobytes() for a in (mesh.points, mesh.cells[live], mesh.neighbors[live], live,
                                  mesh.regions[live], mesh.slots, free_slots(mesh))]


def run_pass(mesh, power=4.0, bounds=OPEN, tried=None, measure=QUALITY):
    order = np.argsort(measures(mesh, measure), kind="stable")[:60].astype(np.int32)
    mesh.status[:] = 0
    return compound.compound_pass(
        mesh.tets, order, Cost(measure, power), 10, bounds,
        np.zeros(len(mesh.cells), dtype=bool) if tried is None else tried)
