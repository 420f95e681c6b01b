"""What bad input gets: one clear sentence of the right class, and the caller's object unchanged."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from fractions import Fraction

import contract
import numpy as np
import pytest
from scipy.spatial import Delaunay

import odt_plugins
from odt_plugins.adapters.host import KeptCells
from odt_plugins.adapters.kept import protect
from odt_plugins.errors import (
    InvalidMeshError,
    InvalidOptionError,
    UnsupportedMeshError,
    place_within,
)
from odt_plugins.mesh.facets import directed_facets, row_keys
from odt_plugins.mesh.plane import FLATNESS, plane_frame
from odt_plugins.mesh.simplex import simplex_mesh


def square():
    """Four triangles around the centre of a square, all positive."""
    points = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0.5, 0.4]], dtype=np.float64)
    return points, np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])


def cube():
    """Six tetrahedra of a unit cube, all positive."""
    points, cells, _ = contract.grid(3, 1)
    return points, cells


MESHES = {2: square, 3: cube}


def _set(part, where, value):
    def change(points, cells):
        points, cells = points.copy(), cells.copy()
        (points if part == "points" else cells)[where] = value
        return points, cells

    return change


def _flat_cell(points, cells):
    """Add a cell whose vertices lie in a line or plane."""
    d = points.shape[1]
    corner = points[cells[0, :d]]
    points = np.vstack([points, corner.mean(axis=0)])
    return points, np.vstack([cells, [*cells[0, :d], len(points) - 1]])


def _tangled(d, turn=np.asarray):
    """Cells around a vertex that was pulled out of a simplex: the first is inverted."""
    corners = np.vstack([np.zeros((1, d)), np.eye(d)])
    rows = np.tile(np.arange(d + 1), (d + 1, 1))
    np.fill_diagonal(rows, d + 1)
    return np.vstack([corners, np.full((1, d), 1.1 / d)]), turn(rows)


def _third(points, cells):
    """Add a cell on a facet that has two already, on either side."""
    key, _ = directed_facets(cells.astype(np.int32), len(points))
    shared = np.unique(key, return_counts=True)
    inner = shared[0][shared[1] == 2][0]
    row, column = np.argwhere(key == inner)[0]
    facet = np.delete(np.sort(cells[row]), column)
    points = np.vstack([points, points[cells[row]].mean(axis=0) + 0.01])
    new = np.array([*facet, len(points) - 1])
    if contract.volumes(points, [new])[0] < 0:
        new[:2] = new[1::-1]
    return points, np.vstack([cells, new])


def _folded(points, cells):
    """Keep one cell and add a second on the same side of one of its facets."""
    points = np.vstack([points, points[cells[0]].mean(axis=0)])
    return points, np.array([cells[0], [*cells[0][:-1], len(points) - 1]])


BAD_ARRAYS = {
    "object points": (lambda p, t: (p.astype(object), t), r"points have dtype object"),
    "complex points": (lambda p, t: (p + 0j, t), r"points have dtype complex128"),
    "integer points": (lambda p, t: (p.astype(int), t), r"dtype int64; expected float64"),
    "flat points": (lambda p, t: (p.ravel(), t), r"points have shape \(\d+,\); expected \(n, 2\)"),
    "one column": (lambda p, t: (p[:, :1], t), r"points have shape \(\d, 1\)"),
    "object cells": (lambda p, t: (p, t.astype(object)), r"cells have dtype object"),
    "complex cells": (lambda p, t: (p, t + 0j), r"cells have dtype complex128"),
    "boolean cells": (lambda p, t: (p, t > 0), r"cells have dtype bool"),
    "fractional cells": (lambda p, t: (p, t + np.where(np.arange(len(t)) > 1, 0.5, 0)[:, None]),
                         r"got [24] cells \(first: cell 2\).*not integers"),
    "nan cells": (lambda p, t: (p, np.where(t == 4, np.nan, t)), r"not integers"),
    "edges": (lambda p, t: (p, t[:, :2]), r"cells have shape \(\d, 2\).*expected \(m, 3\)"),
    "too many corners": (lambda p, t: (p, np.hstack([t, t])), r"cells have shape"),
    "no cells": (lambda p, t: (p, t[:0]), r"the mesh has no cells"),
    "nothing at all": (lambda p, t: (p[:0], t[:0]), r"no cells \(0 vertices\)"),
    "nan": (_set("points", [2, 3], np.nan), r"got 2 points \(first: point 2\) with NaN or inf"),
    "infinity": (_set("points", (3, 1), np.inf), r"got 1 point \(first: point 3\)"),
    "index too large": (_set("cells", (1, 2), 900), r"first: cell 1\).*vertex 900\); expected"),
    "negative index": (_set("cells", (2, 0), -1), r"got 1 cell \(first: cell 2\).*vertex -1\)"),
    "vertex twice": (lambda p, t: (p, np.vstack([t, t[0, [0, 0, *range(1, t.shape[1] - 1)]]])),
                     r"got 1 cell \(first: cell [46]\) with a vertex used twice"),
    "flat cell": (_flat_cell, r"got 1 cell \(first: cell [46]\) of [57] with zero (area|volume)"),
    "tangled": (lambda p, _: _tangled(p.shape[1]),
                r"overlapping a neighbour, also after turning 1 cell \(first: cell 0\) of [34] "
                r"like the others \(negative against positive (area|volume)\): both lie on the"),
    "tangled, most negative": (lambda p, _: _tangled(p.shape[1], contract.negative),
                               r"also after turning 1 cell \(first: cell 0\) of [34] like"),
    "repeated cell": (lambda p, t: (p, np.vstack([t, np.roll(t[1:2], 1 if t.shape[1] == 3 else 2,
                                                             axis=1)])),
                      r"got 1 cell \(first: cell [46]\) with the same vertices.*\(cell 1\)"),
    "three on a facet": (_third, r"1 (edge|face) belongs to more than two cells \(non-manifold\)"),
    "folded": (_folded, r"got 2 cells \(first: cell 0\) overlapping a neighbour"),
    "too small": (lambda p, t: (p * 1e-60, t), r"the mesh is 1\.0e-60 long"),
    "too large": (lambda p, t: (p * 1e60, t), r"the mesh is 1\.0e\+60 long"),
}


@pytest.mark.parametrize("case", BAD_ARRAYS)
def test_bad_mesh_is_refused_in_one_sentence(case, d):
    change, message = BAD_ARRAYS[case]
    points, cells = change(*MESHES[d]())
    before = points.tobytes(), cells.tobytes()
    with pytest.raises(InvalidMeshError, match=message) as caught:
        odt_plugins.optimize((points, cells), repair="none")
    assert "\n" not in str(caught.value)
    assert (points.tobytes(), cells.tobytes()) == before


@pytest.mark.parametrize("case", ["nan", "index too large", "no cells", "tangled"])
@pytest.mark.parametrize("kind", ["meshio", "pyvista"])
def test_bad_mesh_in_an_object_is_refused_as_well(case, kind, d):
    change, message = BAD_ARRAYS[case]
    points, cells = change(*MESHES[d]())
    if kind == "meshio":
        import meshio

        mesh = meshio.Mesh(points, [("triangle" if d == 2 else "tetra", cells)])
    else:
        pyvista = pytest.importorskip("pyvista")
        space = np.zeros((len(points), 3))
        space[:, :d] = points
        flat = np.insert(cells, 0, d + 1, axis=1).ravel()
        mesh = pyvista.UnstructuredGrid(flat, np.full(len(cells), 5 if d == 2 else 10), space)
    with pytest.raises(InvalidMeshError, match=message):
        odt_plugins.optimize(mesh, repair="none")


BAD_OPTIONS = {
    "unknown": ({"metod": "odt"}, r"unknown options \['metod'\].*did you mean 'method'\?"),
    "method": ({"method": "ODT"}, r"got method='ODT'; expected one of \('odt', 'cpt'"),
    "method type": ({"method": np.arange(3)}, r"got method=.*expected one of"),
    "solver": ({"smoothing": {"solver": "sor"}},
               r"got smoothing={'solver': 'sor'}; expected one of"),
    "connectivity": ({"smoothing": {"connectivity": None}},
                     r"got smoothing={'connectivity': None}; expected one of"),
    "repair": ({"repair": True}, r"got repair=True; expected one of \('auto', 'orient', 'none'\)"),
    "boundary": ({"boundary": "free"}, r"expected one of \('fixed', 'slide'\)"),
    "density name": ({"density": "fine"}, r"got density='fine'; expected one of \('keep'"),
    "density zero": ({"density": np.array([1.0, 0, 1, 1, 1, 1, 1, 1])}, r"densit"),
    "density negative": ({"density": np.array([1.0, 1, 1, 1, 1, 1, 1, -1])}, r"densit"),
    "density nan": ({"density": np.array([1.0, 1, 1, np.nan, 1, 1, 1, 1])}, r"densit"),
    "density length": ({"density": np.ones(17)}, r"densit.*17"),
    "exponent": ({"smoothing": {"exponent": -2.0}},
                 r"got smoothing={'exponent': -2.0}; expected a positive number"),
    "exponent unused": ({"smoothing": {"exponent": 3.0}, "density": "uniform"},
                        r"unless density is 'keep'"),
    "linear solver unused": ({"smoothing": {"linear_solver": "amg"}}, r"unless solver is 'global'"),
    "rounds": ({"smoothing": {"rounds": -1}},
               r"got smoothing={'rounds': -1}; expected an integer of at least 0"),
    "smoothing": ({"smoothing": 3},
                  r"got smoothing=3; expected a dict with some of \['solver', 'c"),
    "smoothing name": ({"smoothing": {"omgea": 1}}, r"unknown values of smoothing.*mean 'omega'"),
    "place of rounds": ({"rounds": 3}, r"unknown options \['rounds'\].*try smoothing={'rounds'"),
    "rounds type": ({"smoothing": {"rounds": 2.5}},
                    r"got smoothing={'rounds': 2.5}; expected an integer"),
    "place of solver": ({"solver": "global"},
                        r"unknown options.*, try smoothing={'solver': \.\.\.}"),
    "place of layers": ({"layers": True}, r"unknown options \['layers'\].*, try free='layers'"),
    "near": ({"boundry": "slide"}, r"\['boundry'\].*, did you mean 'boundary'\?$"),
    "of another tool": ({"hausd": 0.1}, r"\['hausd'\].*, did you mean 'envelope'\?$"),
    "rounds of others": ({"iterations": 3}, r"iterations.*, try smoothing={'rounds': \.\.\.}$"),
    "size": ({"size": 0.1}, r"unknown options \['size'\].*'progress'\], try remesh$"),
    "nothing near": ({"colour": 1}, r"unknown options \['colour'\].*'progress'\]$"),
    "threads": ({"threads": 0}, r"got threads=0; expected an integer of at least 1"),
    "threads type": ({"threads": True}, r"got threads=True"),
    "finish": ({"finish": "yes"}, r"got finish='yes'; expected a bool"),
    "insert": ({"insert": "yes"}, r"got insert='yes'; expected a bool, or a number above 0"),
    "insert no share": ({"insert": 0.0}, r"got insert=0.0; expected a bool, or a number above 0"),
    "insert too many": ({"insert": 1e300}, r"got insert=1e\+300; expected a bool.* at most 1000"),
    "threads too many": ({"threads": 2**63}, r"got threads=9.*; expected an integer of at most 2"),
    "cycles too large": ({"smoothing": {"cycles": 10**400}}, r"got cycles of a number with more"),
    "metric too large": ({"metric": 8 * [10**400]}, r"got a metric.* too large.*; expected one"),
    "target no path": ({"target": 3}, r"got target=3; expected a path"),
    "format without file": ({"file_format": np.ones(99)}, r"got file_format= of type ndarray; "),
    "workers": ({"workers": np.ones(2)}, r"got workers=array.*; expected an integer of at least 0"),
    "workers of blocks": ({"blocks": 2, "workers": "4"}, r"got workers='4'; expected an integer"),
    "client alone": ({"client": np.ones(2)}, r"got client= without blocks; expected blocks="),
    "client": ({"blocks": 2, "client": 3}, r"got client=3; expected a distributed.Client"),
    "keep": ({"keep": ("mean",)}, r"got keep=\('mean',\); expected some of \('min_quality'"),
    "keep string": ({"keep": "quality"}, r"got keep='quality'; expected some of"),
    "progress": ({"progress": 3}, r"got progress=3; expected None, True or a callable"),
    "regions length": ({"regions": np.zeros(3, int)}, r"regions have shape \(3,\); .* \(6,\)"),
    "regions float": ({"regions": np.full(6, 0.5)}, r"regions have dtype float64; expected who"),
    "regions NaN": ({"regions": np.array([1, 1, np.nan, 2, 2, 2])},
                    r"float64 and NaN; .* try numpy\.nan_to_num\(regions, nan=-1\)\.astype\(int\)"),
    "regions name": ({"regions": "rock"}, r"regions='rock' names no cell array"),
    "fixed length": ({"fixed": np.zeros(3, bool)}, r"fixed is a mask of shape \(3,\); .*\(8,\)"),
    "fixed index": ({"fixed": [1, 9, 8]}, r"fixed\[1\] is 9 \(2 out of range\).*0 to 7"),
    "fixed negative": ({"fixed": [-1]}, r"fixed\[0\] is -1"),
    "fixed type": ({"fixed": [0.5]}, r"fixed has dtype float64.*boolean mask"),
    "fixed table": ({"fixed": np.zeros((2, 2), int)}, r"fixed has dtype int64 and shape \(2, 2\)"),
    "fixed uneven": ({"fixed": [[1], [2, 3]]}, r"got fixed with rows of several lengths; expected"),
    "selection uneven": ({"selection": [1, [2]]}, r"got selection with rows of several lengths"),
    "regions uneven": ({"regions": [1, [2]]}, r"got regions with rows of several lengths"),
    "envelope array": ({"envelope": np.ones((99, 3))}, r"got envelope= of type ndarray; expected"),
    "threads list": ({"threads": list(range(99))}, r"got threads= of type list; expected an int"),
    "blocks array": ({"blocks": np.ones(99)}, r"got blocks= of type ndarray; expected an integer"),
    "fixed zeros and ones": ({"fixed": np.arange(8, dtype=np.uint8) % 2},
                             r"fixed with 8 numbers that all are 0 or 1.*fixed.astype\(bool\)"),
    "fixed zeros and others": ({"fixed": [0, 7, 7, 0, 0, 7, 0, 0]},
                               r"fixed with 8 numbers that all are 0 or 7, .*fixed.astype\(bool"),
    "selection zeros and ones": ({"selection": [0, 1, 1, 0, 1, 0]}, r"selection with 6 numbers"),
    "selection length": ({"selection": np.ones(8, bool)}, r"selection is a mask .*\(6,\)"),
    "selection index": ({"selection": [6]}, r"selection\[0\] is 6.*cells from 0 to 5"),
}


@pytest.mark.parametrize("case", BAD_OPTIONS)
def test_bad_option_is_refused_in_one_sentence(case):
    options, message = BAD_OPTIONS[case]
    if case == "client":
        pytest.importorskip("dask")
    points, cells = cube()
    before = points.tobytes(), cells.tobytes()
    with pytest.raises(InvalidOptionError, match=message) as caught:
        odt_plugins.optimize((points, cells), **options)
    assert "\n" not in str(caught.value)
    assert (points.tobytes(), cells.tobytes()) == before


def test_an_unknown_cell_array_is_answered_with_those_that_are_there():
    mesh = contract.HOSTS["meshio-tet"].make()
    with pytest.raises(InvalidOptionError, match=r"'marker', 'origin', 'stress'"):
        odt_plugins.optimize(mesh, regions="rock")
    mesh.cell_data.clear()
    with pytest.raises(InvalidOptionError, match="the mesh has none; expected an array of integer"):
        odt_plugins.optimize(mesh, regions="rock")


class Stranger:
    """An object of no known kind."""


@pytest.mark.parametrize("mesh", [Stranger(), None, 3])
def test_unknown_objects_are_named(mesh):
    with pytest.raises(UnsupportedMeshError, match=rf"{type(mesh).__name__}; expected a \(points"):
        odt_plugins.optimize(mesh)


@pytest.mark.parametrize(("mesh", "said"), [
    ((np.eye(3),), r"got a tuple of 1 part \(ndarray\); expected two or three, \(points, cells\) "),
    ([1, "a", None, 2], r"got a list of 4 parts \(int, str, NoneType, ...\)"),
    ((np.eye(3), 3), r"got a tuple of 2 parts \(ndarray, int\).* try numpy.asarray on each"),
])
def test_a_sequence_is_named_by_its_parts(mesh, said):
    for function in (odt_plugins.optimize, odt_plugins.quality):
        with pytest.raises(UnsupportedMeshError, match=said):
            function(mesh)


def others():
    """Meshes of other toolkits by their names."""
    from matplotlib.tri import Triangulation
    from scipy.spatial import Delaunay

    mmg = pytest.importorskip("mmgpy")
    points = np.random.default_rng(5).random((30, 2))
    flat = np.column_stack([points, np.zeros(30)])
    tets = Delaunay(np.random.default_rng(6).random((30, 3)))
    return {
        "scipy": Delaunay(points), "matplotlib": Triangulation(*points.T),
        "mmgpy": mmg.MmgMeshS(flat, Delaunay(points).simplices.astype(np.int32)),
        "mmgpy in space": mmg.MmgMesh3D(tets.points, tets.simplices.astype(np.int32)),
        "triangle": {"vertices": points, "triangles": Delaunay(points).simplices},
    }


def test_hints_for_objects_of_other_toolkits_lead_to_a_mesh():
    for name, mesh in others().items():
        with pytest.raises(UnsupportedMeshError) as caught:
            odt_plugins.optimize(mesh)
        way = str(caught.value).rpartition(", try ")[2]
        assert odt_plugins.quality(eval(way, {"mesh": mesh, "numpy": np})).n_cells > 1, name


@pytest.mark.parametrize("module", ["open3d.pybind.geometry", "vtkmodules", "trimesh"])
def test_objects_of_other_toolkits_get_a_hint(module):
    mesh = type("Mesh", (), {"__module__": module})()
    with pytest.raises(UnsupportedMeshError, match=r"try .*(TetraMesh|wrap|faces)"):
        odt_plugins.optimize(mesh)


def test_hints_for_other_objects_of_pyvista_lead_to_a_mesh():
    pyvista = pytest.importorskip("pyvista")
    image = pyvista.ImageData(dimensions=(3, 3, 3))
    for mesh in (image, image.cast_to_structured_grid(), pyvista.MultiBlock([image])):
        with pytest.raises(UnsupportedMeshError, match=r"try mesh\.\S+$") as caught:
            odt_plugins.optimize(mesh)
        way = str(caught.value).rpartition("try mesh.")[2]
        assert way.endswith("().triangulate()")
        grid = getattr(mesh, way.partition("(")[0])().triangulate()
        assert odt_plugins.quality(grid).n_cells >= 40


@pytest.mark.parametrize("kind", ["tetra10", "triangle6", "line3", "hexahedron20"])
def test_quadratic_meshio_cells_beside_linear_ones_are_refused_by_name(kind):
    import meshio

    nodes = int("".join(filter(str.isdigit, kind)))
    points = np.random.default_rng(0).random((max(nodes, 4), 3))
    mesh = meshio.Mesh(points, [("tetra", [[0, 1, 2, 3]]), (kind, [list(range(nodes))])])
    with pytest.raises(UnsupportedMeshError, match=rf"got 1 cell of type {kind}"):
        odt_plugins.optimize(mesh)


def test_quadratic_grid_cells_beside_linear_ones_are_refused_by_name():
    pyvista = pytest.importorskip("pyvista")
    points = np.random.default_rng(0).random((10, 3))
    grid = pyvista.UnstructuredGrid({10: np.arange(4)[None], 24: np.arange(10)[None]}, points)
    with pytest.raises(UnsupportedMeshError, match=r"QUADRATIC_TETRA \(first: cell 1\)"):
        odt_plugins.optimize(grid)


def test_meshes_with_nothing_to_optimise_are_refused_by_name():
    import meshio

    pyvista = pytest.importorskip("pyvista")
    box = np.array([[0, 1, 3, 2, 4, 5, 7, 6]])
    corners = contract.grid(3, 1)[0]
    with pytest.raises(UnsupportedMeshError, match="cells of hexahedron; expected tetra"):
        odt_plugins.optimize(meshio.Mesh(corners, [("hexahedron", box)]))
    with pytest.raises(UnsupportedMeshError, match="1 cell of type hexahedron; expected tetrahe"):
        odt_plugins.optimize(pyvista.UnstructuredGrid({12: box}, corners))
    with pytest.raises(UnsupportedMeshError, match=r"6 other polygons; .*triangulate"):
        odt_plugins.optimize(pyvista.Cube())
    with pytest.raises(UnsupportedMeshError, match="PolyData of 2 vertex cells and 0 line cells"):
        odt_plugins.optimize(pyvista.PolyData(np.eye(3)[:2]))
    with pytest.raises(InvalidMeshError, match="no cells"):
        odt_plugins.optimize(pyvista.UnstructuredGrid())
    with pytest.raises(InvalidMeshError, match="no cells"):
        odt_plugins.optimize(pyvista.PolyData())
    with pytest.raises(InvalidMeshError, match="no cells"):
        odt_plugins.optimize(meshio.Mesh(corners, []))


@pytest.mark.parametrize("most", [False, True])
def test_cells_of_mixed_orientation_are_turned(d, most):
    points, cells, _ = contract.grid(d, 4)
    some = np.random.default_rng(3).random(len(cells)) < 0.8 if most else cells[:, 0] % 3 == 0
    mixed = np.where(some[:, None], contract.negative(cells), cells)
    mesh, orientation = simplex_mesh(points, mixed)
    assert orientation == 1
    assert mesh.turned == some.sum()
    assert (contract.volumes(mesh.points, mesh.cells) > 0).all()
    assert np.array_equal(mesh.cells[~some], mixed[~some])
    assert np.array_equal(np.sort(mesh.cells, axis=1), np.sort(mixed, axis=1))
    out, report = odt_plugins.optimize_with_report((points, mixed))
    assert (contract.volumes(*out) > 0).all()
    alike, plain = odt_plugins.optimize_with_report((points, mesh.cells))
    assert np.array_equal(out[0], alike[0])
    assert np.array_equal(out[1], alike[1])
    assert (report.before.turned, report.after.turned) == (some.sum(), 0)
    assert re.search(rf"(?m)^cells turned +{some.sum()} +0$", str(report))
    assert "cells turned" not in str(plain)
    assert odt_plugins.quality((points, mixed)) == report.before
    assert replace(report.before, turned=0) == plain.before


def test_delaunay_cells_of_scipy_are_taken_as_they_are(d):
    points = np.random.default_rng(6).random((60, d))
    cells = Delaunay(points).simplices
    volumes = contract.volumes(points, cells) / math.factorial(d)
    figures = odt_plugins.quality((points, cells))
    assert (figures.inverted, figures.turned) == (0, (volumes < 0).sum())
    assert np.isclose(figures.volume, np.abs(volumes).sum())
    assert (contract.volumes(*odt_plugins.optimize((points, cells))) > 0).all()


@pytest.mark.parametrize("place", [0.0, 0.3])
@pytest.mark.parametrize("share", [0.2, 0.8])
def test_triangles_in_a_plane_in_space_keep_the_side_of_most(place, share):
    flat, cells, _ = contract.grid(2, 4)
    points = np.column_stack([flat, place * flat[:, 0]])
    some = np.random.default_rng(4).random(len(cells)) < share
    mixed = np.where(some[:, None], contract.negative(cells), cells)
    (_, out), report = odt_plugins.optimize_with_report((points, mixed))
    side = contract.volumes(flat, out)
    assert (side < 0).all() if share > 0.5 else (side > 0).all()
    against = min(some.sum(), (~some).sum())
    assert report.before.turned == odt_plugins.quality((points, mixed)).turned == against


def test_figures_of_a_tangled_mesh_count_its_inverted_cells(d):
    for turn in (np.asarray, contract.negative):
        figures = odt_plugins.quality(_tangled(d, turn))
        assert (figures.inverted, figures.turned) == (1, 0)


def test_flat_cells_do_not_keep_a_mesh_from_being_measured_as_turned(d):
    points, cells = _flat_cell(*MESHES[d]())
    rows = np.vstack([contract.negative(cells[:2]), cells[2:]])
    figures = odt_plugins.quality((points, rows))
    assert (figures.turned, figures.min_quality < 1e-12) == (2, True)
    with pytest.raises(InvalidMeshError, match=r"1 cell .* with zero (area|volume)"):
        odt_plugins.optimize((points, rows), repair="none")


def test_uniformly_negative_cells_are_valid(d):
    points, cells = MESHES[d]()
    mesh, orientation = simplex_mesh(points, contract.negative(cells))
    assert orientation == -1
    assert (contract.volumes(mesh.points, mesh.cells) > 0).all()


def test_turning_does_not_hide_overlapping_cells(d):
    points, cells = _folded(*MESHES[d]())
    with pytest.raises(InvalidMeshError, match="overlapping"):
        simplex_mesh(points, np.vstack([contract.negative(cells[:1]), cells[1:]]))


def test_unused_vertices_are_kept(d):
    points, cells = MESHES[d]()
    far = np.vstack([np.full((1, d), 50.0), points, np.full((2, d), -3.0)])
    out_points, out_cells = odt_plugins.optimize((far, cells + 1))
    assert out_points[[0, -2, -1]].tobytes() == far[[0, -2, -1]].tobytes()
    assert out_cells.min() == 1


@pytest.mark.parametrize("place", [1e250, 1.7e308])
def test_unused_vertices_may_be_anywhere(place, d):
    points, cells, _ = contract.grid(d, 3)
    far = np.vstack([np.full((1, d), -place), points, np.full((1, d), place)])
    near = odt_plugins.optimize((points, cells))
    out_points, out_cells = odt_plugins.optimize((far, cells + 1))
    assert out_points[1:-1].tobytes() == near[0].tobytes()
    assert np.array_equal(out_cells - 1, near[1])
    assert out_points[[0, -1]].tobytes() == far[[0, -1]].tobytes()
    expected = replace(odt_plugins.quality((points, cells)), n_points=len(far))
    assert odt_plugins.quality((far, cells + 1)) == expected


def test_many_crowded_facets_are_counted():
    points = np.vstack([np.eye(3), np.zeros((1, 3)), 2.0 * np.ones((3, 3)) + np.eye(3)])
    points[5] *= 1.5
    cells = np.array([[3, 0, 1, 2], [0, 1, 2, 4], [0, 1, 2, 5], [0, 1, 4, 3], [0, 1, 4, 6]])
    with pytest.raises(InvalidMeshError, match="2 faces belong to more than two cells"):
        simplex_mesh(points, cells)


@pytest.mark.parametrize("density", [np.ones(5) + 1j, np.array(["1.0"] * 5),
                                     lambda x: np.ones(len(x)) * (1 + 2j)])
def test_densities_that_are_no_real_numbers_are_refused(density):
    with pytest.raises(InvalidOptionError, match=r"dtype (complex128|<U3) .* real numbers"):
        odt_plugins.optimize(square(), density=density)


def test_non_manifold_boundary_edges_and_points_are_allowed():
    points, cells = cube()
    shifted = points + np.array([1.0, 1.0, 0.0])
    glue = np.arange(len(points)) + len(points)
    for i, p in enumerate(shifted):
        same = np.flatnonzero((points == p).all(axis=1))
        if same.size:
            glue[i] = same[0]
    both = np.vstack([points, shifted]), np.vstack([cells, glue[cells]])
    assert (glue < len(points)).sum() == 2
    mesh, _ = simplex_mesh(*both)
    assert len(mesh.cells) == 2 * len(cells)


@pytest.mark.parametrize("scale", [1e-35, 1e-6, 1.0, 1e35])
def test_flatness_is_relative_to_the_cell(scale, d):
    points, cells = MESHES[d]()
    corner = points[cells[0, :d]].mean(axis=0)
    inside = points[cells[0]].mean(axis=0) - corner
    for height, good in ((1e-9, True), (1e-17, False)):
        thin = np.vstack([points[cells[0, :d]] - corner, height * inside]) * scale
        cell = np.arange(d + 1)[None]
        if good:
            simplex_mesh(thin, cell)
        else:
            with pytest.raises(InvalidMeshError, match="zero"):
                simplex_mesh(thin, cell)


def test_labels_are_compacted_in_order_whatever_their_type():
    points, cells = cube()
    for labels in ([2**63, 5, 5, 0, 5, 2**63], [-7.0, -9, -9, -10, -9, -7], [3, 1, 1, 0, 1, 3]):
        array = np.array(labels, dtype=np.uint64 if labels[0] > 3 else None)
        mesh, _ = simplex_mesh(points, cells, regions=array)
        assert mesh.regions.tolist() == [2, 1, 1, 0, 1, 2]
        assert mesh.regions.dtype == np.int32


def test_float_cells_of_integers_come_back_as_floats():
    points, cells = square()
    out = odt_plugins.optimize((points, cells.astype(np.float64)))
    assert out[1].dtype == np.float64


def test_row_keys_tell_rows_apart_even_when_numbers_are_large():
    rows = np.random.default_rng(0).integers(0, 7, size=(400, 4))
    truth = np.unique(rows, axis=0, return_inverse=True)[1].ravel()
    for n in (7, 2**31 - 1):
        keys = row_keys(rows * (n // 7), n)
        assert np.array_equal(np.unique(keys, return_inverse=True)[1].ravel(), truth)


def test_the_two_sides_of_a_facet_differ(d):
    points, cells, _ = contract.grid(d, 3)
    key, side = directed_facets(cells.astype(np.int32), len(points))
    assert key.shape == side.shape == cells.shape
    found: dict[int, list[int]] = {}
    for k, s in zip(key.ravel().tolist(), side.ravel().tolist(), strict=True):
        found.setdefault(k, []).append(s)
    boundary = contract.facets(cells, np.zeros(len(cells), int))
    assert sum(len(s) == 1 for s in found.values()) == len(boundary)
    assert all(sorted(s) == [0, 1] for s in found.values() if len(s) == 2)


def test_kept_faces_part_regions_only_inside(d):
    points, cells, labels = contract.grid(d, 4)
    mesh, _ = simplex_mesh(points, cells, regions=labels)
    every = contract.facets(cells, np.arange(len(cells)))
    staying = contract.facets(cells, labels)
    inner = sorted(every - staying)[5:8]
    free = protect(mesh, (KeptCells("triangle", np.array(sorted(staying))),))
    assert np.array_equal(free.regions, mesh.regions)
    assert not free.fixed.any()
    held = protect(mesh, (KeptCells("triangle", np.array(inner)),))
    assert set(inner) <= contract.facets(mesh.cells, held.regions)
    assert staying <= contract.facets(mesh.cells, held.regions)
    assert contract.facets(mesh.cells, held.bodies()) == staying
    assert not held.frozen.any()
    assert set(np.flatnonzero(held.fixed)) == set(np.ravel(inner))
    loose = protect(mesh, (KeptCells("triangle", np.array(inner)),), free=True)
    assert np.array_equal(loose.regions, held.regions)
    assert not loose.fixed.any()
    assert loose.anchored[np.array(inner)].all()
    with pytest.raises(InvalidMeshError, match=r"got 1 line cell with vertex indices out of"):
        protect(mesh, (KeptCells("line", np.array([[0, 1], [2, 5000]])),))


def test_plane_frame_of_axis_aligned_planes_keeps_bits():
    points, cells, _ = contract.grid(2, 4)
    for axis in range(3):
        space = np.insert(points, axis, 1.0 / 3.0, axis=1)
        frame = plane_frame(space, cells)
        flat = frame.to_plane(space)
        assert flat.tobytes() == points.tobytes()
        assert frame.to_space(flat).tobytes() == space.tobytes()


@pytest.mark.parametrize("seed", range(4))
def test_plane_frame_is_an_isometry_that_keeps_orientation(seed):
    points, cells, _ = contract.grid(2, 4)
    rng = np.random.default_rng(seed)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    space = 100.0 * points @ turn[:2] + rng.normal(size=3)
    half = np.arange(len(cells)) % 2 == 0
    mixed = np.where(half[:, None], cells, contract.negative(cells))
    for rows, signs in ((cells, 1), (contract.negative(cells), 1), (mixed, 2)):
        frame = plane_frame(space, rows)
        flat = frame.to_plane(space)
        distance = np.linalg.norm(space[:, None] - space, axis=2)
        assert np.linalg.norm(flat[:, None] - flat, axis=2) == pytest.approx(distance, abs=1e-11)
        assert frame.to_space(flat) == pytest.approx(space, abs=1e-11)
        assert len(np.unique(np.sign(contract.volumes(flat, rows)))) == signs


def test_plane_frame_of_triangles_that_cancel():
    space = np.array([[0.0, 0, 0], [1, 2, 0], [1, 3, 1], [0, 1, 1]])
    frame = plane_frame(space, np.array([[0, 1, 2], [0, 3, 2]]))
    assert frame.to_space(frame.to_plane(space)) == pytest.approx(space, abs=1e-14)


def test_plane_tolerance_is_relative_to_the_diagonal():
    points, cells, _ = contract.grid(2, 4)
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    for scale in (1e-3, 1e3):
        for bump, good in ((0.3, True), (3.0, False)):
            space = np.column_stack([points, np.zeros(len(points))])
            space[12, 2] = bump * FLATNESS * np.sqrt(2.0)
            space = scale * space @ turn
            if good:
                plane_frame(space, cells)
            else:
                assert plane_frame(space, cells) is None


def test_degenerate_triangles_in_space_are_refused():
    line = np.linspace([0.0, 0, 0], [1.0, 2, 3], 3)
    with pytest.raises(InvalidMeshError, match="zero area"):
        odt_plugins.optimize((line, np.array([[0, 1, 2]])))


@pytest.mark.parametrize("options", [
    {"cells": np.int8(100)}, {"cells": np.uint8(200)}, {"vertices": np.int8(100)},
    {"scale": np.longdouble(0.75)}, {"scale": Fraction(3, 4)}])
def test_small_numbers_of_numpy_ask_for_what_plain_ones_do(options):
    plain = {name: float(value) if name == "scale" else int(value)
             for name, value in options.items()}
    mesh = contract.grid(3, 6)[:2]
    points, cells = odt_plugins.remesh(mesh, **options)
    alike = odt_plugins.remesh(mesh, **plain)
    assert (len(points), len(cells)) == (len(alike[0]), len(alike[1]))
    assert np.array_equal(points, alike[0])


@pytest.mark.parametrize("options", [
    {"ratio": np.int16(1000)}, {"ratio": np.float16(1000)}, {"norm": np.float16(2)}])
def test_small_numbers_of_numpy_make_the_metric_that_plain_ones_do(options):
    points, cells, _ = contract.grid(3, 4)
    found, alike = (odt_plugins.metric_from_field((points, cells), points[:, 0]**2, 200, **one)
                    for one in (options, {name: int(value) for name, value in options.items()}))
    assert np.array_equal(found, alike)


def test_small_numbers_of_numpy_count_threads_blocks_and_levels():
    mesh = contract.grid(3, 3)[:2]
    for options in ({"threads": np.int16(2)}, {"blocks": np.int64(1)}):
        assert len(odt_plugins.optimize(mesh, **options)[1])
    assert len(odt_plugins.refine(mesh, np.int8(1))[1]) > len(mesh[1])


@pytest.mark.parametrize(("verb", "options", "message"), [
    (odt_plugins.remesh, {"size": [[1], [2, 3]]}, r"got size with rows of several lengths"),
    (odt_plugins.remesh, {"scale": np.ones((99, 3))}, r"got scale= of type ndarray; expected a n"),
    (odt_plugins.untangle, {"rest": [[1], [2, 3]]}, r"got rest with rows of several lengths"),
    (odt_plugins.untangle, {"rest": [[[1], 2, 3]]}, r"got rest with rows of several lengths"),
    (odt_plugins.refine, {"levels": np.ones((99, 3))}, r"got levels= of type ndarray; expected"),
    (odt_plugins.refine, {"edge_length": np.ones((99, 3))}, r"got edge_length= of type ndarray"),
    (odt_plugins.refine, {"optimize": np.ones(3)}, r"got optimize=array.*; expected a bool"),
    (odt_plugins.untangle, {"partial": "no"}, r"got partial='no'; expected a bool"),
    (odt_plugins.refine, {"levels": 2**40}, r"got levels=1099511627776; expected an .* at most 31"),
    (odt_plugins.remesh, {"size": 10**400}, r"got size of a number with more than 308 digits"),
    (odt_plugins.remesh, {"size": 8 * [10**400]}, r"got sizes.* too large"),
    (odt_plugins.remesh, {"cells": 10**400}, r"got cells of a number with more than 308 digits"),
    (odt_plugins.remesh, {"scale": Fraction(10**400)}, r"got scale of a number with more than 308"),
    (odt_plugins.remesh, {"scale": 1, "most_cells": None}, r"got most_cells=None; expected an int"),
    (odt_plugins.optimize, {"insert": 10**400}, r"got insert of a number with more than 308 dig"),
])
def test_other_verbs_tell_long_and_uneven_values_in_one_sentence(verb, options, message):
    with pytest.raises(InvalidOptionError, match=message) as caught:
        verb(cube(), **options)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("extent", "place", "told"), [
    (2.0, (-2.6e-17, -0.64961, 0.0), "0, -0.6496, 0"),
    (2e-20, (3.25e-21, -1e-37, 1e-20), "3.25e-21, 0, 1e-20"),
    (1.0, (1e6 + 0.25, 1e-14, -0.0), "1000000.25, 1e-14, 0"),
])
def test_a_place_is_told_without_what_rounding_leaves(extent, place, told):
    assert place_within(extent, place) == told
