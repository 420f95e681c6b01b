"""The accessor `.odt` of pyvista's meshes."""

from __future__ import annotations

import inspect
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import contract
import numpy as np
import pytest

import odt_plugins
from odt_plugins import tetwild
from odt_plugins.errors import InvalidMeshError, InvalidOptionError, UnsupportedMeshError
from odt_plugins.hosts import pyvista_accessor
from odt_plugins.options import OPTIONS

pyvista = pytest.importorskip("pyvista")


@pytest.fixture(autouse=True)
def _registered():
    odt_plugins.register("pyvista")
    odt_plugins.register("pyvista")


@pytest.mark.parametrize("name", ["pyvista-tet", "pyvista-tri", "pyvista-polydata"])
def test_the_accessor_does_what_the_functions_do(name):
    host = contract.HOSTS[name]
    mesh = host.make()
    before = host.view(mesh)
    out = mesh.odt.optimize(smoothing={"rounds": 3, "cycles": 1})
    truth, told = odt_plugins.optimize_with_report(mesh, smoothing={"rounds": 3, "cycles": 1})
    assert type(out) is type(mesh)
    assert contract.same_bits(host.view(out), host.view(truth))
    again, report = mesh.odt.optimize_with_report(smoothing={"rounds": 3, "cycles": 1})
    assert contract.same_bits(host.view(out), host.view(again))
    assert report.after == told.after
    assert out.odt.quality() == odt_plugins.quality(out)
    assert mesh.odt.quality() == report.before
    assert contract.same_bits(before, host.view(mesh))


def test_the_options_are_those_of_optimize():
    grid = contract.HOSTS["pyvista-tet"].make()
    options = [name for name in inspect.signature(odt_plugins.optimize).parameters
               if name in OPTIONS]
    for function in (grid.odt.optimize, grid.odt.optimize_with_report):
        assert list(inspect.signature(function).parameters) == options
    with pytest.raises(InvalidOptionError, match="did you mean 'threads'"):
        contract.HOSTS["pyvista-tet"].make().odt.optimize(thread=3)


def test_cell_quality_is_that_of_quality():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [1.5, 0.5, 0]])
    faces = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    for turned in (faces, faces[:, ::-1]):
        mesh = pyvista.PolyData.from_regular_faces(points, turned)
        values = mesh.odt.cell_quality().cell_data["odt_radius_ratio"]
        assert np.array_equal(np.sign(values), [1, -1, 1, 1])
        assert values.min() == mesh.odt.quality().min_quality


def test_cell_quality_is_an_array_on_a_copy():
    corner = np.array([[0.0, 0, 0], [1, 1, 0], [1, 0, 1], [0, 1, 1], [1, 1, 1]])
    flat = [2, 0, 1, 4, 0, 2, 1, 3, 4, 1, 2, 3, 4]
    mesh = pyvista.UnstructuredGrid(flat, np.array([3, 10, 10], dtype=np.uint8), corner)
    out = mesh.odt.cell_quality()
    assert mesh.array_names == []
    values = out.cell_data["odt_radius_ratio"]
    assert np.isnan(values[0])
    inradius = (1.0 / 6) * 3 / (3 * 0.5 + np.sqrt(3.0) / 2)
    assert values[1] == pytest.approx(1.0)
    assert values[2] == pytest.approx(3 * inradius / np.sqrt(0.75))
    surface = pyvista.Sphere(theta_resolution=6, phi_resolution=6)
    values = surface.odt.cell_quality().cell_data["odt_radius_ratio"]
    assert len(values) == surface.n_cells
    theirs = surface.cell_quality("radius_ratio").cell_data["radius_ratio"]
    assert values == pytest.approx(1.0 / theirs, rel=1e-5)


def test_surfaces_are_filled_with_tetrahedra(tmp_path, monkeypatch):
    pytest.importorskip("pytetwild")
    monkeypatch.chdir(tmp_path)
    cube = pyvista.Cube()
    grid = cube.odt.tetrahedralize(edge_length_fac=0.15, epsilon=1e-2)
    assert type(grid) is pyvista.UnstructuredGrid
    assert set(grid.celltypes.tolist()) == {10}
    assert grid.volume == pytest.approx(1.0, rel=0.05)
    assert (grid.compute_cell_sizes()["Volume"] > 0).all()
    assert list(tmp_path.iterdir()) == []
    assert cube.n_cells == 6


def test_tetrahedralize_passes_everything_on(monkeypatch):
    points, cells, _ = contract.grid(3, 4)
    calls = []
    monkeypatch.setattr(tetwild, "run_tetwild", lambda given: calls.append(given) or (
        points, cells.astype(np.int32)))
    cube = pyvista.Cube()
    field = pyvista.ImageData(dimensions=(3, 3, 3)).to_tetrahedra()
    field.point_data["h"] = np.linspace(0.1, 0.2, 27)
    field.point_data["k"] = np.linspace(0.3, 0.4, 27)
    field.set_active_scalars("h")
    for name, scalars in (("h", None), ("k", "k")):
        cube.odt.tetrahedralize(stop_energy=9.0, sizing_field=field, odt=False,
                                sizing_field_scalars=scalars)
        given = calls[-1]
        assert given["stop_energy"] == 9.0
        assert given["vtk_ordering"] is True
        assert np.array_equal(given["bg_values"], field.point_data[name])
        assert np.array_equal(given["bg_vertices"], field.points)
        assert np.array_equal(given["bg_tets"], field.cells_dict[10])
        assert given["faces"].shape == (12, 3)
    grid = cube.odt.tetrahedralize(odt=False)
    assert grid.points.tobytes() == points.tobytes()
    better = cube.odt.tetrahedralize(smoothing={"rounds": 2}, stop_energy=9.0,
                                     disable_filtering=True)
    assert better.odt.quality().mean_quality > grid.odt.quality().mean_quality
    with pytest.raises(InvalidOptionError, match=r"smoothing={'rounds': -1}"):
        cube.odt.tetrahedralize(smoothing={"rounds": -1})
    with pytest.raises(InvalidOptionError, match="mean 'edge_length_"):
        cube.odt.tetrahedralize(edge_length=3.0)


def test_surfaces_without_faces_are_named():
    for surface in (pyvista.PolyData(), pyvista.Line()):
        with pytest.raises(InvalidMeshError, match="the surface has no faces"):
            surface.odt.tetrahedralize()


def test_wrong_sizing_fields_are_named():
    cube = pyvista.Cube()
    tets = pyvista.ImageData(dimensions=(3, 3, 3)).to_tetrahedra()
    tets.point_data["h"] = np.ones(27)
    mixed = pyvista.UnstructuredGrid([4, 0, 1, 2, 3, 2, 0, 1], np.array([10, 3], dtype=np.uint8),
                                     np.eye(4)[:, :3])
    grid = pyvista.ImageData(dimensions=(3, 3, 3))
    for field, message in ((cube, r"PolyData; expected a pyvista\.Unst.*\.delaunay_3d\(\)$"),
                           (grid, r"ImageData; .* try sizing_field\.to_tetrahedra\(\)$"),
                           (3, "type int; .* tetrahedra only$"),
                           (mixed, r"tetrahedra only, try sizing_field\.delaunay_3d\(\)$")):
        with pytest.raises(UnsupportedMeshError, match=message):
            cube.odt.tetrahedralize(sizing_field=field)
    with pytest.raises(UnsupportedMeshError, match=r"array 'size'; expected .* one of \['h'\]"):
        cube.odt.tetrahedralize(sizing_field=tets, sizing_field_scalars="size")
    tets.point_data.active_scalars_name = None
    with pytest.raises(UnsupportedMeshError, match="array None"):
        cube.odt.tetrahedralize(sizing_field=tets)


def test_only_surfaces_and_grids_have_the_accessor():
    assert not hasattr(pyvista.Cube().cast_to_unstructured_grid().odt, "tetrahedralize")
    assert not hasattr(pyvista.ImageData(), "odt")


OLD = """
import numpy as np, pyvista, odt_plugins
if hasattr(pyvista, "register_dataset_accessor"):
    del pyvista.register_dataset_accessor
assert "odt" not in vars(pyvista.PolyData)
odt_plugins.register("pyvista")
odt_plugins.register("pyvista")
tets = pyvista.ImageData(dimensions=(3, 3, 3)).to_tetrahedra()
print(type(tets.odt.optimize()).__name__, hasattr(pyvista.Cube().odt, "tetrahedralize"))
"""


def test_older_versions_of_pyvista_get_a_property_and_importing_alone_gives_none():
    done = subprocess.run([sys.executable, "-W", "error", "-c", OLD], capture_output=True,
                          text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["UnstructuredGrid", "True"]

    assert pyvista_accessor.NAME == "odt"


def _installed(folder, there):
    """Environment in which the package is installed anew, with the entry points of its project."""
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
    info = folder / "odt_plugins-0.1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: odt-plugins\nVersion: 0.1.0\n")
    lines = [f"[{group}]\n" + "".join(f"{name} = {value}\n" for name, value in points.items())
             for group, points in project["entry-points"].items() if there]
    (info / "entry_points.txt").write_text("\n".join(lines))
    return os.environ | {"PYTHONPATH": os.pathsep.join([str(folder), *sys.path])}


WITHOUT_A_LINE = """
import sys, pyvista
tets = pyvista.ImageData(dimensions=(3, 3, 3)).to_tetrahedra()
print("odt" in dir(tets), "odt_plugins" in sys.modules)
if "odt" in dir(tets):
    print(tets.odt.quality().n_cells, pyvista.MultiBlock([tets]).odt.optimize().n_blocks)
    assert not hasattr(pyvista.ImageData(), "odt")
    import odt_plugins
    odt_plugins.register("pyvista")
"""


@pytest.mark.parametrize("there", [True, False])
def test_newer_versions_of_pyvista_find_the_accessor_without_a_line(tmp_path, there):
    done = subprocess.run([sys.executable, "-W", "error", "-c", WITHOUT_A_LINE],
                          capture_output=True, text=True, check=False, cwd=tmp_path,
                          env=_installed(tmp_path, there))
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == (["True", "False", "40", "1"] if there else ["False", "False"])


def _blocks():
    """Blocks of every kind: tetrahedra, nested too, and what stays beside them."""
    tets = contract.HOSTS["pyvista-tet"].make()
    inner = pyvista.MultiBlock({"deep": contract.HOSTS["pyvista-tet-float32"].make(), "none": None})
    blocks = pyvista.MultiBlock({"tets": tets, "skin": tets.extract_surface(algorithm=None),
                                 "image": pyvista.ImageData(dimensions=(2, 3, 4)), "inner": inner})
    blocks.field_data["recipe"] = np.arange(3)
    return blocks


def test_blocks_are_optimised_one_by_one():
    blocks, same = _blocks(), _blocks()
    told = []
    out, whole = odt_plugins.optimize_with_report(
        blocks, progress=lambda _, share: told.append(share))
    assert type(out) is pyvista.MultiBlock
    assert out.keys() == blocks.keys()
    assert out["inner"].keys() == ["deep", "none"]
    assert np.array_equal(out.field_data["recipe"], np.arange(3))
    for path in (["tets"], ["inner", "deep"]):
        mine, alone, old = out, same, blocks
        for key in path:
            mine, alone, old = mine[key], alone[key], old[key]
        assert mine == odt_plugins.optimize(alone)
        assert old == alone
        assert mine != old
    for key in ("skin", "image"):
        assert out[key] == blocks[key]
        assert out[key] is not blocks[key]
    assert out["inner"]["none"] is None
    assert [report.after.mean_quality > report.before.mean_quality for report in whole.parts] == [
        True, True]
    assert told == sorted(told)
    assert (told[0], told[-1]) == (0.0, 1.0)
    assert blocks.odt.optimize()["tets"] == out["tets"]


def test_tables_deep_in_a_multiblock_stay():
    inner = pyvista.MultiBlock({"table": pyvista.Table({"x": np.arange(3)}), "none": None})
    inner.add_field_data(["a"], "told")
    blocks = pyvista.MultiBlock({"tets": contract.HOSTS["pyvista-tet-float32"].make(),
                                 "inner": inner})
    blocks.field_data["time"] = [2.5]
    out = odt_plugins.optimize(blocks, smoothing={"rounds": 1}, finish=False)
    assert out.keys() == ["tets", "inner"]
    assert out["inner"].keys() == ["table", "none"]
    assert list(out["inner"].field_data["told"]) == ["a"]
    assert list(out.field_data["time"]) == [2.5]
    out["inner"]["table"]["x"][0] = 7
    assert list(inner["table"]["x"]) == [0, 1, 2]


def test_blocks_of_triangles_alone_are_optimised():
    plane = contract.HOSTS["pyvista-polydata"].make()
    blocks = pyvista.MultiBlock([plane, pyvista.Line()])
    out, whole = blocks.odt.optimize_with_report()
    assert out[0] == odt_plugins.optimize(plane)
    assert out[1] == blocks[1]
    assert len(whole.parts) == 1


def test_blocks_that_cannot_be_optimised_are_named():
    tets = contract.HOSTS["pyvista-tet"].make()
    broken = tets.copy()
    broken.points[0] = np.nan
    with pytest.raises(InvalidMeshError, match=r"^block 'two': .*finite"):
        odt_plugins.optimize(pyvista.MultiBlock({"one": tets, "two": broken}))
    with pytest.raises(InvalidOptionError, match="blocks that touch"):
        odt_plugins.optimize(pyvista.MultiBlock([tets, tets.copy()]), boundary="slide")
