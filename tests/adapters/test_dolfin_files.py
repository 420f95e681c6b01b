"""DOLFIN's XML: functions in files beside a mesh, and other files there that are none of it."""

from __future__ import annotations

import warnings

import contract
import numpy as np
import pytest

from odt_plugins.adapters.files import read_file
from odt_plugins.api import optimize_file
from odt_plugins.errors import DataNotKeptWarning, MeshFileError

LEGACY = "DOLFIN XML is a legacy format"


def put(path):
    """Write a mesh as DOLFIN does, in any order of indices."""
    points, cells, labels = contract.grid(3, 3)
    lines = ['<?xml version="1.0"?>', '<dolfin xmlns:dolfin="http://fenicsproject.org">',
             f'<mesh celltype="tetrahedron" dim="3"><vertices size="{len(points)}">']
    lines += [f'<vertex index="{i}" x="{x}" y="{y}" z="{z}"/>' for i, (x, y, z) in [
        *enumerate(points.tolist())][::-1]]
    lines += ["</vertices>", f'<cells size="{len(cells)}">']
    lines += [f'<tetrahedron index="{i}" v0="{a}" v1="{b}" v2="{c}" v3="{d}"/>'
              for i, (a, b, c, d) in enumerate(cells.tolist())]
    path.write_text("\n".join([*lines, "</cells></mesh></dolfin>", ""]))
    return points, cells, labels


def function(path, kind, dim, values):
    rows = [f'<entity index="{i}" value="{value}"/>' for i, value in enumerate(values)]
    path.write_text(f'<dolfin><mesh_function type="{kind}" dim="{dim}" size="{len(values)}">'
                    + "\n".join(rows) + "</mesh_function></dolfin>")


def test_functions_of_cells_and_vertices_are_arrays(tmp_path):
    points, cells, labels = put(tmp_path / "a.xml")
    function(tmp_path / "a_region.xml", "uint", 3, labels + 2)
    function(tmp_path / "a_k.xml", "double", 3, labels / 4)
    function(tmp_path / "a_wet.xml", "bool", 3, (labels > 0).astype(int))
    function(tmp_path / "a_h.xml", "double", 0, points[:, 2] / 3)
    mesh = read_file(tmp_path / "a.xml")
    assert np.array_equal(mesh.points, points)
    assert np.array_equal(mesh.cells[0].data, cells)
    assert np.array_equal(mesh.cell_data["region"][0], labels + 2)
    assert np.array_equal(mesh.cell_data["k"][0], labels / 4)
    assert np.array_equal(mesh.cell_data["wet"][0], labels > 0)
    assert np.array_equal(mesh.point_data["h"], points[:, 2] / 3)


def test_what_is_said_of_facets_is_named_where_it_is_lost(tmp_path):
    _, cells, labels = put(tmp_path / "a.xml")
    function(tmp_path / "a_physical_region.xml", "uint", 3, labels + 2)
    function(tmp_path / "a_facet_region.xml", "uint", 2, np.arange(2 * len(cells) + 54) % 3)
    with pytest.warns(DataNotKeptWarning, match="what a_facet_region.xml says of facets"):
        optimize_file(tmp_path / "a.xml", tmp_path / "b.xml")
    assert np.array_equal(np.unique(read_file(tmp_path / "b.xml").cell_data["physical_region"][0]),
                          np.unique(labels + 2))


def test_a_result_beside_its_input_is_none_of_its_functions(tmp_path):
    _, _, labels = put(tmp_path / "a.xml")
    function(tmp_path / "a_region.xml", "uint", 3, labels + 2)
    with pytest.warns(DataNotKeptWarning, match=LEGACY):
        optimize_file(tmp_path / "a.xml", tmp_path / "a_better.xml")
    with warnings.catch_warnings():
        warnings.simplefilter("error", DataNotKeptWarning)
        assert set(read_file(tmp_path / "a.xml").cell_data) == {"region"}
        assert set(read_file(tmp_path / "a_better.xml").cell_data) == {"region"}


def test_a_function_of_another_mesh_is_left_out_with_a_word(tmp_path):
    _, cells, _ = put(tmp_path / "a.xml")
    function(tmp_path / "a_old.xml", "uint", 3, np.zeros(17, dtype=int))
    with pytest.warns(DataNotKeptWarning, match=f"a_old.xml is left out, it has 17 values for "
                      f"{len(cells)} cells"):
        assert not read_file(tmp_path / "a.xml").cell_data


@pytest.mark.parametrize(("old", "new", "said"), [
    ('index="0" x', 'index="1" x', "the indices of its vertices are not 0 to 63"),
    ('v3="', 'v3="9', "a tetra refers to vertex 9[0-9]* of 64, counted from 0"),
    ('celltype="tetrahedron"', 'celltype="hexahedron"', "it has cells of type 'hexahedron'; try"),
    ('size="64"', 'size="65"', "it declares 65 vertices and holds 64"),
    ('x="0.0"', 'x="east"', "it has east in place of a number"),
    ("mesh", "graph", "it has no mesh; expected a file that is one of dolfin-xml"),
])
def test_what_does_not_fit_is_refused(old, new, said, tmp_path):
    put(tmp_path / "a.xml")
    text = (tmp_path / "a.xml").read_text()
    (tmp_path / "a.xml").write_text(text.replace(old, new))
    with pytest.raises(MeshFileError, match=said):
        read_file(tmp_path / "a.xml")
