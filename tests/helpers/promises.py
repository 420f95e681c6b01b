"""Meshes for whole runs, and the promise checked by code that shares nothing with the engine."""

from __future__ import annotations

import numpy as np
import planar_meshes as pm
import pytest
import tet_meshes as tm

from odt_plugins.mesh.simplex import SimplexMesh


def mesh_of(points, cells, regions=None, fixed=None, frozen=None):
    n, m = len(points), len(cells)
    return SimplexMesh(
        np.ascontiguousarray(points, dtype=np.float64),
        np.ascontiguousarray(cells, dtype=np.int32),
        np.zeros(m, dtype=np.int32) if regions is None else regions,
        np.zeros(n, dtype=bool) if fixed is None else fixed,
        np.zeros(m, dtype=bool) if frozen is None else frozen,
    )


def planar(seed=3, n=14):
    rng = np.random.default_rng(seed)
    points, cells = pm.jittered_grid(n, n, rng)[:2]
    return points, pm.oriented(points, cells)


def measure(points, cells):
    """min, 1 %, mean quality and extreme angles by code that shares nothing with the engine."""
    if cells.shape[1] == 3:
        q, angles = pm.shape(points, cells)
    else:
        q, angles = tm.quality(points, cells), tm.dihedral_angles(points, cells)
    return np.array([q.min(), np.quantile(q, 0.01), q.mean(), angles.min(), -angles.max()])


def facet_set(cells, regions):
    """Boundary and interface facets, vertices in rising order, with the label of every cell."""
    d = cells.shape[1] - 1
    facets = np.sort(np.concatenate([np.delete(cells, i, axis=1) for i in range(d + 1)]), axis=1)
    label = np.tile(regions, d + 1)
    key = np.ravel_multi_index(facets.T, (int(cells.max()) + 1,) * d)
    order = np.argsort(key, kind="stable")
    facets, label = facets[order], label[order]
    same = np.diff(key[order]) == 0
    inner = np.append(same & (label[1:] == label[:-1]), False)
    inner[1:] |= inner[:-1]
    return set(zip(map(tuple, facets[~inner].tolist()), label[~inner].tolist(), strict=True))


def volumes(points, cells):
    return pm.areas(points, cells) if cells.shape[1] == 3 else tm.signed_volumes(points, cells)


def assert_promise(mesh, outcome, keep=True):
    facets = facet_set(mesh.cells, mesh.regions)
    assert (volumes(outcome.points, outcome.cells) > 0).all()
    assert facet_set(outcome.cells, outcome.regions) == facets
    held = np.zeros(len(mesh.points), dtype=bool)
    held[[v for f, _ in facets for v in f]] = True
    held |= mesh.fixed
    assert outcome.points[held].tobytes() == mesh.points[held].tobytes()
    for label in np.unique(mesh.regions):
        assert volumes(outcome.points, outcome.cells[outcome.regions == label]).sum() == (
            pytest.approx(volumes(mesh.points, mesh.cells[mesh.regions == label]).sum(), rel=1e-9)
        )
    if keep:
        before, after = measure(mesh.points, mesh.cells), measure(outcome.points, outcome.cells)
        rounding = np.array([2e-15, 2e-15, 2e-15, 2e-13, 2e-13])
        assert (after >= before - 1e-7 * np.abs(before) - rounding).all(), (before, after)
