"""Files with tetrahedra of several materials and the triangles between and around them."""

from __future__ import annotations

import itertools

import contract
import meshio
import numpy as np
import pytest

import odt_plugins
from odt_plugins.adapters import files
from odt_plugins.engine.run import plan

NAMES = {".msh": "gmsh:physical", ".mesh": "medit:ref", ".vtu": "marker", ".vtk": "marker",
         ".xdmf": "marker", ".med": "cell_tags", ".vol": "netgen:index", ".avs": "avsucd:material"}


def _parts():
    """Tetrahedra with labels 1 and 2, and all triangles of the boundary and of the interface."""
    points, cells, labels = contract.grid(3, 4)
    # Coordinates that every format writes as they are.
    points = np.round(points * 1024) / 1024
    labels = np.where(labels == 7, 1, 2)
    skin = sorted(contract.facets(cells, np.zeros(len(cells), int)))
    between = sorted(contract.facets(cells, labels) - set(skin))
    reference = np.concatenate([np.arange(len(skin)) % 6 + 10, np.full(len(between), 20)])
    return points, cells, labels, np.array(skin + between), reference


def _consistent(mesh, labels, cells):
    """Every triangle is a face of tetrahedra, and the interface is where its triangles are."""
    triangles = np.vstack([b.data for b in mesh.cells if b.type == "triangle"])
    rows = {tuple(sorted(t)) for t in triangles.tolist()}
    faces = {f for c in cells.tolist() for f in itertools.combinations(sorted(c), 3)}
    assert rows <= faces
    assert contract.facets(cells, labels) == rows
    return triangles


@pytest.mark.parametrize("churn", [False, True], ids=["engine", "churn"])
@pytest.mark.parametrize("suffix", NAMES)
def test_triangles_beside_tetrahedra_stay_in_the_file(suffix, churn, tmp_path, monkeypatch):
    if churn:
        monkeypatch.setattr(plan, "run", contract.churn)
    points, cells, labels, triangles, reference = _parts()
    name = NAMES[suffix]
    data = {name: [reference, labels]}
    if suffix == ".msh":
        data["gmsh:geometrical"] = [reference, labels]
    mesh = meshio.Mesh(points, [("triangle", triangles), ("tetra", cells)], cell_data=data)
    if suffix == ".msh":
        mesh.field_data = {"steel": np.array([1, 3]), "wall": np.array([12, 2])}
    files.write_file(tmp_path / f"in{suffix}", mesh)
    odt_plugins.optimize(tmp_path / f"in{suffix}", target=tmp_path / f"out{suffix}", keep=())
    before, after = (files.read_file(tmp_path / f"{end}{suffix}") for end in ("in", "out"))
    assert [b.type for b in after.cells] == [b.type for b in before.cells]
    tets = next(i for i, b in enumerate(after.cells) if b.type == "tetra")
    # Families of cells in MED have the negative numbers of their labels.
    told = [np.abs(values) for values in after.cell_data[name]]
    new, new_labels = after.cells[tets].data, told[tets]
    assert not np.array_equal(before.cells[tets].data, new)
    assert np.array_equal(_consistent(after, new_labels, new), triangles)
    assert np.array_equal(told[1 - tets], reference)
    held = np.unique(triangles)
    assert after.points[held].tobytes() == before.points[held].tobytes()
    for label in (1, 2):
        whole = contract.volumes(after.points, new[new_labels == label]).sum()
        assert abs(whole) == pytest.approx(3.0, rel=1e-6)
    for key, value in before.field_data.items():
        assert np.array_equal(after.field_data[key], value)


def test_volumes_of_gmsh_count_where_there_are_no_physical_groups(monkeypatch):
    seen = []
    monkeypatch.setattr(plan, "run", lambda mesh, options, _: seen.append(mesh) or contract.churn(
        mesh, options))
    points, cells, labels, triangles, reference = _parts()
    data = {"gmsh:physical": [np.zeros(len(reference), int), np.zeros(len(cells), int)],
            "gmsh:geometrical": [reference, labels]}
    mesh = meshio.Mesh(points, [("triangle", triangles), ("tetra", cells)], cell_data=data)
    out = odt_plugins.optimize(mesh)
    assert np.array_equal(seen[0].regions, labels - 1)
    _consistent(out, out.cell_data["gmsh:geometrical"][1], out.cells[1].data)


def test_subregions_of_abaqus_files_keep_their_interface(tmp_path, monkeypatch):
    monkeypatch.setattr(plan, "run", contract.churn)
    points, cells, labels, triangles, _ = _parts()
    none = np.zeros(0, dtype=int)
    sets = {"steel": [none, np.flatnonzero(labels == 1)],
            "rubber": [none, np.flatnonzero(labels == 2)], "wall": [np.arange(9), none]}
    mesh = meshio.Mesh(points, [("triangle", triangles), ("tetra", cells)], cell_sets=sets)
    meshio.write(tmp_path / "in.inp", mesh)
    odt_plugins.optimize(tmp_path / "in.inp", target=tmp_path / "out.inp")
    out = files.read_file(tmp_path / "out.inp")
    new = out.cells[1].data
    assert len(new) > len(cells)
    steel, rubber = (np.asarray(out.cell_sets[name][1]) for name in ("steel", "rubber"))
    assert np.array_equal(np.sort(np.concatenate([steel, rubber])), np.arange(len(new)))
    assert np.asarray(out.cell_sets["wall"][0]).tolist() == list(range(9))
    inside = np.zeros(len(new), dtype=int)
    inside[steel] = 1
    _consistent(out, inside, new)


@pytest.mark.parametrize("regions", ["part", "marker", "auto"])
def test_a_cell_set_can_be_named_as_the_region(regions, monkeypatch):
    seen = []
    monkeypatch.setattr(plan, "run", lambda mesh, options, _: seen.append(mesh) or plan.Outcome(
        mesh.points, mesh.cells, mesh.regions))
    points, cells, _, _, _ = _parts()
    third = np.arange(len(cells)) % 3
    mesh = meshio.Mesh(points, [("tetra", cells)], cell_data={"marker": [third]},
                       cell_sets={"part": [np.arange(100)], "other": [np.arange(50, 150)]})
    odt_plugins.optimize(mesh, regions=regions)
    truth = (np.arange(len(cells)) < 100).astype(int) if regions == "part" else third
    assert np.array_equal(seen[0].regions, truth)
    mesh.cell_data.clear()
    odt_plugins.optimize(mesh)
    assert not seen[1].regions.any()
    with pytest.raises(odt_plugins.InvalidOptionError, match=r"one of \['other', 'part'\]"):
        odt_plugins.optimize(mesh, regions="parts")
