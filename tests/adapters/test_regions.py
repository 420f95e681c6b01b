"""Which cell arrays are labels of regions: by their name, or since they part the mesh."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import meshio
import numpy as np
import pytest
import pyvista
import tet_meshes
from scipy.spatial import Delaunay

import odt_plugins
from odt_plugins.adapters.regions import AUTO, are_names, region_labels
from odt_plugins.errors import InvalidOptionError

NAMES = ("CellEntityIds", "material", "MaterialIds", "region", "label", "attribute", "subdomain",
         "PartId", "ElementBlockIds", "Material ID", "triangle_material_ids", "cell_markers")

OTHERS = ("gmsh:partition", "PartitionId", "vtkGhostType", "vtkGhostLevels", "ProcessId", "rank",
          "GlobalElementId", "vtkOriginalCellIds", "ObjectId", "cell_id")


def ball():
    """A ball of tetrahedra, and which of them are of an inclusion."""
    points, cells = tet_meshes.ball(300, 5)
    return points, cells, (np.linalg.norm(points[cells].mean(axis=1), axis=1) < 0.5).astype(int)


def plane(n=400):
    points = np.random.default_rng(3).random((n, 2))
    cells = Delaunay(points).simplices
    return points, cells, points[cells].mean(axis=1)


def found(values, cells, name="q7"):
    return region_labels({name: np.asarray(values)}, AUTO, cells).names


def volume(mesh, labels, points=None, cells=None):
    points, cells = (mesh.points, mesh.cells[0].data) if points is None else (points, cells)
    return np.abs(tet_meshes.signed_volumes(points, cells))[labels == 1].sum()


@pytest.mark.parametrize("name", [*NAMES, "q7"])
def test_an_inclusion_keeps_its_volume_whatever_its_array_is_called(name):
    points, cells, inside = ball()
    mesh = meshio.Mesh(points, [("tetra", cells)], cell_data={name: [inside.astype(np.int32)]})
    out, report = odt_plugins.optimize_with_report(mesh, smoothing={"rounds": 2}, finish=False,
                                                   keep=())
    before, now = volume(mesh, inside), volume(out, out.cell_data[name][0])
    assert report.after.mean_quality > report.before.mean_quality
    assert now == pytest.approx(before, rel=1e-12)
    assert report.regions_from == (name,)
    assert f"regions are those of {name!r}" in str(report)
    assert report.to_dict()["regions_from"] == [name]
    off, told = odt_plugins.optimize_with_report(
        mesh, smoothing={"rounds": 2}, finish=False, keep=(), regions=None)
    assert told.regions_from == ()
    assert "regions are" not in str(told)
    assert volume(off, off.cell_data[name][0]) != pytest.approx(before, rel=1e-6)


@pytest.mark.parametrize("name", OTHERS)
def test_partitions_ghosts_and_ids_are_no_regions(name):
    _, cells, inside = ball()
    assert found(inside, cells) == ("q7",)
    assert found(inside, cells, name) == ()


def test_few_pieces_that_hang_together_are_regions_and_scattered_labels_are_not():
    _, cells, x = plane()
    m = len(cells)
    rng = np.random.default_rng(11)
    seeds = rng.random((9, 2))
    grains = np.linalg.norm(x[:, None] - seeds, axis=2).argmin(axis=1)
    for labels in (x[:, 0] > 0.5, np.linalg.norm(x - 0.5, axis=1) < 0.2, grains):
        assert found(labels.astype(np.int16), cells) == ("q7",)
        assert found(labels.astype(np.uint64)[:, None], cells) == ("q7",)
    parents = np.linalg.norm(x[:, None] - rng.random((m // 8, 2)), axis=2).argmin(axis=1)
    for labels in (np.zeros(m), np.arange(m), parents, rng.integers(0, 2, m), rng.integers(0, 9, m),
                   rng.random(m) < 0.02, np.arange(m) == 7, x[:, 0] * 1000):
        assert found(np.asarray(labels).astype(int), cells) == ()
    assert found((x[:, 0] > 0.5).astype(float), cells) == ("q7",)
    assert found(np.arange(m), cells, "material") == ()
    assert found(rng.integers(0, 2, m), cells, "material") == ("material",)
    assert found(np.stack([grains, grains], axis=1), cells) == ()


def test_scattered_labels_in_space_are_no_regions():
    _, cells, _ = ball()
    rng = np.random.default_rng(2)
    for labels in (rng.integers(0, 2, len(cells)), rng.random(len(cells)) < 0.01):
        assert found(labels.astype(int), cells) == ()


def test_all_arrays_that_are_regions_are_combined_but_one_of_the_names_of_formats():
    _, cells, x = plane()
    right, top = (x > 0.5).astype(int).T
    labels, names = region_labels({"layer": right, "marker": top, "gmsh:physical": right,
                                   "order": np.arange(len(x)), "material": top * 3}, AUTO, cells)
    assert names == ("marker", "layer", "material")
    assert np.array_equal(labels, 2 * top + right)
    assert region_labels({"marker": top * 0, "medit:ref": right}, AUTO, cells).names == (
        "medit:ref",)


@pytest.mark.parametrize("names", ["right,top", "right, top", ("right", "top"), ["right", "top"]])
def test_several_names_combine_their_labels(names):
    _, cells, x = plane()
    right, top = (x > 0.5).astype(int).T
    labels = region_labels({"top": top, "right": right}, names, cells)
    assert np.array_equal(labels.values, 2 * right + top)
    assert labels.names == ("right", "top")
    with pytest.raises(InvalidOptionError, match="regions='top' names no cell array"):
        region_labels({"right": right}, names, cells)
    with pytest.raises(InvalidOptionError, match="dtype float64; expected whole numbers"):
        region_labels({"right": right, "top": top + 0.5}, names, cells)
    assert region_labels({"right,top": top, "right": right}, "right,top", cells).names == (
        "right,top",)


def test_arrays_of_vectors_and_complex_numbers_are_not_advised_as_labels():
    data = {"rock": np.ones(1), "v": np.ones((1, 3)), "z": np.ones(1) * 1j}
    mesh = meshio.Mesh(np.eye(4)[:, :3], [("tetra", np.array([[3, 0, 1, 2]]))],
                       cell_data={name: [values] for name, values in data.items()})
    with pytest.raises(InvalidOptionError, match=r"expected one of \['rock'\] or an array"):
        odt_plugins.optimize(mesh, regions="rocks")
    del mesh.cell_data["rock"]
    with pytest.raises(InvalidOptionError, match="the mesh has none; expected an array"):
        odt_plugins.optimize(mesh, regions="rocks")


def test_names_are_told_from_arrays():
    assert all(are_names(value) for value in (None, "auto", "a", ("a", "b"), ["a"]))
    assert not any(are_names(value) for value in ([1, 2], np.array([1]), (), np.array(["a"])))


def test_two_arrays_of_a_grid_both_have_interfaces():
    points, cells, x = plane()
    grid = pyvista.UnstructuredGrid({5: cells}, np.pad(points, ((0, 0), (0, 1))))
    grid.cell_data["right"], grid.cell_data["top"] = (x > 0.5).astype(np.uint8).T
    grid.cell_data["seed"] = np.arange(len(cells))
    out, report = odt_plugins.optimize_with_report(grid)
    assert report.regions_from == ("right", "top")
    for options in ({}, {"regions": "top,right"}):
        out = odt_plugins.optimize(grid, **options)
        for name in ("right", "top"):
            for mesh in (grid, out):
                area = np.abs(mesh.compute_cell_sizes().cell_data["Area"])
                mesh.field_data[name] = [area[mesh.cell_data[name] == 1].sum()]
            assert out.field_data[name] == pytest.approx(grid.field_data[name], rel=1e-12)


def test_cell_sets_are_named_in_the_report():
    points, cells, x = plane()
    right = x[:, 0] > 0.5
    mesh = meshio.Mesh(points, [("triangle", cells)], cell_sets={
        "west": [np.flatnonzero(~right)], "east": [np.flatnonzero(right)]})
    for regions in ("auto", "west"):
        report = odt_plugins.optimize_with_report(mesh, regions=regions)[1]
        assert report.regions_from == (("west", "east") if regions == "auto" else ("west",))
    assert odt_plugins.optimize_with_report(mesh, regions=None)[1].regions_from == ()


def test_blocks_of_other_arrays_tell_of_all_of_them():
    points, cells, x = plane()
    blocks = []
    for name, field in (("right", "u"), ("top", "v")):
        grid = pyvista.UnstructuredGrid({5: cells}, np.pad(points, ((0, 0), (0, 1))))
        grid.cell_data[name] = (x[:, 0] > 0.5).astype(np.uint8)
        grid.point_data[field] = points[:, 0]
        blocks.append(grid.translate([2.0 * len(blocks), 0.0, 0.0]))
    report = odt_plugins.optimize_with_report(pyvista.MultiBlock(blocks))[1]
    assert (report.regions_from, report.interpolated) == (("right", "top"), ("u", "v"))


def test_blocks_take_the_same_regions_and_fields():
    points, cells, x = plane()
    mesh = meshio.Mesh(points, [("triangle", cells)], point_data={"T": points[:, 0].copy()},
                       cell_data={"half": [(x[:, 0] > 0.5).astype(int)]})
    out, report = odt_plugins.optimize_with_report(mesh, blocks=2)
    assert (report.regions_from, report.interpolated) == (("half",), ("T",))
    assert np.array_equal(out.cell_data["half"][0], mesh.cell_data["half"][0][report.cell_origin])
    assert np.abs(out.point_data["T"] - out.points[:, 0]).max() < 1e-12


class Pair(NamedTuple):
    points: np.ndarray
    cells: np.ndarray


@pytest.mark.parametrize("kind", [tuple, list, Pair])
def test_labels_given_by_keyword_to_arrays_come_back(kind):
    points, cells, x = plane()
    labels = (x[:, 0] > 0.5).astype(np.uint8)
    given = Pair(points, cells) if kind is Pair else kind([points, cells])
    out, report = odt_plugins.optimize_with_report(given, regions=labels)
    assert type(out) is (tuple if kind is Pair else kind)
    new, _parts, found_labels = out
    assert found_labels.dtype == np.uint8
    truth = odt_plugins.optimize((points, cells, labels))
    assert all(np.array_equal(a, b) for a, b in zip(out, truth, strict=True))
    assert np.array_equal(labels[report.cell_origin], found_labels)
    assert len(odt_plugins.optimize((points, cells), regions=labels.tolist())) == 3
    assert len(odt_plugins.optimize((points, cells))) == 2
    off = odt_plugins.optimize((points, cells, labels), regions=None)
    assert len(off) == 3
    assert not np.array_equal(off[0], new)
    both = odt_plugins.optimize((points, cells, np.arange(len(cells))), regions=labels)
    assert np.array_equal(both[0], new)
    assert np.array_equal(labels[both[2]], found_labels)


def test_open3d_takes_materials_and_any_attribute_of_triangles():
    open3d = pytest.importorskip("open3d")
    points, cells, x = plane()
    label = (x[:, 0] > 0.5).astype(np.int32)
    space = np.pad(points, ((0, 0), (0, 1)))
    mesh = open3d.t.geometry.TriangleMesh(open3d.core.Tensor(space), open3d.core.Tensor(cells))
    for name in ("material_ids", "q7"):
        one = mesh.clone()
        one.triangle[name] = open3d.core.Tensor(label[:, None])
        assert odt_plugins.optimize_with_report(one)[1].regions_from == (name,)
    old = mesh.to_legacy()
    old.triangle_material_ids = open3d.utility.IntVector(label)
    report = odt_plugins.optimize_with_report(old)[1]
    assert report.regions_from == ("triangle_material_ids",)
    assert odt_plugins.optimize_with_report(old, regions=None)[1].regions_from == ()


def test_pymeshlab_takes_attributes_of_faces():
    pymeshlab = pytest.importorskip("pymeshlab")
    points, cells, x = plane(200)
    mesh = pymeshlab.Mesh(np.pad(points, ((0, 0), (0, 1))), cells)
    mesh.add_face_custom_scalar_attribute((x[:, 0] > 0.5).astype(float), "q7")
    mesh.add_face_custom_scalar_attribute(x[:, 1], "height")
    assert odt_plugins.optimize_with_report(mesh)[1].regions_from == ("q7",)
    assert odt_plugins.optimize_with_report(mesh, regions=None)[1].regions_from == ()


def test_the_origin_of_cells_counts_all_cells_of_the_object():
    points, cells, x = plane()
    line = np.array([[0, 1]])
    grid = pyvista.UnstructuredGrid({3: line, 5: cells}, np.pad(points, ((0, 0), (0, 1))))
    grid.cell_data["row"] = np.arange(grid.n_cells)
    half = (x[:, 0] > 0.5)
    blocks = [("triangle", cells[half]), ("vertex", [[3], [4]]), ("triangle", cells[~half])]
    sizes = np.cumsum([0, *(len(rows) for _, rows in blocks)])
    mesh = meshio.Mesh(points, blocks, cell_data={
        "row": [np.arange(a, b) for a, b in itertools.pairwise(sizes)]})
    for given in (grid, mesh):
        out, report = odt_plugins.optimize_with_report(given)
        row = out.cell_data["row"]
        row = np.concatenate(row) if given is mesh else row
        assert len(np.unique(row)) < len(row)
        assert np.array_equal(report.cell_origin, row)
        assert "cell_origin" not in report.to_dict()
        assert report == report


@pytest.mark.parametrize("name", ["material", "q7"])
@pytest.mark.parametrize("kind", [float, np.float32, bool, str, object, np.uint8])
def test_labels_may_be_whole_numbers_truth_values_or_texts(name, kind):
    points, cells, inside = ball()
    values = inside.astype(str).astype(kind) if kind is object else inside.astype(kind)
    assert found(values, cells, name) == (name,)
    grid = pyvista.UnstructuredGrid({10: cells}, points)
    grid.cell_data[name] = values.astype(str) if kind is object else values
    better = odt_plugins.optimize(grid)
    volume = [grid.extract_cells(np.flatnonzero(inside)).volume]
    volume += [better.extract_cells(np.flatnonzero(
        np.asarray(better.cell_data[name]).astype(str) == str(sorted(values.tolist())[-1]))).volume]
    assert volume[1] == pytest.approx(volume[0], rel=1e-12)


def test_fields_of_floats_are_no_labels():
    _, cells, x = plane()
    assert found(x[:, 0], cells, "material") == ()
    assert found(np.floor(1000 * x[:, 0]), cells, "material") == ()
    assert found(np.where(x[:, 0] > 0.5, np.nan, 1.0), cells, "material") == ()


@pytest.mark.parametrize("regions", [AUTO, "tetgen:ref"])
def test_few_values_of_a_known_array_are_labels_if_not_whole(regions):
    points, cells, inside = ball()
    values = np.where(inside, 2.65, 0.5)
    grid = pyvista.UnstructuredGrid({10: cells}, points)
    grid.cell_data["tetgen:ref"] = values
    better = odt_plugins.optimize(grid, regions=regions)
    volume = [mesh.extract_cells(np.flatnonzero(mesh.cell_data["tetgen:ref"] > 1)).volume
              for mesh in (grid, better)]
    assert volume[1] == pytest.approx(volume[0], rel=1e-12)
    assert found(np.arange(len(cells)) / 7, cells, "tetgen:ref") == ()
    assert found(np.where(inside, np.nan, 1.0), cells, "tetgen:ref") == ()
