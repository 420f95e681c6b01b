"""One contract for every kind of object, with the engine and with a stand-in that changes much."""

from __future__ import annotations

import itertools
from pathlib import Path

import contract
import numpy as np
import pytest
from quadratic_meshes import churned

import odt_plugins
from odt_plugins.adapters import apart
from odt_plugins.carrying.sources import cell_source, in_input_order
from odt_plugins.engine.run import plan
from odt_plugins.mesh.simplex import simplex_mesh


@pytest.fixture(autouse=True)
def _in_this_process(monkeypatch):
    """No process of its own for every file: other tests hold that such a process is used."""
    monkeypatch.setattr(apart, "call", lambda function, *arguments, seconds=None: function(
        *arguments))


@pytest.fixture(autouse=True)
def _scratch(tmp_path, monkeypatch):
    """Hosts that are files lie in a directory of their own."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture(params=["engine", "churn"])
def _engine(request, monkeypatch):
    if request.param == "churn":
        churned(monkeypatch)


@pytest.mark.usefixtures("_engine")
@pytest.mark.parametrize("name", contract.HOSTS)
def test_contract(name):
    contract.need(name)
    host = contract.HOSTS[name]
    mesh = host.make()
    before = host.view(mesh)
    out = host.optimize(mesh, keep=())
    assert type(out) is type(mesh)
    assert out is not mesh
    assert contract.same_bits(host.view(mesh), before)
    assert contract.same_bits(before, host.view(host.make()))
    contract.check(host, before, host.view(out))


@pytest.mark.parametrize("name", contract.HOSTS)
def test_nothing_may_move_gives_identical_bytes(name, monkeypatch):
    contract.need(name)
    host = contract.HOSTS[name]
    mesh = host.make()
    monkeypatch.setattr(plan, "run", lambda mesh, options, _: plan.Outcome(
        mesh.points, mesh.cells[::-1].copy(), mesh.regions[::-1].copy()))
    out = host.optimize(mesh)
    assert contract.same_bits(host.view(mesh), host.view(out))


@pytest.mark.parametrize("name", ["arrays-tet", "arrays-tri-space", "pyvista-tet", "meshio-tri"])
@pytest.mark.parametrize("indices", [False, True])
def test_fixed_everything_gives_identical_bytes(name, indices):
    host = contract.HOSTS[name]
    mesh = host.make()
    n = len(host.view(mesh).points)
    fixed = np.arange(n) if indices else np.ones(n, dtype=bool)
    out = host.optimize(mesh, fixed=fixed, smoothing={"connectivity": "none"}, finish=False)
    assert contract.same_bits(host.view(mesh), host.view(out))


@pytest.mark.parametrize("name", contract.HOSTS)
def test_cells_outside_the_selection_come_back_untouched(name, monkeypatch):
    contract.need(name)
    churned(monkeypatch)
    host = contract.HOSTS[name]
    mesh = host.make()
    before = host.view(mesh)
    selected = before.points[before.cells].mean(axis=1)[:, 1] < 0.6
    assert 0 < selected.sum() < len(selected)
    rows = [tuple(c) for c in before.cells[~selected].tolist()]
    corners = np.unique(before.cells[~selected])
    for selection in (selected, np.flatnonzero(selected)):
        after = host.view(host.optimize(mesh, selection=selection, keep=()))
        assert [tuple(c) for c in after.cells.tolist() if tuple(c) in set(rows)] == rows
        assert before.points[corners].tobytes() == after.points[corners].tobytes()
        assert before.points.tobytes() != after.points.tobytes()


@pytest.mark.parametrize("name", ["arrays-tet", "arrays-tri", "meshio-tet-blocks"])
def test_the_engine_leaves_cells_outside_the_selection(name):
    host = contract.HOSTS[name]
    mesh = host.make()
    before = host.view(mesh)
    selected = before.points[before.cells].mean(axis=1)[:, 1] < 0.6
    after = host.view(host.optimize(mesh, selection=selected, keep=()))
    rows = [tuple(c) for c in before.cells[~selected].tolist()]
    assert [tuple(c) for c in after.cells.tolist() if tuple(c) in set(rows)] == rows


@pytest.mark.parametrize("name", contract.HOSTS)
def test_cells_that_come_turned_round_go_turned_round(name, monkeypatch):
    contract.need(name)
    churned(monkeypatch)
    host = contract.HOSTS[name]
    points, cells, labels = contract.grid(host.dim, 4)
    mesh = host.make((points, contract.negative(cells), labels))
    before = host.view(mesh)
    contract.check(host, before, host.view(host.optimize(mesh)))


def _star(dim):
    """A square or an octahedron cut up from its centre: points, cells, labels."""
    tips = np.concatenate([np.eye(dim), 0.0 - np.eye(dim)])
    rows = [[*corner, 2 * dim] for corner in itertools.combinations(range(2 * dim), dim)
            if len({c % dim for c in corner}) == dim]
    points, cells = np.vstack([tips, np.zeros(dim)]), np.array(rows)
    turned = contract.volumes(points, cells) < 0
    cells[turned, :2] = cells[turned, 1::-1]
    return points, cells, np.full(len(cells), 7)


@pytest.mark.parametrize("name", contract.HOSTS)
def test_an_optimal_mesh_and_a_single_cell_come_back_unchanged(name):
    contract.need(name)
    host = contract.HOSTS[name]
    points, cells, labels = _star(host.dim)
    alone = (points[cells[0]] + 0.25, np.arange(host.dim + 1)[None], labels[:1])
    for parts in ((points, cells, labels), alone):
        mesh = host.make(parts)
        before = host.view(mesh)
        assert len(before.cells) == len(parts[1])
        out = host.optimize(mesh)
        assert type(out) is type(mesh)
        assert contract.same_bits(before, host.view(out))


@pytest.mark.parametrize("name", contract.HOSTS)
def test_a_mesh_without_cells_is_named_in_words_of_the_host(name):
    contract.need(name)
    host = contract.HOSTS[name]
    points, cells, labels = contract.grid(host.dim, 2)
    mesh = host.make((points, cells[:0], labels[:0]))
    with pytest.raises(odt_plugins.ODTError, match=rf"(no|without) {host.word}"):
        host.optimize(mesh)
    with pytest.raises(odt_plugins.ODTError, match=rf"(no|without) {host.word}"):
        odt_plugins.quality(host.mesh(mesh))


SPEAK = [name for name in contract.HOSTS if not name.startswith("pymeshlab")]
"""Hosts whose words all errors are in; the filters of pymeshlab have their own."""


@pytest.mark.parametrize("name", SPEAK)
def test_errors_speak_the_words_of_the_host(name):
    contract.need(name)
    host = contract.HOSTS[name]
    noun = {"tetrahedra": "tetrahedron"}.get(host.word, host.word.removesuffix("s"))
    said = rf"\d+ ({noun}|{host.word}) \(first: {noun} 0\)"
    points, cells, labels = contract.grid(host.dim, 2)
    flat = points.copy()
    flat[cells[0, -1]] = flat[cells[0, 0]]
    for run, mesh in ((host.optimize, lambda mesh: mesh), (odt_plugins.optimize, host.mesh)):
        with pytest.raises(odt_plugins.ODTError, match=said):
            run(mesh(host.make((flat, cells, labels))), repair="none")
    good = host.make((points, cells, labels))
    with pytest.raises(odt_plugins.ODTError, match=rf"a mask .* as many as {host.word}$"):
        host.optimize(good, selection=np.ones(3, dtype=bool))
    if len(points) != len(cells):
        with pytest.raises(odt_plugins.ODTError, match=rf"and {len(cells)} {host.word}, "):
            host.optimize(good, density=np.ones(3))


@pytest.mark.parametrize("name", contract.CURVED)
def test_curved_surfaces_keep_their_envelope_and_all_data(name):
    contract.need(name)
    host = contract.HOSTS[name]
    mesh = host.make(contract.bowl())
    before = host.view(mesh)
    assert odt_plugins.quality(host.mesh(mesh)).inverted == 0
    contract.check_curved(host, before, host.view(host.optimize(mesh, envelope=5e-3)), 5e-3)
    assert contract.same_bits(before, host.view(mesh))


@pytest.mark.parametrize(("side", "name"), [("CELL", "stress"), ("POINT", "temperature")])
def test_active_arrays_and_user_dictionary_of_a_grid_survive(side, name, monkeypatch):
    pyvista = pytest.importorskip("pyvista")
    churned(monkeypatch)
    mesh = contract.HOSTS["pyvista-tet"].make()
    mesh.set_active_scalars(name, preference=side.lower())
    mesh.user_dict["who"] = "me"
    out = odt_plugins.optimize(mesh)
    assert out.n_cells != mesh.n_cells
    assert out.active_scalars_info.name == name
    assert out.active_scalars_info.association == pyvista.FieldAssociation[side]
    assert out.cell_data.active_scalars_name == mesh.cell_data.active_scalars_name
    assert out.cell_data.active_vectors_name == "axis"
    assert out.point_data.active_vectors_name == "velocity"
    assert dict(out.user_dict) == {"who": "me"}


@pytest.mark.usefixtures("_engine")
def test_markers_of_a_csg_mesh_and_their_interfaces_survive():
    """What pytetwild.tetrahedralize_csg made of the union of two boxes and a sphere."""
    pyvista = pytest.importorskip("pyvista")
    grid = pyvista.read(Path(__file__).parents[1] / "data" / "tetwild_csg.vtu")
    host = contract.HOSTS["pyvista-tet"]
    before = host.view(grid)
    assert np.unique(before.cell_data["marker"]).tolist() == [1, 2, 3]
    assert sorted(before.field_data) == ["PointMergeMap"]
    after = host.view(odt_plugins.optimize(grid, keep=()))
    contract.check(host, before, after)
    assert not np.array_equal(before.points, after.points)
    assert contract.same_bits(host.view(grid), before)


@pytest.mark.parametrize("dtype", [np.int32, np.int64])
def test_connectivity_of_a_grid_keeps_its_dtype(dtype, monkeypatch):
    pyvista = pytest.importorskip("pyvista")
    churned(monkeypatch)
    points, cells, _ = contract.grid(3, 4)
    mesh = pyvista.UnstructuredGrid({pyvista.CellType.TETRA: cells}, points)
    size = np.full(len(cells), 4)
    offsets = np.concatenate([[0], np.cumsum(size)]).astype(dtype)
    rows = pyvista.CellArray.from_arrays(offsets, cells.ravel().astype(dtype), deep=True)
    mesh.SetCells(pyvista.convert_array(mesh.celltypes.copy(), deep=True), rows)
    if mesh.cell_connectivity.dtype != dtype:
        pytest.skip("this pyvista does not hold such indices")
    out = odt_plugins.optimize(mesh)
    assert out.cell_connectivity.dtype == mesh.cell_connectivity.dtype
    assert out.GetCells().GetOffsetsArray().GetDataTypeSize() == np.dtype(dtype).itemsize


def _mixed_tets():
    """Tetrahedra, triangles on and inside them, and a pyramid with an apex outside."""
    points, cells, _ = contract.grid(3, 4)
    boundary = contract.facets(cells, np.zeros(len(cells), int))
    inner = sorted(contract.facets(cells, np.arange(len(cells))) - boundary)
    outside = points[:4] - np.array([0.0, 0.0, 3.0])
    pyramid = [0, 1, 6, 5, len(points)]
    return np.vstack([points, outside]), cells, sorted(boundary)[:9], inner[40:44], pyramid


def test_mixed_grid_keeps_what_is_not_optimised(monkeypatch):
    pyvista = pytest.importorskip("pyvista")
    churned(monkeypatch)
    points, cells, outer, inner, pyramid = _mixed_tets()
    n = len(points)
    lines, loose = [list(f[:2]) for f in inner], [n - 3, n - 2, n - 1]
    parts = [*outer, *cells[:100].tolist(), *lines, pyramid, *cells[100:].tolist(), [3], *inner,
             loose]
    types = ([5] * 9 + [10] * 100 + [3] * 4 + [14] + [10] * (len(cells) - 100) + [1] + [5] * 4
             + [5])
    flat = np.concatenate([[len(p), *p] for p in parts])
    mesh = pyvista.UnstructuredGrid(flat, np.array(types, dtype=np.uint8), points)
    mesh.cell_data["origin"] = np.arange(len(parts))
    out = odt_plugins.optimize(mesh)
    assert out.n_cells > mesh.n_cells
    assert (np.diff(out.cell_data["origin"]) >= 0).all()
    for i, (kind, part) in enumerate(zip(types, parts, strict=True)):
        if kind != 10:
            (j,) = np.flatnonzero(out.cell_data["origin"] == i)
            assert out.celltypes[j] == kind
            assert out.get_cell(int(j)).point_ids == list(part)
    new = out.cells_dict[10]
    faces = {f for c in new.tolist() for f in itertools.combinations(sorted(c), 3)}
    assert set(inner) | set(outer) <= faces
    held = np.unique([*pyramid, *np.ravel(inner), *loose])
    assert out.points[held].tobytes() == mesh.points[held].tobytes()
    assert (contract.volumes(out.points, new) > 0).all()


def test_meshio_sets_tags_and_other_blocks(monkeypatch):
    import meshio

    churned(monkeypatch)
    points, cells, outer, inner, _ = _mixed_tets()
    half = np.arange(len(cells)) < len(cells) // 2
    blocks = [
        meshio.CellBlock("triangle", np.array(outer)),
        meshio.CellBlock("tetra", cells[half], tags=["soft"]),
        meshio.CellBlock("vertex", np.array([[3], [4]])),
        meshio.CellBlock("tetra", cells[~half]),
        meshio.CellBlock("line", np.array([f[:2] for f in inner])),
    ]
    counts = [len(b) for b in blocks]
    sets = {"some": [np.array([0]), np.arange(0, counts[1], 3, dtype=np.uint32), np.array([1]),
                     None, np.array([0, 2])],
            "gmsh:bounding_entities": [np.array([5000]), np.array([9999]), None, None, None]}
    mesh = meshio.Mesh(points, blocks, point_sets={"top": np.array([1, 2])}, cell_sets=sets,
                       cell_data={"origin": [np.arange(c) for c in counts]})
    out = odt_plugins.optimize(mesh)
    assert [b.type for b in out.cells] == [b.type for b in mesh.cells]
    assert [b.tags for b in out.cells] == [b.tags for b in mesh.cells]
    assert sum(len(b) for b in out.cells) > sum(counts)
    for i in (0, 2, 4):
        assert np.array_equal(out.cells[i].data, mesh.cells[i].data)
        assert np.array_equal(out.cell_data["origin"][i], np.arange(counts[i]))
    assert len(mesh.cells[1]) == counts[1]
    for i in (1, 3):
        old = contract.facets(mesh.cells[i].data, np.zeros(counts[i], int))
        new = contract.facets(out.cells[i].data, np.zeros(len(out.cells[i]), int))
        assert old == new
    some = out.cell_sets["some"]
    assert some[1].dtype == np.uint32
    assert np.array_equal(some[1], np.flatnonzero(out.cell_data["origin"][1] % 3 == 0))
    assert some[3] is None
    assert out.cell_sets["gmsh:bounding_entities"][1].tolist() == [9999]
    assert out.point_sets["top"].tolist() == [1, 2]


@pytest.mark.parametrize("choice", ["name", "array"])
def test_regions_option_replaces_the_default(choice, monkeypatch):
    seen = []
    monkeypatch.setattr(plan, "run", lambda mesh, options, _: seen.append(mesh) or contract.churn(
        mesh, options))
    mesh = contract.HOSTS["meshio-tri"].make()
    band = (mesh.points[mesh.cells[0].data].mean(axis=1)[:, 1] * 4).astype(np.uint8)
    mesh.cell_data["band"] = [band]
    out = odt_plugins.optimize(mesh, regions="band" if choice == "name" else band)
    assert np.array_equal(seen[0].regions, np.unique(band, return_inverse=True)[1])
    view = contract.meshio_view("triangle")
    host = contract.Host(lambda: mesh, view, 2, "band")
    contract.check(host, view(mesh), view(out))


def test_cell_sets_may_be_masks_and_wrong_ones_are_named(monkeypatch):
    churned(monkeypatch)
    mesh = contract.HOSTS["meshio-tri"].make()
    left = mesh.cell_data["marker"][0] == 7
    mesh.cell_data.clear()
    mesh.cell_sets = {"left": [left], "right": [np.flatnonzero(~left)]}
    sizes = [np.abs(contract.volumes(mesh.points, mesh.cells[0].data)[s]).sum()
             for s in (left, ~left)]
    out = odt_plugins.optimize(mesh)
    inside, others = out.cell_sets["left"][0], out.cell_sets["right"][0]
    assert inside.dtype == bool
    assert np.array_equal(np.flatnonzero(~inside), others)
    new = np.abs(contract.volumes(out.points, out.cells[0].data))
    assert [new[inside].sum(), new[others].sum()] == pytest.approx(sizes)
    for wrong, message in (([3, 99], r"index 99 \(1 out of range\) in block 0; .* 0 to 31"),
                           ([-1], "index -1"), (left[:5], r"mask of shape \(5,\) in block 0")):
        mesh.cell_sets["left"] = [np.array(wrong)]
        with pytest.raises(odt_plugins.InvalidMeshError, match=rf"cell set 'left' has .*{message}"):
            odt_plugins.optimize(mesh)


def test_a_single_cell_keeps_its_complex_number():
    pyvista = pytest.importorskip("pyvista")
    mesh = pyvista.UnstructuredGrid({10: np.array([[0, 1, 2, 3]])}, np.eye(4)[:, :3])
    mesh.cell_data["impedance"] = np.array([1.0 + 2.0j])
    assert odt_plugins.optimize(mesh).cell_data["impedance"] == 1.0 + 2.0j


def test_what_pyvista_can_make_cells_of_is_said():
    pyvista = pytest.importorskip("pyvista")
    hexahedra = pyvista.ImageData(dimensions=(3, 3, 3)).cast_to_unstructured_grid()
    points = pyvista.PointSet(hexahedra.points)
    for mesh, call in ((hexahedra, "mesh.triangulate()"), (points, "mesh.delaunay_3d()"),
                       (pyvista.PolyData(hexahedra.points), "mesh.delaunay_3d()"),
                       (pyvista.ImageData(dimensions=(3, 3, 3)),
                        "mesh.cast_to_unstructured_grid().triangulate()"),
                       (pyvista.PartitionedDataSet([pyvista.Sphere()]),
                        "pyvista.MultiBlock(list(mesh))"),
                       (pyvista.MultiBlock([hexahedra]), "mesh.combine().triangulate()")):
        with pytest.raises(odt_plugins.UnsupportedMeshError) as caught:
            odt_plugins.optimize(mesh)
        assert str(caught.value).endswith(call)
        odt_plugins.optimize(eval(call))


def test_objects_of_a_toolkit_that_are_no_meshes_are_told_what_makes_one():
    trimesh, occ, skfem = (pytest.importorskip(name) for name in ("trimesh", "netgen.occ", "skfem"))
    pyvista, gmsh = (pytest.importorskip(name) for name in ("pyvista", "gmsh"))
    solid = occ.Box((0, 0, 0), (1, 1, 1))
    for mesh, call in ((trimesh.PointCloud(np.eye(4)[:, :3]), "mesh.convex_hull"),
                       (solid, "mesh.GenerateMesh()"),
                       (occ.OCCGeometry(solid), "mesh.GenerateMesh()")):
        with pytest.raises(odt_plugins.UnsupportedMeshError) as caught:
            odt_plugins.optimize(mesh)
        assert str(caught.value).endswith(f"try {call}")
        odt_plugins.optimize(eval(call))
    basis = skfem.Basis(skfem.MeshTri(), skfem.ElementTriP1())
    for mesh, words in ((pyvista.Table({"a": np.ones(1)}), "a PolyData or Unst.* made of it"),
                        (trimesh.path.Path3D(), "a Trimesh of vertices and faces"),
                        (basis, "the mesh that it is of"),
                        (gmsh.model.mesh, "gmsh.model, if it is of gmsh")):
        with pytest.raises(odt_plugins.UnsupportedMeshError, match=f"try {words}$"):
            odt_plugins.optimize(mesh)


def test_parts_of_a_collection_of_vtk_are_advised():
    vtk = pytest.importorskip("vtkmodules.vtkCommonDataModel")
    with pytest.raises(odt_plugins.UnsupportedMeshError, match=r"try mesh.GetPartition\(0, 0\)"):
        odt_plugins.optimize(vtk.vtkPartitionedDataSetCollection())


@pytest.mark.parametrize("name", ["fixed", "selection"])
def test_the_name_of_an_array_is_no_mask(name):
    points, cells, _ = contract.grid(2, 4)
    with pytest.raises(odt_plugins.InvalidOptionError,
                       match=rf"got {name}='rim'; .* try the array of that name"):
        odt_plugins.remesh((points, cells), 0.2, **{name: "rim"})


@pytest.mark.parametrize("regions", ["auto", "marker", "array"])
def test_blocks_and_regions_both_have_interfaces(regions, monkeypatch):
    seen = []
    monkeypatch.setattr(plan, "run", lambda mesh, options, _: seen.append(mesh) or plan.Outcome(
        mesh.points, mesh.cells, mesh.regions))
    mesh = contract.HOSTS["meshio-tri-blocks"].make()
    block = np.repeat([0, 1], [len(b) for b in mesh.cells])
    label = np.arange(len(block)) % 3
    mesh.cell_data["marker"] = [label[block == 0], label[block == 1]]
    odt_plugins.optimize(mesh, regions=label[::-1] if regions == "array" else regions)
    label = label[::-1] if regions == "array" else label
    truth = np.unique(np.stack([label, block]), axis=1, return_inverse=True)[1].ravel()
    assert np.array_equal(seen[0].regions, truth)


def test_a_density_function_sees_the_caller_coordinates(monkeypatch):
    seen = []

    def run(mesh, options, leaving):
        seen.append(options.density(mesh.points))
        return plan.Outcome(mesh.points, mesh.cells, mesh.regions)

    monkeypatch.setattr(plan, "run", run)
    points, cells, _ = contract.grid(2, 4)
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    space = points @ turn[:2] + [5.0, 6.0, 7.0]
    odt_plugins.optimize((space, cells), density=lambda x: x)
    assert seen[0] == pytest.approx(space, abs=1e-14)


def test_cell_source_equals_all_pairs():
    points, cells, labels = contract.grid(3, 4)
    mesh, _ = simplex_mesh(points, cells, regions=labels)
    outcome = contract.churn(mesh, None)
    source = cell_source(mesh.points, mesh.cells, mesh.regions, outcome.points, outcome.cells,
                         outcome.regions)
    before = contract.View(mesh.points, mesh.cells, {}, {}, {})
    after = contract.View(outcome.points, outcome.cells, {}, {}, {})
    slow = contract.sources(before, after, mesh.regions, outcome.regions)
    assert np.array_equal(source, slow)
    labels0, labels1 = (np.random.default_rng(k).integers(0, 4, m).astype(np.int32)
                        for k, m in enumerate((len(mesh.cells), len(outcome.cells))))
    source = cell_source(mesh.points, mesh.cells, labels0, outcome.points, outcome.cells, labels1)
    assert np.array_equal(source, contract.sources(before, after, labels0, labels1))
    _, regions, ordered = in_input_order(mesh, outcome.points, outcome.cells, outcome.regions)
    assert (np.diff(ordered) >= 0).all()
    assert np.array_equal(regions, mesh.regions[ordered])
