"""open3d: what the contract does not see - normals, textures, devices - and the filters."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys
import warnings

import contract
import numpy as np
import pytest

import odt_plugins
from odt_plugins.adapters import open3d_mesh
from odt_plugins.adapters.host import Result
from odt_plugins.adapters.wedges import carried, charts
from odt_plugins.engine.run import plan
from odt_plugins.errors import (
    InvalidMeshError,
    InvalidOptionError,
    ODTWarning,
    TangledMeshError,
    UnsupportedMeshError,
)
from odt_plugins.hosts import open3d_filters
from odt_plugins.options import OPTIONS

open3d = pytest.importorskip("open3d")

KINDS = ("triangle", "tetra", "tensor")


@pytest.fixture
def _churn(monkeypatch):
    monkeypatch.setattr(plan, "run", contract.churn)


def make(kind):
    return contract.HOSTS[f"open3d-{kind}"].make()


def view(kind, mesh):
    return contract.HOSTS[f"open3d-{kind}"].view(mesh)


def tilted(kind, n=4):
    """A planar mesh that is parallel to no axis, without any data; and its unit normal."""
    points, cells, _ = contract.grid(2, n)
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    turn[2] = np.cross(turn[0], turn[1])
    space = points @ turn[:2]
    if kind == "tensor":
        return open3d.t.geometry.TriangleMesh(space, cells.astype(np.int32)), turn[2]
    return open3d.geometry.TriangleMesh(open3d.utility.Vector3dVector(space),
                                        open3d.utility.Vector3iVector(cells)), turn[2]


def normals(mesh):
    """Normals of vertices and triangles, empty where there are none."""
    if open3d_mesh.is_tensor(mesh):
        return [values["normals"].numpy() if "normals" in values else np.zeros((0, 3))
                for values in (mesh.vertex, mesh.triangle)]
    return [np.asarray(mesh.vertex_normals), np.asarray(mesh.triangle_normals)]


@pytest.mark.usefixtures("_churn")
@pytest.mark.parametrize("kind", ["triangle", "tensor"])
@pytest.mark.parametrize("which", ["none", "triangles", "vertices", "both"])
def test_normals_are_computed_anew_if_they_were_there(kind, which, capfd):
    mesh, normal = tilted(kind)
    if which in ("vertices", "both"):
        mesh.compute_vertex_normals()
    elif which == "triangles":
        mesh.compute_triangle_normals()
    if which == "vertices" and kind == "tensor":
        del mesh.triangle["normals"]
    elif which == "vertices":
        mesh.triangle_normals = open3d.utility.Vector3dVector()
    capfd.readouterr()
    out = odt_plugins.optimize(mesh)
    n, m = view_sizes(out)
    assert m == view_sizes(mesh)[1]
    for old, new, count in zip(normals(mesh), normals(out), (n, m), strict=True):
        assert len(new) == (count if len(old) else 0)
        assert new == pytest.approx(np.tile(normal, (len(new), 1)), abs=1e-12)
        assert new.dtype == old.dtype
    assert capfd.readouterr().out == ""


def view_sizes(mesh):
    if open3d_mesh.is_tensor(mesh):
        return len(mesh.vertex.positions), len(mesh.triangle.indices)
    return len(mesh.vertices), len(mesh.triangles)


@pytest.mark.usefixtures("_churn")
def test_normals_of_other_kinds_of_numbers_keep_theirs():
    mesh, normal = tilted("tensor")
    mesh.compute_vertex_normals()
    for values in (mesh.vertex, mesh.triangle):
        values["normals"] = values["normals"].to(open3d.core.float32)
    out = odt_plugins.optimize(mesh)
    for new in normals(out):
        assert new.dtype == np.float32
        assert new == pytest.approx(np.tile(normal, (len(new), 1)), abs=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_a_mesh_that_does_not_change_keeps_its_own_normals(kind):
    mesh = make(kind)
    strange = np.random.default_rng(2).normal(size=(len(view(kind, mesh).points), 3))
    if kind == "tensor":
        mesh.vertex["normals"] = strange
    else:
        mesh.vertex_normals = open3d.utility.Vector3dVector(strange)
    out = odt_plugins.optimize(mesh, fixed=np.arange(len(strange)),
                               smoothing={"connectivity": "none"}, finish=False)
    assert out is not mesh
    kept = out.vertex.normals.numpy() if kind == "tensor" else np.asarray(out.vertex_normals)
    assert kept.tobytes() == strange.tobytes()
    assert contract.same_bits(view(kind, mesh), view(kind, out))


@pytest.mark.usefixtures("_churn")
def test_the_adjacency_list_is_that_of_the_new_triangles():
    mesh = make("triangle")
    mesh.compute_adjacency_list()
    out = odt_plugins.optimize(mesh)
    truth = [set() for _ in range(len(out.vertices))]
    for row in np.asarray(out.triangles).tolist():
        for v in row:
            truth[v] |= set(row) - {v}
    assert list(out.adjacency_list) == truth
    assert list(mesh.adjacency_list) != truth
    assert not odt_plugins.optimize(make("triangle")).has_adjacency_list()


def unfolded(points, cells, charts_of):
    """Texture coordinates of wedges that are an affine map on every chart."""
    x = points[cells][:, :, :2]
    return x * 0.5 + 10.0 * np.asarray(charts_of)[:, None, None]


@pytest.mark.usefixtures("_churn")
@pytest.mark.parametrize("kind", ["triangle", "tensor"])
def test_texture_coordinates_follow_and_seams_stay(kind):
    mesh = make(kind)
    before = view(kind, mesh)
    chart = (before.points[before.cells].mean(axis=1)[:, 1] > 0.5).astype(int)
    uv = unfolded(before.points, before.cells, chart)
    if kind == "tensor":
        mesh.triangle["texture_uvs"] = uv.astype(np.float32)
    else:
        mesh.triangle_uvs = open3d.utility.Vector2dVector(uv.reshape(-1, 2))
    blocks = open3d_mesh.read(mesh).blocks
    assert (len(set(blocks)), len(set(zip(blocks, chart, strict=True)))) == (2, 2)
    out = odt_plugins.optimize(mesh)
    after = view(kind, out)
    if kind == "tensor":
        new = out.triangle["texture_uvs"].numpy()
        assert new.dtype == np.float32
    else:
        new = np.asarray(out.triangle_uvs).reshape(-1, 3, 2)
    assert not np.array_equal(before.cells, after.cells)
    # A vertex takes its old coordinates along, on each side of the seam those of that side.
    tag = new[:, :, 0] > 5.0
    assert (tag == tag[:, :1]).all()
    expected = unfolded(before.points, after.cells, tag[:, 0])
    assert new == pytest.approx(expected, abs=1e-5)
    sides = [contract.facets(c, np.where(t, 1, 0)) for c, t in
             ((before.cells, chart), (after.cells, tag[:, 0]))]
    assert sides[0] == sides[1]


def test_charts_are_parted_by_seams_and_a_cut_within_a_chart_is_named():
    cells = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    points = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1], [0.5, 0.5]])
    uv = points[cells]
    chart, seams = charts(uv, cells)
    assert chart.tolist() == [0, 0, 0, 0]
    assert len(seams.rows) == 0
    cut = uv.copy()
    cut[0] += 0.25
    chart, seams = charts(cut, cells)
    assert len(set(chart.tolist())) == 2
    assert (chart[1:] == chart[1]).all()
    assert len(seams.rows) == 0
    slit = uv.copy()
    slit[0, 0] += 0.25
    chart, seams = charts(slit, cells)
    assert chart.tolist() == [0, 0, 0, 0]
    assert [sorted(row) for row in seams.rows.tolist()] == [[0, 4]]
    mesh = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(np.column_stack([points, np.zeros(5)])),
        open3d.utility.Vector3iVector(cells))
    mesh.triangle_uvs = open3d.utility.Vector2dVector(slit.reshape(-1, 2))
    kept = open3d_mesh.read(mesh).kept
    assert [part.kind for part in kept] == ["texture seam"]


@pytest.mark.parametrize("unit", [1.0, 2.0**100])
def test_a_new_wedge_takes_the_nearest_of_the_old_ones(unit):
    """Vertex 3 has wedges at two places of the texture; each new triangle takes that nearby."""
    cells = np.array([[0, 1, 2], [1, 3, 2], [4, 3, 5]])
    uv = np.array([[[0, 0], [1, 0], [0, 1]], [[1, 0], [1, 1], [0, 1]],
                   [[8, 8], [9, 9], [8, 9]]], dtype=np.float32) * np.float32(unit)
    for source, place in ((0, [1, 1]), (2, [9, 9])):
        corner = [0, 1, 3] if source == 0 else [4, 0, 3]
        out = carried(uv, cells, Result(np.zeros((6, 3)), np.array([corner]),
                                        np.array([source], dtype=np.int32)))
        assert (out[0, 2] / unit).tolist() == place
    out = carried(uv, cells, Result(np.zeros((6, 3)), np.array([[0, 1, 3]]),
                                    np.array([2], dtype=np.int32)))
    assert (out[0] / unit).tolist() == [[0, 0], [1, 0], [9, 9]]


class FakeMap(dict):
    """A TensorMap on another device: its tensors only come out through cpu()."""


class FakeTensor:
    def __init__(self, tensor):
        self.tensor = tensor

    def cpu(self):
        return self.tensor

    def __len__(self):
        return len(self.tensor)


def test_meshes_on_another_device_go_to_the_cpu_and_back_with_a_warning(monkeypatch):
    mesh = make("tensor")
    for values in (mesh.vertex, mesh.triangle):
        del values["normals"]
    points = mesh.vertex.positions.numpy().copy()
    moved = []

    class Device:
        """Stands for CUDA: forwards everything to a mesh on the CPU."""

        __module__ = "open3d.pybind.t.geometry"
        is_cpu = False
        device = "CUDA:0"

        def __init__(self, inner):
            self.inner = inner
            self.vertex = FakeMap({k: FakeTensor(v) for k, v in inner.vertex.items()})
            self.triangle = FakeMap({k: FakeTensor(v) for k, v in inner.triangle.items()})
            self.material = inner.material

        def clone(self):
            return Device(self.inner.clone())

    Device.__name__ = "TriangleMesh"
    native = open3d.core.Tensor.to

    def to(self, *args):
        if args[0] == "CUDA:0":
            moved.append(self)
            return FakeTensor(self)
        return native(self, *args)

    monkeypatch.setattr(open3d.core.Tensor, "to", to)
    with pytest.warns(ODTWarning, match="the mesh lies on CUDA:0; it is copied to the CPU") as seen:
        out = odt_plugins.optimize(Device(mesh))
    assert len(seen) == 1
    assert seen[0].filename == __file__
    assert type(out) is Device
    truth = odt_plugins.optimize(mesh)
    assert len(moved) == 1 + len(mesh.triangle)
    positions = out.vertex["positions"].cpu().numpy()
    assert positions.tobytes() == truth.vertex.positions.numpy().tobytes()
    for name, values in truth.triangle.items():
        assert np.array_equal(out.triangle[name].cpu().numpy(), values.numpy()), name
    assert mesh.vertex.positions.numpy().tobytes() == points.tobytes()


def test_a_mesh_on_the_cpu_gets_no_warning():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        odt_plugins.optimize(make("tensor"))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("index", [np.int32, np.int64])
def test_tensor_meshes_keep_both_kinds_of_numbers(dtype, index):
    points, cells, _ = contract.grid(2, 4)
    space = np.column_stack([points, np.zeros(len(points))])
    mesh = open3d.t.geometry.TriangleMesh(space.astype(dtype), cells.astype(index))
    out = odt_plugins.optimize(mesh)
    assert out.vertex.positions.numpy().dtype == dtype
    assert out.triangle.indices.numpy().dtype == index
    assert not np.array_equal(out.vertex.positions.numpy(), space.astype(dtype))


@pytest.mark.parametrize(("kind", "what"), [("triangle", "triangles"), ("tetra", "tetrahedra"),
                                            ("tensor", "triangles")])
def test_meshes_without_cells_and_data_of_wrong_length_are_named(kind, what):
    empty = type(make(kind))()
    with pytest.raises(UnsupportedMeshError, match=rf"TriangleMesh|TetraMesh without {what}"):
        odt_plugins.optimize(empty)
    if kind == "tetra":
        return
    mesh = make(kind)
    if kind == "tensor":
        mesh.triangle["short"] = np.arange(3)
        name = "triangle.short"
    else:
        mesh.triangle_material_ids = open3d.utility.IntVector([1, 2, 3])
        mesh.triangle_uvs = open3d.utility.Vector2dVector()
        name = "triangle_material_ids"
    if kind == "triangle" and not mesh.has_triangle_material_ids():
        return
    with pytest.raises(InvalidMeshError, match=f"{name} has 3 entries for 32 triangles"):
        odt_plugins.optimize(mesh)
    if kind == "tensor":
        del mesh.triangle["short"]
        mesh.vertex["short"] = np.arange(3.0)
        with pytest.raises(InvalidMeshError, match=r"vertex\.short has 3 entries for 25 vertices"):
            odt_plugins.optimize(mesh)


def test_other_geometries_of_open3d_get_a_hint():
    legacy = make("triangle")
    half = open3d.geometry.HalfEdgeTriangleMesh.create_from_triangle_mesh(legacy)
    for mesh, hint in ((open3d.geometry.PointCloud(), r"PointCloud; .*create_from_point_cloud"),
                       (open3d.t.geometry.PointCloud(), r"of a legacy cloud$"),
                       (half, r"geometry\.TriangleMesh\(mesh\.vertices, mesh\.triangles\)$"),
                       (open3d.geometry.LineSet(), "try a TriangleMesh or TetraMesh made of it$")):
        with pytest.raises(UnsupportedMeshError, match=hint):
            odt_plugins.optimize(mesh)


def test_options_may_be_tensors_and_labels_a_column():
    mesh = make("tensor")
    before = view("tensor", mesh)
    n = len(before.points)
    selected = before.points[before.cells].mean(axis=1)[:, 1] < 0.6
    sizes = 1.0 + before.points[:, 0].astype(float)
    for name, values in (("selection", selected), ("fixed", np.arange(n) % 3 == 0),
                         ("density", sizes**-4), ("regions", selected * 1)):
        out = odt_plugins.optimize(mesh, **{name: open3d.core.Tensor(values)})
        truth = odt_plugins.optimize(mesh, **{name: values})
        assert contract.same_bits(view("tensor", out), view("tensor", truth)), name
        assert not contract.same_bits(view("tensor", out), before), name
    mesh.triangle["band"] = (selected * 1)[:, None]
    out = odt_plugins.optimize(mesh, regions="band")
    truth = odt_plugins.optimize(mesh, regions=selected)
    assert contract.same_bits(view("tensor", out), view("tensor", truth))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["filter_smooth_odt", "filter_smooth_cpt",
                                  "filter_smooth_odt_global"])
def test_filters_smooth_as_the_options_say_and_flip_nothing(kind, name):
    method = "cpt" if "cpt" in name else "odt"
    solver = "global" if "global" in name else "gauss-seidel"
    mesh = make(kind)
    before = view(kind, mesh)
    out = getattr(open3d_filters, name)(mesh, number_of_iterations=3)
    lab = {"rounds": 3, "cycles": 1, "solver": solver, "connectivity": "none"}
    truth = odt_plugins.optimize(mesh, method=method, smoothing=lab, finish=False)
    assert type(out) is type(mesh)
    assert contract.same_bits(view(kind, out), view(kind, truth))
    assert np.array_equal(view(kind, out).cells, before.cells)
    assert not np.array_equal(view(kind, out).points, before.points)
    assert contract.same_bits(view(kind, mesh), before)


def test_filter_signatures_are_those_of_open3d():
    for function in (open3d_filters.filter_smooth_odt, open3d_filters.filter_smooth_cpt,
                     open3d_filters.filter_smooth_odt_global):
        parameters = inspect.signature(function).parameters
        assert list(parameters)[:3] == ["mesh", "number_of_iterations", "filter_scope"]
        assert parameters["number_of_iterations"].default == 1
    assert list(inspect.signature(open3d_filters.optimize_odt).parameters)[1:] == list(OPTIONS)
    mesh = make("triangle")
    native = mesh.filter_smooth_simple(number_of_iterations=2,
                                       filter_scope=open3d.geometry.FilterScope.All)
    ours = open3d_filters.filter_smooth_odt(mesh, number_of_iterations=2,
                                            filter_scope=open3d.geometry.FilterScope.All)
    assert type(native) is type(ours)


@pytest.mark.parametrize("kind", ["triangle", "tensor"])
def test_scopes(kind):
    scope = open3d.geometry.FilterScope
    mesh, normal = tilted(kind)
    mesh.compute_vertex_normals()
    odd = np.tile([0.0, 0.6, 0.8], (25, 1))
    if kind == "tensor":
        mesh.vertex["normals"] = odd
    else:
        mesh.vertex_normals = open3d.utility.Vector3dVector(odd)
    for given, expected in ((None, normal), (scope.All, normal), (scope.Vertex, odd[0])):
        out = open3d_filters.filter_smooth_odt(mesh, filter_scope=given)
        assert normals(out)[0] == pytest.approx(np.tile(expected, (25, 1)), abs=1e-12)
        assert normals(out)[1] == pytest.approx(np.tile(normal, (32, 1)), abs=1e-12)
    for given in (scope.Color, scope.Normal):
        with pytest.raises(InvalidOptionError, match=r"expected FilterScope.All or FilterScope.V"):
            open3d_filters.filter_smooth_odt(mesh, filter_scope=given)


def test_optimize_odt_and_radius_ratios_are_those_of_the_package():
    for kind in KINDS:
        mesh = make(kind)
        out = open3d_filters.optimize_odt(mesh, smoothing={"rounds": 4})
        truth = odt_plugins.optimize(mesh, smoothing={"rounds": 4})
        assert contract.same_bits(view(kind, out), view(kind, truth))
        summary = odt_plugins.quality(out)
        assert summary.cells.quality.min() == summary.min_quality
        assert summary.cells.quality.mean() == summary.mean_quality
    equilateral = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(np.eye(3)), open3d.utility.Vector3iVector([[0, 1, 2]]))
    assert odt_plugins.quality(equilateral).cells.quality == pytest.approx([1.0])


CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [2, 0, 0], [2, 1, 0],
                    [0.7, 0.7, 0]])


def of_rows(kind, rows):
    """A mesh on CORNERS; a tensor mesh has a triangle attribute."""
    if kind == "tensor":
        mesh = open3d.t.geometry.TriangleMesh(CORNERS, np.array(rows))
        mesh.triangle["lab"] = np.arange(len(rows))
        return mesh
    points = open3d.utility.Vector3dVector(CORNERS)
    if kind == "tetra":
        return open3d.geometry.TetraMesh(points, open3d.utility.Vector4iVector(rows))
    return open3d.geometry.TriangleMesh(points, open3d.utility.Vector3iVector(rows))


FLAT, TWICE = [[0, 1, 2], [0, 1, 4]], [[0, 1, 2], [1, 4, 4]]
REPEATED, TURNED = [[0, 1, 2], [1, 2, 0]], [[0, 1, 2], [1, 2, 3]]
FAN = [[0, 1, 2], [1, 5, 2], [1, 6, 2]]
FAULTS = [
    *((kind, FLAT, "1 triangle .*zero area", False) for kind in ("triangle", "tensor")),
    *((kind, TURNED, "1 edge .*disagree about the outside", True)
      for kind in ("triangle", "tensor")),
    *((kind, FAN, "more than two triangles", True) for kind in ("triangle", "tensor")),
    ("triangle", TWICE, "1 triangle .*used twice", True),
    ("tensor", TWICE, "1 triangle .*used twice", False),
    ("triangle", REPEATED, "same vertices as an earlier triangle", True),
    ("tensor", REPEATED, "same vertices as an earlier triangle", False),
    ("tetra", [[0, 1, 2, 3], [0, 1, 4, 2]], "1 tetrahedron .*zero volume", False),
    ("tetra", [[0, 1, 2, 3], [0, 1, 4, 4]], "1 tetrahedron .*used twice", True),
    ("tetra", [[0, 1, 2, 3], [1, 2, 0, 3]], "same vertices as an earlier tetra", True),
]
"""Kind and rows of a broken mesh, what is said of it, and whether code is advised."""


@pytest.mark.parametrize(("kind", "rows", "message", "code"), FAULTS)
def test_errors_speak_of_triangles_and_tetras_and_advise_what_helps(kind, rows, message, code):
    flat = "zero" in message
    for function in (odt_plugins.optimize, open3d_filters.filter_smooth_odt):
        mesh = of_rows(kind, rows)
        with pytest.raises(InvalidMeshError, match="flat t" if flat else message) as caught:
            function(mesh)
        assert "cell" not in str(caught.value)
        with pytest.raises(InvalidMeshError, match=message) as caught:
            function(mesh, repair="none")
        said = str(caught.value)
        assert "cell" not in said
        advice = said.partition("try ")[2]
        assert advice.startswith(("mesh.", "repair=")) == code
        if not code:
            assert advice in ("removing such tetrahedra", "removing such triangles",
                              "removing repeated triangles")
        elif advice == "repair='orient'":
            function(mesh, repair="orient")
        else:
            names = {"mesh": mesh, "open3d": open3d, "odt_plugins": odt_plugins}
            out = eval(advice, names)
            function(out if isinstance(out, type(mesh)) else mesh)


def test_tetrahedra_of_a_point_cloud_are_taken_as_they_are():
    cloud = open3d.geometry.PointCloud(
        open3d.utility.Vector3dVector(np.random.default_rng(4).random((60, 3))))
    mesh, _ = open3d.geometry.TetraMesh.create_from_point_cloud(cloud)
    points, cells = np.asarray(mesh.vertices), np.asarray(mesh.tetras)
    negative = (contract.volumes(points, cells) < 0).sum()
    assert 0 < negative < len(cells)
    assert odt_plugins.quality(mesh).turned == negative
    better, report = odt_plugins.optimize_with_report(mesh)
    assert report.before.turned == negative
    assert (contract.volumes(np.asarray(better.vertices), np.asarray(better.tetras)) > 0).all()
    assert (odt_plugins.quality(mesh).cells.quality > 0).all()


def test_wrong_arguments_are_named():
    for name in ("filter_smooth_odt", "filter_smooth_cpt", "filter_smooth_odt_global"):
        with pytest.raises(InvalidOptionError, match="got number_of_iterations=-1"):
            getattr(open3d_filters, name)(make("triangle"), -1)
    with pytest.raises(InvalidOptionError, match=r"got smoothing={'rounds': -1}"):
        open3d_filters.optimize_odt(make("triangle"), smoothing={"rounds": -1})
    with pytest.raises(InvalidOptionError, match=r"got smoothing='global'"):
        open3d_filters.filter_smooth_odt(make("triangle"), smoothing="global")
    with pytest.raises(UnsupportedMeshError, match="expected an open3d TriangleMesh"):
        open3d_filters.filter_smooth_odt((CORNERS, np.array([[0, 1, 2]])))
    with pytest.raises(UnsupportedMeshError, match="without triangles"):
        odt_plugins.quality(open3d.geometry.TriangleMesh())


@pytest.mark.parametrize(("name", "options", "message"), [
    ("filter_smooth_odt", {"smoothing": {"rounds": 7}},
     r"got smoothing={'rounds': 7}, .* to 3; .*number_of_iterations=7"),
    ("filter_smooth_cpt", {"method": "odt"}, r"got method='odt', .* to 'cpt'; .*optimize_odt\(\)"),
    ("filter_smooth_odt", {"finish": True}, "got finish=True"),
    ("filter_smooth_odt", {"smoothing": {"connectivity": "flips"}},
     "got smoothing={'connectivity': 'flips'}, .* to 'none'"),
    ("filter_smooth_odt", {"smoothing": {"cycles": 2}}, "got smoothing={'cycles': 2}"),
    ("filter_smooth_odt_global", {"smoothing": {"solver": "lbfgs"}},
     "got smoothing={'solver': 'lbfgs'}, .* to 'global'"),
    ("filter_smooth_odt", {"solver": "lbfgs"}, "got solver='lbfgs'.*, try smoothing={'solver'"),
    ("filter_smooth_odt_global", {"method": "cpt"}, "got method='cpt'"),
    ("filter_smooth_odt", {"iterations": 3}, r"did you mean 'number_of_iterations'\?"),
    ("filter_smooth_cpt", {"objective": "amips"}, r"got objective='amips'.*, try optimize_odt\(\)"),
    ("filter_smooth_odt", {"insert": True}, r"got insert=True.*, try optimize_odt\(\)"),
    ("filter_smooth_odt_global", {"smoothing": {"omega": 1.0}},
     r"got smoothing={'omega': 1\.0}.*unless the solver"),
])
def test_options_that_contradict_a_filter_are_refused(name, options, message):
    function, mesh = getattr(open3d_filters, name), make("triangle")
    with pytest.raises(InvalidOptionError, match=message):
        function(mesh, number_of_iterations=3, **options)
    for unknown in ({"anything": 1}, {"insert": True}):
        with pytest.raises(InvalidOptionError) as caught:
            function(mesh, **unknown)
        listed = eval(re.search(r"\[.*\]", str(caught.value))[0])
        assert listed == list(inspect.signature(function).parameters)[1:]
    same = function(mesh, 3, smoothing={"rounds": 3}, finish=False, insert=False)
    assert contract.same_bits(view("triangle", same), view("triangle", function(mesh, 3)))


def test_normals_of_tetras_stay():
    mesh = make("tetra")
    odd = np.random.default_rng(8).random((125, 3))
    mesh.vertex_normals = open3d.utility.Vector3dVector(odd)
    for function in (open3d_filters.optimize_odt, open3d_filters.filter_smooth_odt):
        out = function(mesh)
        assert not np.array_equal(out.vertices, mesh.vertices)
        assert np.asarray(out.vertex_normals).tobytes() == odd.tobytes()


REGISTERED = """
import open3d, numpy as np, odt_plugins
assert not hasattr(open3d.geometry.TriangleMesh, "filter_smooth_odt")
odt_plugins.register("open3d")
odt_plugins.register("open3d")
points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [.9, .8, 0]])
cells = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
mesh = open3d.geometry.TriangleMesh(open3d.utility.Vector3dVector(points),
                                    open3d.utility.Vector3iVector(cells))
tensor = open3d.t.geometry.TriangleMesh.from_legacy(mesh)
for m in (mesh, tensor):
    out = m.filter_smooth_odt(number_of_iterations=5)
    print(type(out) is type(m), odt_plugins.quality(out).min_quality >
          odt_plugins.quality(m).min_quality)
print(hasattr(open3d.geometry.TetraMesh, "optimize_odt"))
"""


def test_registering_makes_them_methods():
    done = subprocess.run([sys.executable, "-c", REGISTERED], capture_output=True, text=True,
                          check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["True"] * 5


def test_the_material_of_the_result_is_its_own():
    mesh = make("tensor")
    out = odt_plugins.optimize(mesh)
    out.material.material_name = "other"
    out.material.scalar_properties["metallic"] = 0.75
    assert mesh.material.material_name == "defaultLit"
    assert mesh.material.scalar_properties["metallic"] == 0.0


ALL = """
import sys
import numpy as np, odt_plugins
names = sys.argv[1].split(",")
for name in names:
    odt_plugins.register(name)
import open3d, pymeshlab, pyvista
points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [.9, .8, 0]])
cells = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]], dtype=np.int32)
legacy = open3d.geometry.TriangleMesh(open3d.utility.Vector3dVector(points),
                                      open3d.utility.Vector3iVector(cells))
surface = pyvista.PolyData.from_regular_faces(points, cells)
meshes = pymeshlab.MeshSet()
meshes.add_mesh(pymeshlab.Mesh(points, cells))
meshes.meshing_odt_optimization()
results = [np.asarray(legacy.optimize_odt().vertices), surface.odt.optimize().points,
           meshes.current_mesh().vertex_matrix()]
print(all(np.array_equal(results[0], r) for r in results), np.array_equal(results[0], points))
meshes.create_grid(numvertx=5, numverty=5)
meshes.meshing_poly_to_tri()
meshes.apply_filter("apply_coord_odt_smoothing")
meshes.apply_coord_taubin_smoothing(stepsmoothnum=1)
better = odt_plugins.optimize(pyvista.ImageData(dimensions=(3, 3, 3)).to_tetrahedra())
open3d.geometry.TriangleMesh.create_sphere(resolution=5).compute_vertex_normals()
print(type(better).__name__, meshes.current_mesh().face_number())
"""


# Either of any two comes first in one of them.
@pytest.mark.parametrize("order", ["pymeshlab,open3d,pyvista", "pyvista,open3d,pymeshlab"])
def test_all_toolkits_live_in_one_process_and_give_the_same(order):
    pytest.importorskip("pyvista")
    pytest.importorskip("pymeshlab")
    done = subprocess.run([sys.executable, "-c", ALL, order], capture_output=True, text=True,
                          check=False)
    assert done.returncode == 0, done.stderr[-800:]
    assert done.stdout.split()[-4:] == ["True", "False", "UnstructuredGrid", "32"]


def test_tensors_are_fields_and_are_transferred():
    import open3d

    mesh = open3d.t.geometry.TriangleMesh.create_sphere(1.0, 10)
    height = mesh.vertex.positions[:, 2:]
    known = height.numpy()
    np.testing.assert_array_equal(
        odt_plugins.metric_from_field(mesh, height * height, 500),
        odt_plugins.metric_from_field(mesh, known * known, 500))
    better, report = odt_plugins.remesh_with_report(mesh, 0.4)
    carried = report.transfer(height)
    assert carried.dtype == known.dtype
    np.testing.assert_allclose(carried, better.vertex.positions[:, 2:].numpy(), atol=1e-6)


def test_errors_of_filters_name_the_cells_as_those_of_optimize_do():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [1.5, 0.5, 0]])
    mesh = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(points),
        open3d.utility.Vector3iVector([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]))
    with pytest.raises(TangledMeshError) as alone:
        odt_plugins.optimize(mesh, repair="none")
    with pytest.raises(TangledMeshError) as found:
        open3d_filters.filter_smooth_odt(mesh, 3, repair="none")
    assert found.value.cells == alone.value.cells != ()
