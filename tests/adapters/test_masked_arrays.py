"""Masked arrays of numpy: what is under a mask is no number of the caller's."""

from __future__ import annotations

import meshio
import numpy as np
import pytest
from scipy.spatial import Delaunay

import odt_plugins

POINTS = np.random.default_rng(7).random((40, 2))
CELLS = Delaunay(POINTS).simplices
LABELS = (POINTS[CELLS].mean(axis=1)[:, 0] > 0.5).astype(int)


def masked(values, *places):
    out = np.ma.array(values, mask=False)
    for place in places:
        out[place] = np.ma.masked
    return out


@pytest.mark.parametrize(("part", "name"), enumerate(["points", "cells", "regions"]))
def test_a_mesh_with_masked_values_is_refused(part, name):
    mesh = [POINTS, CELLS, LABELS]
    odt_plugins.optimize([*mesh[:part], masked(mesh[part]), *mesh[part + 1:]])
    mesh[part] = masked(mesh[part], 3)
    with pytest.raises(odt_plugins.InvalidMeshError, match=rf"{name} has .* at index 3\).*filled"):
        odt_plugins.optimize(mesh)


@pytest.mark.parametrize(("name", "values"), [
    ("density", np.ones(40)), ("fixed", np.zeros(40, bool)), ("regions", LABELS),
    ("selection", np.ones(len(CELLS), bool)), ("metric", np.tile(np.eye(2), (40, 1, 1)))])
def test_an_option_with_masked_values_is_refused(name, values):
    with pytest.raises(odt_plugins.InvalidOptionError, match=f"{name} has .*masked values? .*try"):
        odt_plugins.optimize((POINTS, CELLS), **{name: masked(values, 2)})


def test_masked_sizes_and_fields_are_refused():
    size = masked(np.full(40, 0.1), 5, 7)
    with pytest.raises(odt_plugins.InvalidOptionError, match="size has 2 masked values"):
        odt_plugins.remesh((POINTS, CELLS), size)
    with pytest.raises(odt_plugins.InvalidOptionError, match="values has 2 masked values"):
        odt_plugins.metric_from_field((POINTS, CELLS), size, 100)


def test_what_is_transferred_may_be_masked_nowhere():
    report = odt_plugins.optimize_with_report((POINTS, CELLS))[1]
    assert len(report.transfer(masked(POINTS))) == 40
    with pytest.raises(odt_plugins.InvalidOptionError, match="values has 1 masked value "):
        report.transfer(masked(POINTS[:, 0], 9))


def with_values(toolkit, at, values):
    """The mesh of a toolkit with an array at its points or cells."""
    if toolkit == "meshio":
        mesh = meshio.Mesh(POINTS, [("triangle", CELLS)])
        if at == "points":
            mesh.point_data["p"] = values
        else:
            mesh.cell_data["p"] = [values]
        return mesh
    mesh = pytest.importorskip("trimesh").creation.icosphere(1)
    (mesh.vertex_attributes if at == "points" else mesh.face_attributes)["p"] = values
    return mesh


@pytest.mark.parametrize("at", ["points", "cells"])
@pytest.mark.parametrize("toolkit", ["meshio", "trimesh"])
def test_arrays_of_a_mesh_with_masked_values_are_refused(toolkit, at):
    counts = {"meshio": (len(POINTS), len(CELLS)), "trimesh": (42, 80)}[toolkit]
    values = np.arange(counts[at == "cells"], dtype=float)
    odt_plugins.optimize(with_values(toolkit, at, masked(values)))
    said = r"'p'.* has 2 masked values .*index 1.*filled"
    with pytest.raises(odt_plugins.InvalidMeshError, match=said):
        odt_plugins.optimize(with_values(toolkit, at, masked(values, 1, 3)))
