"""Soups of triangles, as readers of STL files return them, through every toolkit."""

from __future__ import annotations

import contract
import numpy as np
import pytest
import surface_meshes as sm

import odt_plugins
from odt_plugins.errors import ODTWarning
from odt_plugins.mesh.soup import same_places

meshio = pytest.importorskip("meshio")
open3d = pytest.importorskip("open3d")
pymeshlab = pytest.importorskip("pymeshlab")
pyvista = pytest.importorskip("pyvista")

SURFACE = sm.torus(24, 10, noise=0.6)


def apart(points, cells):
    """The same triangles, each with vertices of its own."""
    return points[cells].reshape(-1, points.shape[1]), np.arange(cells.size).reshape(cells.shape)


def _polydata(points, cells):
    return pyvista.PolyData.from_regular_faces(points, cells)


def _legacy(points, cells):
    return open3d.geometry.TriangleMesh(open3d.utility.Vector3dVector(points),
                                        open3d.utility.Vector3iVector(cells))


MAKERS = {
    "arrays": lambda p, t: (p, t),
    "meshio": lambda p, t: meshio.Mesh(p, [("triangle", t)]),
    "pyvista": _polydata,
    "grid": lambda p, t: _polydata(p, t).cast_to_unstructured_grid(),
    "open3d": _legacy,
    "tensor": lambda p, t: open3d.t.geometry.TriangleMesh.from_legacy(_legacy(p, t)),
    "pymeshlab": lambda p, t: pymeshlab.Mesh(p, t),
}
ADVICE = {"pyvista": "mesh.clean()", "grid": "mesh.clean()",
          "open3d": "mesh.remove_duplicated_vertices()",
          "tensor": "mesh.to_legacy().remove_duplicated_vertices()",
          "pymeshlab": "meshing_remove_duplicate_vertices()"}


def view(mesh):
    """Points and triangles of a mesh of any kind."""
    if isinstance(mesh, tuple):
        return mesh
    if isinstance(mesh, meshio.Mesh):
        return mesh.points, mesh.cells[0].data
    if isinstance(mesh, pyvista.PolyData):
        return np.array(mesh.points), mesh.regular_faces
    if isinstance(mesh, pyvista.UnstructuredGrid):
        return np.array(mesh.points), mesh.cells_dict[5]
    if isinstance(mesh, pymeshlab.Mesh):
        return mesh.vertex_matrix(), mesh.face_matrix()
    if isinstance(mesh, open3d.geometry.TriangleMesh):
        return np.asarray(mesh.vertices), np.asarray(mesh.triangles)
    return mesh.vertex.positions.numpy(), mesh.triangle.indices.numpy()


def assert_closed_as_before(before, after):
    """Vertices that were at one place are, and the triangles are a closed surface there."""
    (p0, t0), (p1, t1) = before, after
    same = same_places(p0, t0)
    assert np.array_equal(p1, p1[same])
    assert set(sm.edge_set(same[t1]).values()) == {2}
    assert sm.topology(same[t1]) == sm.topology(same[t0])
    old = {frozenset(same[row].tolist()): row.tolist() for row in t0}
    kept = [(old[key], row.tolist()) for row in t1 if (key := frozenset(same[row].tolist())) in old]
    assert 0 < len(kept) < len(t0)
    assert all(row == was for was, row in kept)


@pytest.mark.parametrize("kind", MAKERS)
def test_soups_of_every_toolkit_are_improved(kind):
    mesh = MAKERS[kind](*apart(*SURFACE))
    before = [np.array(part) for part in view(mesh)]
    n = len(SURFACE[0])
    better, report = odt_plugins.optimize_with_report(mesh)
    assert type(better) is type(mesh)
    assert (report.n_movable, report.n_used, report.before.n_points) == (n, n, len(before[0]))
    assert report.after.mean_quality > report.before.mean_quality + 0.02
    assert_closed_as_before(before, view(better))
    assert all(np.array_equal(a, b) for a, b in zip(before, view(mesh), strict=True))
    [note] = report.notes
    assert note.startswith(f"{len(before[0]) - n} of {len(before[0])} vertices were at the place")
    assert f"try {ADVICE.get(kind, 'merging vertices at the same place')} for" in note
    assert f"note   {note}" in str(report)
    assert report.to_dict()["notes"] == [note]


def test_a_soup_gets_the_places_of_the_merged_mesh():
    points, cells = SURFACE
    torn = apart(points, cells)
    same = same_places(*torn)
    first = np.unique(same)
    whole = np.searchsorted(first, same)[torn[1]]
    out, report = odt_plugins.optimize_with_report((torn[0][first], whole))
    assert report.notes == ()
    assert np.array_equal(odt_plugins.optimize(torn)[0], out[0][np.searchsorted(first, same)])


def test_soups_keep_their_types_and_the_signs_of_zeros():
    points, cells = apart(*sm.cube(6, noise=0.5))
    points[::2][points[::2] == 0.0] = -0.0
    out = odt_plugins.optimize((points, cells))
    assert (out[0] != points).any()
    stays = (out[0] == points).all(axis=1)
    assert np.signbit(points[stays]).any()
    assert out[0][stays].tobytes() == points[stays].tobytes()
    other = odt_plugins.optimize((points.astype(">f8"), cells.astype(float)))
    assert [part.dtype for part in other] == [np.dtype(">f8"), np.dtype(float)]
    assert all(np.array_equal(a, b) for a, b in zip(other, out, strict=True))


@pytest.mark.parametrize("kind", MAKERS)
def test_a_mesh_that_is_none_has_no_note(kind):
    better, report = odt_plugins.optimize_with_report(MAKERS[kind](*SURFACE))
    assert report.notes == ()
    assert "note" not in str(report)
    assert len(view(better)[0]) == len(SURFACE[0])


def test_stl_files_as_open3d_reads_them(tmp_path):
    _polydata(*SURFACE).save(tmp_path / "torus.stl")
    for read in (open3d.io.read_triangle_mesh, open3d.t.io.read_triangle_mesh):
        mesh = read(str(tmp_path / "torus.stl"))
        better, report = odt_plugins.optimize_with_report(mesh)
        assert report.n_movable == len(SURFACE[0]) < len(view(mesh)[0])
        assert_closed_as_before(view(mesh), view(better))


def test_fixed_vertices_and_arrays_stay_with_their_vertices():
    points, cells = apart(*SURFACE)
    mesh = _polydata(points, cells)
    mesh.point_data["row"] = np.arange(len(points))
    mesh.cell_data["cell"] = np.arange(len(cells))
    fixed = [7, 40]
    better = odt_plugins.optimize(mesh, fixed=fixed, selection=np.arange(30, len(cells)))
    same = same_places(points, cells)
    stays = np.isin(same, same[fixed]) | np.isin(same, same[cells[:30]])
    assert np.array_equal(better.points[stays], mesh.points[stays])
    assert (better.points[~stays] != mesh.points[~stays]).any()
    assert np.array_equal(better.point_data["row"], np.arange(len(points)))
    assert np.array_equal(better.regular_faces[:30], cells[:30])
    assert len(better.cell_data["cell"]) == len(cells)


def texture(points):
    """Angle around the axis and height, (..., 2)."""
    return np.stack([np.arctan2(points[..., 1], points[..., 0]) / (2 * np.pi) + 0.5,
                     points[..., 2]], axis=-1)


def two_charts():
    """Texture coordinates (m, 3, 2) of SURFACE: one chart for each half of the turn."""
    points, cells = SURFACE
    uv = texture(points)[cells]
    uv[..., 0] += (np.ptp(uv[..., 0], axis=1) > 0.5)[:, None] & (uv[..., 0] < 0.5)
    uv[..., 0] += 3.0 * (uv[..., 0].mean(axis=1) > 0.5)[:, None]
    return uv


@pytest.mark.parametrize("kind", ["pyvista", "pymeshlab"])
def test_texture_coordinates_of_vertices_stay_in_their_charts(kind):
    uv = two_charts().reshape(-1, 2)
    if kind == "pyvista":
        mesh = _polydata(*apart(*SURFACE))
        mesh.active_texture_coordinates = uv
    else:
        mesh = pymeshlab.Mesh(*apart(*SURFACE), v_tex_coords_matrix=uv)
    better, report = odt_plugins.optimize_with_report(mesh)
    assert 0.8 * len(SURFACE[0]) < report.n_movable < len(SURFACE[0])
    assert_closed_as_before(view(mesh), view(better))
    p, t = view(better)
    new = (better.active_texture_coordinates if kind == "pyvista"
           else better.vertex_tex_coord_matrix())[t]
    assert np.ptp(new[..., 0], axis=1).max() < 0.2
    off = new - texture(p)[t]
    off[..., 0] -= np.round(off[..., 0])
    assert np.abs(off).max() < 0.02
    assert (p != view(mesh)[0]).any()


@pytest.mark.parametrize("regions", [None, "charts"])
@pytest.mark.parametrize("kind", ["open3d", "tensor"])
@pytest.mark.filterwarnings("ignore:.*lie across seams")
def test_texture_coordinates_of_wedges_are_those_of_the_merged_mesh(kind, regions):
    torn, rows = apart(*SURFACE)
    first = np.unique(same_places(torn, rows))
    found = []
    for points, cells in ((torn, rows),
                          (torn[first], np.searchsorted(first, same_places(torn, rows))[rows])):
        mesh = MAKERS[kind](points, cells)
        if kind == "open3d":
            mesh.triangle_uvs = open3d.utility.Vector2dVector(two_charts().reshape(-1, 2))
            found.append(np.asarray(odt_plugins.optimize(mesh, regions=regions).triangle_uvs))
        else:
            mesh.triangle["texture_uvs"] = open3d.core.Tensor(two_charts())
            better = odt_plugins.optimize(mesh, regions=regions)
            found.append(better.triangle["texture_uvs"].numpy())
    assert np.array_equal(*found)
    assert not np.array_equal(found[0].reshape(-1, 3, 2), two_charts())


@pytest.mark.parametrize("kind", MAKERS)
def test_soups_that_cannot_be_merged_come_back_with_a_sentence(kind):
    points, cells = apart(*SURFACE)
    points[4] = points[3]
    mesh = MAKERS[kind](points, cells)
    with pytest.warns(ODTWarning, match="used twice") as caught:
        better, report = odt_plugins.optimize_with_report(mesh)
    assert report.n_movable == 0
    assert all(np.array_equal(a, b) for a, b in zip(view(mesh), view(better), strict=True))
    [note] = report.notes
    assert str(caught[0].message) == note
    assert note.endswith(f"try {ADVICE.get(kind, 'merging vertices at the same place')}")


def test_soups_that_disagree_about_the_outside_are_merged_on_demand():
    points, cells = apart(*SURFACE)
    cells[::5] = cells[::5, ::-1]
    with pytest.warns(ODTWarning, match="disagree about the outside.*repair='orient'"):
        odt_plugins.optimize((points, cells))
    _, report = odt_plugins.optimize_with_report((points, cells), repair="orient")
    turned = len(cells[::5])
    assert (report.n_movable, report.before.turned) == (len(SURFACE[0]), turned)


@pytest.mark.parametrize("kind", ["meshio", "grid"])
def test_soups_in_the_plane_and_of_tetrahedra_stay_and_a_sentence_says_so(kind, d):
    points, cells, _ = contract.grid(d, 4)
    torn, rows = apart(points, cells)
    if d == 2:
        torn = np.column_stack([torn, np.zeros(len(torn))])
    mesh = (meshio.Mesh(torn, [("triangle" if d == 2 else "tetra", rows)]) if kind == "meshio"
            else pyvista.UnstructuredGrid({5 if d == 2 else 10: rows}, torn))
    call = ADVICE.get(kind, "merging vertices at the same place")
    note = f"hardly any vertices may move, since the cells share hardly any; try {call}"
    with pytest.warns(ODTWarning) as caught:
        better, report = odt_plugins.optimize_with_report(mesh)
    assert [str(warning.message) for warning in caught] == [note]
    assert report.notes == (note,)
    assert np.array_equal(better.points, mesh.points)
