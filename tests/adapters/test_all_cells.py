"""Masks, labels, densities and sizes of all cells of an object that has others beside its own."""

from __future__ import annotations

import contract
import meshio
import numpy as np
import pytest
import pyvista

import odt_plugins
from odt_plugins.errors import InvalidOptionError


def beside(kind):
    """Tetrahedra amidst triangles of their boundary; where they are, their labels and places."""
    points, cells, labels = contract.grid(3, 4)
    faces = np.array(sorted(sorted(f) for f in contract.facets(cells, np.zeros(len(cells)))))
    own = np.repeat([False, True, False], [50, len(cells), len(faces) - 50])
    parts = [("triangle", faces[:50]), ("tetra", cells), ("triangle", faces[50:])]
    mesh = meshio.Mesh(points, parts)
    if kind == "pyvista":
        flat = [np.insert(rows, 0, rows.shape[1], axis=1).ravel() for _, rows in parts]
        mesh = pyvista.UnstructuredGrid(np.concatenate(flat), np.where(own, 10, 5), points)
    return mesh, own, labels


@pytest.mark.parametrize("kind", ["meshio", "pyvista"])
def test_values_of_all_cells_are_those_of_the_optimised_ones(kind):
    mesh, own, labels = beside(kind)
    size = np.where(labels == 7, 0.15, 0.3)
    for call, name, values, other in (
        (odt_plugins.optimize, "selection", labels == 7, True),
        (odt_plugins.optimize, "regions", labels, 99),
        (odt_plugins.optimize, "density", size**-5, 1.0),
        (odt_plugins.remesh, "size", size, 1e-9),
    ):
        of_all = np.full(len(own), other, dtype=values.dtype)
        of_all[own] = values
        one, two = (call(mesh, **{name: given}) for given in (values, of_all))
        assert np.array_equal(one.points, two.points), name
        assert not np.array_equal(one.points, mesh.points), name


def test_they_may_be_lists():
    mesh, own, labels = beside("meshio")
    size = np.where(labels == 7, 0.15, 0.3)
    for call, name, values, other in (
        (odt_plugins.optimize, "selection", labels == 7, True),
        (odt_plugins.optimize, "regions", labels, 99),
        (odt_plugins.remesh, "size", size, 1e-9),
    ):
        of_all = np.full(len(own), other, dtype=values.dtype)
        of_all[own] = values
        one, two = (call(mesh, **{name: given}) for given in (of_all, of_all.tolist()))
        assert np.array_equal(one.points, two.points), name


def test_other_lengths_are_refused_as_before():
    mesh, own, _ = beside("meshio")
    with pytest.raises(InvalidOptionError, match=r"mask of shape \(577,\); expected \(384,\)"):
        odt_plugins.optimize(mesh, selection=np.ones(len(own) + 1, dtype=bool))
