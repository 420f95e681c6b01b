"""Sizes for a mesh that was untangled: of cells that stayed, of facets, harmonic between."""

from dataclasses import replace

import contract
import numpy as np
import pytest
from tangled_meshes import tangled

from odt_plugins.engine.odt.density import size_field
from odt_plugins.engine.untangle.sizes import kept_sizes
from odt_plugins.mesh.simplex import simplex_mesh


@pytest.mark.parametrize("dim", [2, 3])
def test_cells_that_stayed_keep_the_sizes_that_the_density_keep_gives_them(dim):
    points, cells, movable = tangled(dim, 7 if dim == 2 else 5, "none")
    points = points * (1.0 + points[:, :1])
    mesh, _ = simplex_mesh(points, cells)
    all_stayed = kept_sizes(mesh, points)
    inner = np.flatnonzero(movable)
    ratio = all_stayed.values / size_field(points, mesh.cells)
    assert np.ptp(ratio) < 1e-12
    assert (all_stayed.power, all_stayed.keeps) == (-(dim + 2.0), True)
    assert kept_sizes(mesh, points, 3.0).power == -3.0
    assert kept_sizes(mesh, points + 1.0) is None
    moved = points.copy()
    moved[inner[0]] += 5.0
    now = kept_sizes(mesh, moved)
    near = np.unique(mesh.cells[(mesh.cells == inner[0]).any(axis=1)])
    around = np.setdiff1d(near, inner[:1])
    assert now.values[around].min() < now.values[inner[0]] < now.values[around].max()
    assert np.log(now.values[inner[0]]) == pytest.approx(np.log(now.values[around]).mean())


@pytest.mark.parametrize("dim", [2, 3])
def test_a_boundary_none_of_whose_cells_stayed_has_the_size_of_its_facets(dim):
    """A grid of equal cells, stretched to twice the size where they moved."""
    points, cells, _ = contract.grid(dim, 6)
    points = np.round(points * 6)
    moved = points[:, 0] >= 3
    points[moved] += [1.5, *[0.0] * (dim - 1)]
    mesh, _ = simplex_mesh(points, cells)
    mesh = replace(mesh, regions=np.zeros(len(cells), dtype=np.int32))
    before = points.copy()
    before[moved] -= 1.0
    values = kept_sizes(mesh, before).values
    stays = np.flatnonzero((points == np.array([0.0, *[3.0] * (dim - 1)])).all(axis=1))[0]
    end = np.flatnonzero((points == np.array([7.5, *[3.0] * (dim - 1)])).all(axis=1))[0]
    facet, cell = (1.0, 0.5) if dim == 2 else (0.5, 1 / 6)
    side, whole = (1.0, np.sqrt(3) / 4) if dim == 2 else (np.sqrt(3) / 4, np.sqrt(2) / 12)
    wanted = (facet / side) ** (1 / (dim - 1)) * (whole / cell) ** (1 / dim)
    assert values[end] / values[stays] == pytest.approx(wanted)
