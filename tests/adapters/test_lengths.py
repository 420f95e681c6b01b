"""Arrays and sets of a meshio.Mesh that do not fit it, such as ones set after it was made."""

from __future__ import annotations

import contract
import meshio
import numpy as np
import pytest

import odt_plugins
from odt_plugins.errors import InvalidMeshError

WRONG = [
    ("point_data", np.zeros(3), r"point data 'a' has 3 entries for 27 points; expected one a p"),
    ("point_data", np.zeros(3, dtype=int), r"point data 'a' has 3 entries for 27 points"),
    ("point_data", 2.5, r"point data 'a' has 0 entries for 27 points"),
    ("cell_data", [np.zeros(48)], r"cell data 'a' has 1 block for a mesh of 2; expected one each"),
    ("cell_data", None, r"cell data 'a' has 0 blocks for a mesh of 2"),
    ("cell_data", [None, np.zeros(2)], r"cell data 'a' of block 0 has 0 entries for 48 cells"),
    ("cell_data", [np.zeros(48), np.zeros(1)],
     r"cell data 'a' of block 1 has 1 entry for 2 cells; expected one a cell"),
    ("cell_sets", [np.array([0])], r"cell set 'a' has 1 block for a mesh of 2"),
    ("cell_sets", [np.array([0]), np.array([2])],
     r"cell set 'a' has index 2 \(1 out of range\) in block 1; expected indices from 0 to 1 or a"),
    ("point_sets", np.array([3, 27]), r"point set 'a' has index 27 \(1 out of range\); .* 0 to 26"),
    ("point_sets", np.array([-28]), r"point set 'a' has index -1 \(1 out of range\)"),
    ("point_sets", np.zeros(5, dtype=bool), r"point set 'a' has a mask of shape \(5,\); .*\(27,\)"),
]


@pytest.mark.parametrize(("where", "values", "message"), WRONG)
def test_what_does_not_fit_a_mesh_is_named_before_any_work(where, values, message):
    points, cells, _ = contract.grid(3, 2)
    mesh = meshio.Mesh(points, [("tetra", cells), ("triangle", cells[:2, :3])])
    getattr(mesh, where)["a"] = values
    for call in (odt_plugins.optimize, odt_plugins.quality,
                 lambda given: odt_plugins.remesh(given, scale=1.5)):
        with pytest.raises(InvalidMeshError, match=message):
            call(mesh)


def test_blocks_beside_the_cells_may_be_without_data():
    points, cells, _ = contract.grid(3, 2)
    mesh = meshio.Mesh(points, [("tetra", cells), ("triangle", cells[:2, :3])])
    mesh.cell_data["a"], mesh.cell_sets["b"] = [np.ones(48), None], [None, np.array([1])]
    out = odt_plugins.optimize(mesh)
    assert out.cell_data["a"][1] is None
    assert out.cell_sets["b"][0] is None


@pytest.mark.parametrize("kind", [np.uint8, np.int8])
def test_point_sets_may_be_of_few_bits(kind):
    points, cells, _ = contract.grid(3, 6)
    assert len(points) > np.iinfo(kind).max
    members = np.array([5, 7, 100])
    out, alike = (odt_plugins.remesh(meshio.Mesh(
        points, [("tetra", cells)], point_sets={"some": one}), scale=0.8)
        for one in (members, members.astype(kind)))
    assert np.array_equal(out.cells[0].data, alike.cells[0].data)
    assert np.array_equal(out.point_sets["some"], alike.point_sets["some"])
