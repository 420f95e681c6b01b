"""Exodus files: all that a run does not change stays, as netCDF and VTK read it."""

from __future__ import annotations

import warnings

import contract
import meshio
import netCDF4
import numpy as np
import pytest
from format_table import mesh_of_everything
from made_files import SIDES, box, exodus, letters, put

from odt_plugins import remesh
from odt_plugins.adapters.files import read_file, write_file
from odt_plugins.api import optimize_file
from odt_plugins.errors import DataNotKeptWarning, MeshFileError


def side_places(path):
    """Corners of the sides of the side set, as places, and the factors of these."""
    with netCDF4.Dataset(path) as f:
        points = np.stack([f[f"coord{axis}"][:].data for axis in "xyz"], axis=1)
        cells = np.concatenate([f["connect1"][:].data, f["connect2"][:].data]) - 1
        element, side = f["elem_ss1"][:].data - 1, f["side_ss1"][:].data - 1
        rows = np.array([cells[e][list(SIDES[s])] for e, s in zip(element, side, strict=True)])
        factors = f["dist_fact_ss1"][:].data.reshape(-1, 3)
    order = np.argsort(rows, axis=1)
    return (np.take_along_axis(rows, order, axis=1), np.take_along_axis(factors, order, axis=1),
            points, rows)


@pytest.mark.parametrize("kind", ["NETCDF3_64BIT_OFFSET", "NETCDF4"])
def test_all_that_is_not_optimised_stays(kind, tmp_path):
    points, cells, labels, plane = box()
    one, two = np.unique(labels)[:2]
    blocks = [cells[labels == one], cells[labels == two]]
    source, target = tmp_path / "a.e", tmp_path / "b.e"
    exodus(source, kind, points, blocks, plane)
    optimize_file(source, target)
    with netCDF4.Dataset(source) as a, netCDF4.Dataset(target) as b:
        assert a.data_model == b.data_model == kind
        assert a.ncattrs() == b.ncattrs()
        assert list(a.variables) == list(b.variables)
        for name, variable in a.variables.items():
            assert b[name].dtype == variable.dtype
            assert b[name].dimensions == variable.dimensions
            assert b[name].__dict__ == variable.__dict__
        for name in ("time_whole", "qa_records", "eb_prop1", "eb_names", "eb_status", "ss_prop1",
                     "ss_names", "ns_prop1", "ns_names", "els_prop1", "node_num_map", "node_ns1",
                     "node_ns2", "elem_var_tab", "name_nod_var"):
            assert np.array_equal(a[name][:], b[name][:]), name
        now = np.stack([b[f"coord{axis}"][:].data for axis in "xyz"], axis=1)
        assert not np.array_equal(now, points)
        assert np.array_equal(now[plane], points[plane])
        for i in range(3):
            for t in range(3):
                assert np.allclose(b[f"vals_nod_var{i + 1}"][t], t + now @ [1 + i, 2, -1],
                                   atol=1e-12)
        numbers = b["elem_num_map"][:].data
        assert len(set(numbers.tolist())) == len(numbers) == len(b.dimensions["num_elem"])
        start = 0
        for k in (1, 2):
            new = b[f"connect{k}"][:].data - 1
            rows = np.searchsorted(np.sort(a[f"vals_elem_var2eb{k}"][0].data),
                                   b[f"vals_elem_var2eb{k}"][0].data)
            origin = np.argsort(a[f"vals_elem_var2eb{k}"][0].data)[rows]
            assert np.array_equal(a[f"vals_elem_var2eb{k}"][2].data[origin],
                                  b[f"vals_elem_var2eb{k}"][2].data)
            old = numbers[start: start + len(new)] < 500 + len(cells)
            first = len(blocks[0]) * (k - 1)
            assert np.array_equal(numbers[start: start + len(new)][old],
                                  500 + first + origin[old])
            volume = np.linalg.det(now[new[:, 1:]] - now[new[:, :1]]).sum() / 6
            before = np.linalg.det(points[blocks[k - 1][:, 1:]]
                                   - points[blocks[k - 1][:, :1]]).sum() / 6
            assert volume == pytest.approx(before, abs=1e-12)
            start += len(new)
        assert (b["elem_els1"][:] <= len(numbers)).all()
        listed = numbers[b["elem_els1"][:].data - 1]
        assert set(listed[listed < 500 + len(cells)]) <= set(range(500, 520))
    old, old_factors, _, old_rows = side_places(source)
    new, new_factors, _, new_rows = side_places(target)
    assert np.array_equal(old, new)
    assert np.array_equal(old_factors, new_factors)
    turns = [np.roll(new_rows, k, axis=1) for k in range(3)]
    assert np.any([(turn == old_rows).all(axis=1) for turn in turns], axis=0)[:-1].all()


def test_vtk_reads_blocks_and_sets(tmp_path):
    vtk = pytest.importorskip("vtkmodules.vtkIOExodus")
    points, cells, labels, plane = box()
    blocks = [cells[labels == label] for label in np.unique(labels)[:2]]
    exodus(tmp_path / "a.e", "NETCDF4", points, blocks, plane)
    optimize_file(tmp_path / "a.e", tmp_path / "b.e")
    seen = []
    for name in "ab":
        reader = vtk.vtkExodusIIReader()
        reader.SetFileName(str(tmp_path / f"{name}.e"))
        reader.UpdateInformation()
        kinds = (reader.ELEM_BLOCK, reader.SIDE_SET, reader.NODE_SET, reader.ELEM_SET)
        for kind in kinds:
            for i in range(reader.GetNumberOfObjects(kind)):
                reader.SetObjectStatus(kind, i, 1)
        reader.Update()
        seen.append([(reader.GetObjectName(kind, i), reader.GetObjectId(kind, i))
                     for kind in kinds for i in range(reader.GetNumberOfObjects(kind))])
        parts = reader.GetOutput()
        floor = parts.GetBlock(4).GetBlock(0)
        assert floor.GetNumberOfCells() == len(side_places(tmp_path / "a.e")[0])
    assert seen[0] == seen[1]
    assert ("fault", 10) in seen[0]


@pytest.mark.parametrize("scale", [0.6, 1.5])
def test_sets_and_factors_reach_as_far_as_before_where_vertices_came(scale, tmp_path):
    points, cells, labels, plane = box()
    blocks = [cells[labels == label] for label in np.unique(labels)[:2]]
    exodus(tmp_path / "a.e", "NETCDF4", points, blocks, plane)
    write_file(tmp_path / "b.e", remesh(
        read_file(tmp_path / "a.e"), scale=scale, free="periodic"))
    with netCDF4.Dataset(tmp_path / "b.e") as f:
        assert len(f.dimensions["time_step"]) == 3
        now = np.stack([f[f"coord{axis}"][:].data for axis in "xyz"], axis=1)
        rows = np.concatenate([f["connect1"][:].data, f["connect2"][:].data]) - 1
        assert len(rows) != len(cells)
        element, side = f["elem_ss1"][:].data - 1, f["side_ss1"][:].data - 1
        sides = np.array([rows[e][list(SIDES[s])] for e, s in zip(element, side, strict=True)])
        factors = f["dist_fact_ss1"][:].data.reshape(-1, 3)
        assert np.allclose(factors, now[sides].sum(axis=2), atol=1e-12)
        floor = (np.abs(now[sides][:, :, 2]) < 1e-9).all(axis=1)
        x = now[sides[floor]]
        area = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])[:, 2]
        assert np.abs(area).sum() / 2 == pytest.approx(1)
        assert np.array_equal(np.sort(f["node_ns2"][:].data) - 1, np.arange(len(now)))


def test_nodes_of_a_face_are_those_of_the_finer_one(tmp_path):
    points, cells, labels, _ = box(4)
    blocks = [cells[labels == label] for label in np.unique(labels)[:2]]
    exodus(tmp_path / "a.e", "NETCDF3_64BIT_OFFSET", points, blocks,
           np.flatnonzero(points[:, 2] == 0))
    write_file(tmp_path / "b.e", remesh(
        read_file(tmp_path / "a.e"), scale=0.5, free="periodic"))
    with netCDF4.Dataset(tmp_path / "b.e") as f:
        there = np.flatnonzero(np.abs(f["coordz"][:].data) < 1e-9)
        assert len(there) > (points[:, 2] == 0).sum()
        assert np.array_equal(np.sort(f["node_ns1"][:].data) - 1, there)


def test_vtk_reads_the_places_of_a_new_file(tmp_path):
    vtk = pytest.importorskip("vtkmodules.vtkIOExodus")
    points, cells, _, _ = box(3)
    write_file(tmp_path / "a.e", meshio.Mesh(points, [("tetra", cells)]))
    reader = vtk.vtkExodusIIReader()
    reader.SetFileName(str(tmp_path / "a.e"))
    reader.Update()
    grid = reader.GetOutput().GetBlock(0).GetBlock(0)
    assert grid.GetNumberOfPoints() == len(points)
    assert grid.GetBounds() == (0, 1, 0, 1, 0, 1)


def test_in_the_plane_it_stays_in_the_plane(tmp_path):
    points, cells, _ = contract.grid(2, 8)
    points = points / points.max()
    inner = ((points > 0) & (points < 1)).all(axis=1)
    points[inner] += np.random.default_rng(3).uniform(-0.03, 0.03, (inner.sum(), 2))
    rim = np.flatnonzero([(points[[row[0], row[1]], 1] == 0).all() for row in cells])
    with netCDF4.Dataset(tmp_path / "a.e", "w", format="NETCDF3_CLASSIC") as f:
        for name, size in {"num_dim": 2, "num_nodes": len(points), "num_elem": len(cells),
                           "num_el_blk": 1, "num_el_in_blk1": len(cells), "num_nod_per_el1": 3,
                           "num_side_sets": 1, "num_side_ss1": len(rim)}.items():
            f.createDimension(name, size)
        put(f, "coord", "f8", ("num_dim", "num_nodes"), points.T)
        put(f, "connect1", "i4", ("num_el_in_blk1", "num_nod_per_el1"), cells + 1,
            elem_type="TRI3")
        put(f, "elem_ss1", "i4", ("num_side_ss1",), rim + 1)
        put(f, "side_ss1", "i4", ("num_side_ss1",), np.ones(len(rim), int))
    optimize_file(tmp_path / "a.e", tmp_path / "b.e")
    with netCDF4.Dataset(tmp_path / "b.e") as f:
        assert f["coord"].shape == (2, len(points))
        now, rows = f["coord"][:].data.T, f["connect1"][:].data - 1
        element, side = f["elem_ss1"][:].data - 1, f["side_ss1"][:].data - 1
    assert not np.array_equal(now, points)
    edges = np.stack([rows[element, side], rows[element, (side + 1) % 3]], axis=1)
    assert np.array_equal(edges, cells[rim][:, :2])


def test_faces_of_shells_follow_their_elements(tmp_path):
    points, cells, _ = contract.grid(2, 8)
    points = np.column_stack([points / points.max(), np.zeros(len(points))])
    inner = ((points[:, :2] > 0) & (points[:, :2] < 1)).all(axis=1)
    points[inner, :2] += np.random.default_rng(3).uniform(-0.04, 0.04, (inner.sum(), 2))
    with netCDF4.Dataset(tmp_path / "a.e", "w", format="NETCDF3_CLASSIC") as f:
        for name, size in {"num_dim": 3, "num_nodes": len(points), "num_elem": len(cells),
                           "num_el_blk": 1, "num_el_in_blk1": len(cells), "num_nod_per_el1": 3,
                           "num_side_sets": 1, "num_side_ss1": len(cells),
                           "num_df_ss1": 3 * len(cells)}.items():
            f.createDimension(name, size)
        put(f, "coord", "f8", ("num_dim", "num_nodes"), points.T)
        put(f, "connect1", "i4", ("num_el_in_blk1", "num_nod_per_el1"), cells + 1,
            elem_type="TRISHELL")
        put(f, "elem_ss1", "i4", ("num_side_ss1",), np.arange(len(cells)) + 1)
        put(f, "side_ss1", "i4", ("num_side_ss1",), np.full(len(cells), 2))
        put(f, "dist_fact_ss1", "f8", ("num_df_ss1",), np.ones(3 * len(cells)))
    optimize_file(tmp_path / "a.e", tmp_path / "b.e")
    with netCDF4.Dataset(tmp_path / "b.e") as f:
        assert not np.array_equal(f["connect1"][:], cells + 1)
        assert sorted(f["elem_ss1"][:].tolist()) == list(range(1, f["connect1"].shape[0] + 1))
        assert (f["side_ss1"][:] == 2).all()


def test_a_mesh_that_did_not_change_comes_back_value_by_value(tmp_path):
    points, cells, labels, plane = box(4)
    blocks = [cells[labels == label] for label in np.unique(labels)[:2]]
    exodus(tmp_path / "a.e", "NETCDF4", points, blocks, plane)
    mesh = read_file(tmp_path / "a.e")
    write_file(tmp_path / "b.e", mesh)
    with netCDF4.Dataset(tmp_path / "a.e") as a, netCDF4.Dataset(tmp_path / "b.e") as b:
        for name, variable in a.variables.items():
            assert np.array_equal(variable[:], b[name][:]), name


def test_blocks_and_sets_have_a_home_in_other_formats(tmp_path):
    pyvista = pytest.importorskip("pyvista")
    points, cells, labels, plane = box()
    blocks = [cells[labels == label] for label in np.unique(labels)[:2]]
    exodus(tmp_path / "a.e", "NETCDF4", points, blocks, plane)
    with pytest.warns(DataNotKeptWarning, match=r"'floor', 'steel' \(arrays of 0 and 1"):
        optimize_file(tmp_path / "a.e", tmp_path / "b.vtu")
    grid = pyvista.read(tmp_path / "b.vtu")
    tets = grid.celltypes == 10
    ids = grid.cell_data["exodus:block"]
    assert np.array_equal(ids == 70, grid.cell_data["steel"] == 1)
    assert set(ids[tets]) == {70, 8}
    assert set(grid.cell_data["exodus:side_set"][~tets]) == {3}
    assert np.array_equal(np.flatnonzero(grid.point_data["fault"]), plane)
    assert {"v[0]", "v[1]", "v[2]", "fault"} <= set(grid.point_data)


def test_groups_of_gmsh_become_blocks_and_side_sets(tmp_path):
    vtk = pytest.importorskip("vtkmodules.vtkIOExodus")
    mesh = mesh_of_everything()
    mesh.cell_sets["some"] = [np.arange(3) if block.type == "tetra" else np.zeros(0, int)
                              for block in mesh.cells]
    mesh.point_sets["few"] = np.arange(4)
    mesh.point_data["flow"] = mesh.points * [1, 2, 3]
    write_file(tmp_path / "a.e", mesh)
    reader = vtk.vtkExodusIIReader()
    reader.SetFileName(str(tmp_path / "a.e"))
    reader.UpdateInformation()
    seen = {kind: {reader.GetObjectName(kind, i): reader.GetObjectId(kind, i)
                   for i in range(reader.GetNumberOfObjects(kind))}
            for kind in (reader.ELEM_BLOCK, reader.SIDE_SET, reader.NODE_SET, reader.ELEM_SET)}
    assert seen[reader.ELEM_BLOCK] == {"steel": 7, "rubber": 9}
    assert seen[reader.SIDE_SET] == {"inside": 3, "outside": 4}
    assert set(seen[reader.NODE_SET]) == {"few"}
    assert set(seen[reader.ELEM_SET]) == {"some"}
    back = read_file(tmp_path / "a.e")
    for name, of in {"stress": "cell_data", "height": "point_data", "flow": "point_data"}.items():
        found = np.concatenate([np.ravel(part) for part in getattr(back, of)[name]])
        assert np.array_equal(found, _ordered(mesh, back, name, of))


def _ordered(mesh, back, name, of):
    """Values of an array of a mesh in the order of another, whose blocks of a type it follows."""
    if of == "point_data":
        return np.ravel(mesh.point_data[name])
    order = sorted(range(len(mesh.cells)), key=lambda i: mesh.cells[i].type != "tetra")
    assert [len(mesh.cells[i].data) for i in order] == [len(b.data) for b in back.cells]
    return np.concatenate([mesh.cell_data[name][i] for i in order])


def test_files_of_meshio_are_read_as_before(tmp_path):
    points, cells, _, _ = box(3)
    meshio.write(tmp_path / "a.e", meshio.Mesh(points, [("tetra", cells)],
                                               point_data={"u": points[:, 0]}))
    mesh = read_file(tmp_path / "a.e")
    assert np.array_equal(mesh.point_data["u"], points[:, 0])
    optimize_file(tmp_path / "a.e", tmp_path / "b.e")
    back = meshio.read(tmp_path / "b.e")
    assert np.allclose(back.point_data["u"], back.points[:, 0], atol=1e-12)


@pytest.mark.parametrize("size", [None, 0.2])
def test_coordinates_of_32_bits_are_those_that_are_judged(size, tmp_path):
    points, cells, labels, plane = box(5)
    blocks = [cells[labels == label] for label in np.unique(labels)[:2]]
    exodus(tmp_path / "a.e", "NETCDF4", points, blocks, plane)
    with netCDF4.Dataset(tmp_path / "a.e") as a, netCDF4.Dataset(tmp_path / "b.e", "w") as b:
        a.set_auto_mask(False)
        a.set_auto_chartostring(False)
        for name, dim in a.dimensions.items():
            b.createDimension(name, None if dim.isunlimited() else len(dim))
        for name, variable in a.variables.items():
            kind = "f4" if name.startswith("coord") else variable.dtype
            put(b, name, kind, variable.dimensions, variable[:], **variable.__dict__)
    assert read_file(tmp_path / "b.e").points.dtype == np.float32
    with warnings.catch_warnings():
        warnings.simplefilter("error", DataNotKeptWarning)
        optimize_file(tmp_path / "b.e", tmp_path / "c.e") if size is None else write_file(
            tmp_path / "c.e", remesh(read_file(tmp_path / "b.e"), size))
    with netCDF4.Dataset(tmp_path / "c.e") as f:
        assert f["coordx"].dtype == np.float32


def test_what_only_a_copy_keeps_is_named_where_another_format_is_written(tmp_path):
    points, cells, labels, plane = box(3)
    blocks = [cells[labels == label] for label in np.unique(labels)[:2]]
    exodus(tmp_path / "a.e", "NETCDF4", points, blocks, plane)
    with netCDF4.Dataset(tmp_path / "a.e", "a") as f:
        f.createDimension("num_glo_var", 1)
        put(f, "name_glo_var", "S1", ("num_glo_var", "len_string"), letters(["energy"]))
        put(f, "vals_glo_var", "f8", ("time_step", "num_glo_var"), [[1.0], [2.0], [3.0]])
    mesh = read_file(tmp_path / "a.e")
    with pytest.warns(DataNotKeptWarning, match="the times of its steps, variables of the whole "
                      "mesh 'energy', factors of side sets, attributes of elements"):
        write_file(tmp_path / "b.vtu", mesh)
    with warnings.catch_warnings():
        warnings.simplefilter("error", DataNotKeptWarning)
        write_file(tmp_path / "b.e", mesh)


@pytest.mark.parametrize(("word", "said"), [("TETRA14", "tetra14"), ("NFACED", "'NFACED'")])
def test_cells_that_nothing_holds_are_named(word, said, tmp_path):
    with netCDF4.Dataset(tmp_path / "a.e", "w") as f:
        for name, size in {"num_dim": 3, "num_nodes": 14, "num_elem": 1, "num_el_blk": 1,
                           "num_el_in_blk1": 1, "num_nod_per_el1": 14}.items():
            f.createDimension(name, size)
        for axis in "xyz":
            put(f, f"coord{axis}", "f8", ("num_nodes",), np.arange(14.0))
        put(f, "connect1", "i4", ("num_el_in_blk1", "num_nod_per_el1"),
            np.arange(1, 15)[None], elem_type=word)
    with pytest.raises(MeshFileError, match=f"it has cells of type {said}.*; try a file without "
                       "these cells"):
        read_file(tmp_path / "a.e")


def test_files_written_anew_are_read_by_meshio(tmp_path):
    """Neither it nor the manual of Exodus knows TETRA4, PYRAMID5 and WEDGE6."""
    points = np.random.default_rng(0).random((20, 3))
    cells = [("tetra", np.array([[0, 1, 2, 3]])), ("pyramid", np.array([[4, 5, 6, 7, 8]])),
             ("wedge", np.array([[9, 10, 11, 12, 13, 14]]))]
    write_file(tmp_path / "a.e", meshio.Mesh(points, cells, {"x": points[:, 0]}))
    back = meshio.read(tmp_path / "a.e")
    assert [(block.type, block.data.tolist()) for block in back.cells] == [
        (kind, rows.tolist()) for kind, rows in cells]
    assert np.array_equal(back.point_data["x"].ravel(), points[:, 0])


def test_sets_that_overlap_are_whole(tmp_path):
    """A cell is in one block: a set of which other blocks have a part is one of elements."""
    points, cells, _, _ = box(3)
    m = len(cells)
    sides = np.sort(cells[:, :3], axis=1)[:4]
    sets = {"left": np.arange(m // 2), "mid": np.arange(m // 3, m), "all": np.arange(m),
            "both": np.arange(m // 4)}
    mesh = meshio.Mesh(points, [("tetra", cells), ("triangle", sides)], cell_sets={
        name: [rows, np.arange(4 if name == "both" else 0)] for name, rows in sets.items()})
    with warnings.catch_warnings():
        warnings.simplefilter("error", DataNotKeptWarning)
        write_file(tmp_path / "a.e", mesh)
    back = read_file(tmp_path / "a.e")
    places = points[cells].mean(axis=1)
    for name, rows in sets.items():
        found = np.concatenate([back.points[block.data[part]].mean(axis=1) for block, part in zip(
            back.cells, back.cell_sets[name], strict=True) if block.type == "tetra"])
        assert np.array_equal(np.unique(found, axis=0), np.unique(places[rows], axis=0))
    with netCDF4.Dataset(tmp_path / "a.e") as f:
        blocks = len(f.dimensions["num_el_blk"])
        assert sum(len(f.dimensions[f"num_el_in_blk{k + 1}"]) for k in range(blocks)) == m
        assert len(f.dimensions["num_elem_sets"]) > 0


def test_sets_that_overlap_and_have_sides_are_whole(tmp_path):
    """Side sets had the name of such a set, whose elements were nowhere."""
    points, cells, _, _ = box(3)
    sides = np.sort(cells[:, :3], axis=1)[:9]
    sets = {"a": [np.arange(20), np.arange(5)], "b": [np.arange(10, 40), np.arange(5, 9)]}
    write_file(tmp_path / "a.e", meshio.Mesh(
        points, [("tetra", cells), ("triangle", sides)], cell_sets=sets))
    back = read_file(tmp_path / "a.e")
    places = points[cells].mean(axis=1)
    for name, (rows, _) in sets.items():
        found = np.concatenate([back.points[block.data[part]].mean(axis=1) for block, part in zip(
            back.cells, back.cell_sets[name], strict=True) if block.type == "tetra"])
        assert np.array_equal(np.unique(found, axis=0), np.unique(places[rows], axis=0))
