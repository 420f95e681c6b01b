"""Uniform refinement: volumes, conformity, shapes over levels, and what is carried."""

from __future__ import annotations

from itertools import combinations

import meshio
import numpy as np
import pytest
import pyvista
import surface_meshes
import trimesh
from hypothesis import given, settings
from strategies import SEEDS, meshes, positive
from tet_meshes import grid

import odt_plugins
from odt_plugins import generate
from odt_plugins.errors import InvalidMeshError, InvalidOptionError, UnsupportedMeshError
from odt_plugins.generate import refine3d


def simplex_volumes(points, cells):
    x = points[cells]
    return np.linalg.det(x[:, 1:] - x[:, :1]) / (6.0 if cells.shape[1] == 4 else 2.0)


def facet_counts(cells):
    """How often every facet, as a sorted tuple, occurs."""
    counts = {}
    for cell in np.sort(cells, axis=1).tolist():
        for facet in combinations(cell, len(cell) - 1):
            counts[facet] = counts.get(facet, 0) + 1
    return counts


def boundary_of(cells):
    return {facet for facet, count in facet_counts(cells).items() if count == 1}


def halved(facets, middle):
    """Facets (edges or triangles) cut at the mid-points of their edges."""
    out = set()
    for facet in facets:
        if len(facet) == 2:
            out |= {tuple(sorted((end, middle[facet]))) for end in facet}
            continue
        mids = {pair: middle[pair] for pair in combinations(facet, 2)}
        out.add(tuple(sorted(mids.values())))
        for corner in facet:
            near = [node for pair, node in mids.items() if corner in pair]
            out.add(tuple(sorted((corner, *near))))
    return out


def worst_shape(points, cells):
    """Least of 3 r_in / R, from 3 V / S and the linear equations of the circumcenter."""
    x = points[cells]
    edges = x[:, 1:] - x[:, :1]
    area = sum(np.linalg.norm(np.cross(x[:, j] - x[:, i], x[:, k] - x[:, i]), axis=1)
               for i, j, k in combinations(range(4), 3)) / 2
    centre = np.linalg.solve(edges, ((edges**2).sum(axis=2) / 2)[..., None])[..., 0]
    return (9 * simplex_volumes(points, cells) / area / np.linalg.norm(centre, axis=1)).min()


@given(meshes())
@settings(max_examples=25, deadline=None)
def test_refined_meshes_conform_and_fill_every_cell_exactly(mesh):
    points, cells = mesh
    n, k = len(points), cells.shape[1]
    new, parts = generate.uniform_refine((points, cells))
    children = 2 ** (k - 1)
    assert np.array_equal(new[:n], points)
    assert parts.shape == (children * len(cells), k)
    volume = simplex_volumes(new, parts)
    whole = simplex_volumes(points, cells)
    assert (volume > 0).all()
    # every part has the same share of its own cell, so the parts neither overlap nor leave it
    assert np.allclose(volume.reshape(-1, children), whole[:, None] / children, rtol=1e-6)
    start = points[cells][:, :1]
    corners = new[parts].reshape(len(cells), -1, k - 1) - start
    edges = points[cells][:, 1:] - start
    lam = np.linalg.solve(np.swapaxes(edges, 1, 2), np.swapaxes(corners, 1, 2))
    assert lam.min() > -1e-6
    assert lam.sum(axis=1).max() < 1 + 1e-6
    counts = facet_counts(parts)
    assert set(counts.values()) <= {1, 2}
    pairs = sorted({pair for cell in np.sort(cells, axis=1).tolist()
                    for pair in combinations(cell, 2)})
    middle = {pair: n + i for i, pair in enumerate(pairs)}
    ends = np.array(pairs)
    assert np.array_equal(new[n:], (points[ends[:, 0]] + points[ends[:, 1]]) / 2)
    assert boundary_of(parts) == halved(boundary_of(cells), middle)


@given(SEEDS)
@settings(max_examples=15, deadline=None)
def test_shapes_are_bounded_over_levels(seed):
    points = np.random.default_rng(seed).normal(size=(4, 3))
    cells = positive(points, np.array([[0, 1, 2, 3]], dtype=np.int32))
    worst = []
    for _ in range(4):
        points, cells = generate.uniform_refine((points, cells))
        worst.append(worst_shape(points, cells))
    assert worst[-1] > (1 - 1e-9) * worst[0]


def test_a_fixed_diagonal_makes_shapes_worse_at_each_level(monkeypatch):
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0.3, 0.9, 0], [0.2, 0.4, 0.8]])
    cells = np.array([[0, 1, 2, 3]], dtype=np.int32)
    fall = []
    for choose in (refine3d.best_diagonals, lambda points, nodes: np.full(len(nodes), 2)):
        monkeypatch.setattr(refine3d, "best_diagonals", choose)
        p, t = points, cells
        worst = []
        for _ in range(4):
            p, t, _ = refine3d.red_refinement(p, t)
            worst.append(worst_shape(p, t))
        fall.append(worst[-1] / worst[0])
    assert fall[0] > 0.99
    assert fall[1] < 0.5


def test_the_best_of_the_three_diagonals_is_taken():
    rng = np.random.default_rng(3)
    points = rng.normal(size=(4, 3))
    cells = positive(points, np.array([[0, 1, 2, 3]], dtype=np.int32))
    new, parts = generate.uniform_refine((points, cells))
    diagonals = [(4, 9), (5, 8), (6, 7)]
    worst = []
    for a, b in diagonals:
        ring = [v for v in range(4, 10) if v not in (a, b)]
        adjacent = [(i, j) for i, j in combinations(ring, 2) if (i, j) not in diagonals]
        tets = positive(new, np.array([[a, b, i, j] for i, j in adjacent], dtype=np.int32))
        worst.append(odt_plugins.quality((new, tets)).min_quality)
    assert odt_plugins.quality((new, parts[4:])).min_quality == pytest.approx(max(worst))


def test_cells_of_negative_volume_stay_so_and_types_are_kept():
    points, cells = grid(2, 1)
    turned = cells[:, [1, 0, 2, 3]].astype(np.uint16)
    new, parts = generate.uniform_refine((points.astype(np.float32), turned))
    assert new.dtype == np.float32
    assert parts.dtype == np.uint16
    assert (simplex_volumes(new.astype(float), parts.astype(int)) < 0).all()


def test_a_small_integer_type_grows_when_the_vertices_need_it():
    points, cells = grid(3, 1)
    new, parts = generate.uniform_refine((points, cells.astype(np.int8)))
    assert parts.dtype == np.int32
    assert parts.max() == len(new) - 1


def test_regions_keep_their_volume_and_data_follow_their_cells():
    points, cells = grid(2, 2)
    regions = (points[cells].mean(axis=1)[:, 0] > 1).astype(np.int64) * 7
    new, parts, labels = generate.uniform_refine((points, cells, regions))
    assert np.array_equal(labels, np.repeat(regions, 8))
    for label in (0, 7):
        before = simplex_volumes(points, cells)[regions == label].sum()
        after = simplex_volumes(new, parts)[labels == label].sum()
        assert after == pytest.approx(before, rel=1e-13)


def labelled(points, cells):
    """A meshio.Mesh with boundary triangles by side, lines, a vertex, data and sets."""
    faces = np.array(sorted(boundary_of(cells)))
    side = np.isclose(points[faces][:, :, 2].max(axis=1), 0.0).astype(int) + 1
    lines = np.array([[0, 1], [1, 2]])
    size = [len(cells), len(faces), 2, 1]
    return meshio.Mesh(
        points,
        [("tetra", cells), ("triangle", faces), ("line", lines), ("vertex", np.array([[3]]))],
        point_data={"height": points[:, 2].copy(), "id": np.arange(len(points))},
        cell_data={"tag": [np.arange(s) + 100 * i for i, s in enumerate(size)],
                   "side": [np.zeros(size[0], int), side, np.zeros(2, int), np.zeros(1, int)]},
        cell_sets={"first": [np.array([0]), np.array([0, 1]), np.array([1]), np.array([0])]},
        point_sets={"bottom": np.flatnonzero(points[:, 2] == 0.0)},
    )


def test_everything_of_a_meshio_mesh_follows(tmp_path):
    points, cells = grid(2, 3)
    mesh = labelled(points, cells)
    meshio.write(tmp_path / "mesh.vtu", meshio.Mesh(points, mesh.cells[:3]))
    out = generate.uniform_refine(mesh)
    sizes = [len(block.data) for block in out.cells]
    assert sizes == [8 * len(cells), 4 * len(mesh.cells[1].data), 4, 1]
    assert np.allclose(out.point_data["height"], out.points[:, 2])
    assert set(out.point_data["id"].tolist()) <= set(range(len(points)))
    assert np.array_equal(out.cell_data["tag"][0], np.repeat(np.arange(len(cells)), 8))
    assert np.array_equal(out.cell_data["tag"][2], [200, 200, 201, 201])
    assert [len(members) for members in out.cell_sets["first"]] == [8, 8, 2, 1]
    faces, side = out.cells[1].data, out.cell_data["side"][1]
    assert {tuple(sorted(row)) for row in faces.tolist()} == boundary_of(out.cells[0].data)
    assert np.array_equal(side == 2, (out.points[faces][:, :, 2] == 0.0).all(axis=1))
    a, b = points[:2]
    assert np.array_equal(out.points[out.cells[2].data[:2]], [[a, (a + b) / 2], [(a + b) / 2, b]])
    assert set(out.point_sets["bottom"]) == set(np.flatnonzero(out.points[:, 2] == 0.0))
    assert len(mesh.points) == len(points)
    read = generate.uniform_refine(tmp_path / "mesh.vtu")
    assert np.array_equal(read.cells[1].data, faces)


def test_everything_of_a_grid_follows_in_its_place():
    points, cells = grid(2, 3)
    faces = np.array(sorted(boundary_of(cells)))
    flat = np.concatenate([
        np.insert(faces[:3], 0, 3, axis=1).ravel(), np.insert(cells, 0, 4, axis=1).ravel(),
        np.insert(faces[3:], 0, 3, axis=1).ravel(), [2, 0, 1, 1, 5],
    ])
    kinds = [5] * 3 + [10] * len(cells) + [5] * (len(faces) - 3) + [3, 1]
    mesh = pyvista.UnstructuredGrid(flat, kinds, points)
    mesh.cell_data["row"] = np.arange(mesh.n_cells)
    mesh.point_data["at"] = points
    out = generate.uniform_refine(mesh)
    parts = {5: 4, 10: 8, 3: 2, 1: 1}
    assert out.cell_data["row"].tolist() == [
        row for row, kind in enumerate(kinds) for _ in range(parts[kind])]
    assert np.array_equal(out.celltypes, np.array(kinds)[out.cell_data["row"]])
    assert np.allclose(out.point_data["at"], out.points)
    assert out.volume == pytest.approx(mesh.volume)
    triangles = {tuple(sorted(row)) for row in out.cells_dict[5].tolist()}
    assert triangles == boundary_of(out.cells_dict[10])
    whole = np.concatenate([faces[:3], np.zeros((len(cells), 3), int), faces[3:]])
    for row, part in zip(out.cell_data["row"][out.celltypes == 5], out.cells_dict[5], strict=True):
        # barycentric coordinates, from planes that do not pass through the origin
        away = np.array([5.0, 7.0, 11.0])
        inside = np.linalg.solve((points[whole[row]] + away).T, (out.points[part] + away).T)
        assert inside.min() > -1e-9
    assert mesh.n_cells == len(kinds)


def test_a_surface_in_space_is_refined():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    new, parts = generate.uniform_refine((points, faces))
    assert set(facet_counts(parts).values()) == {2}
    assert (len(new), len(parts)) == (10, 16)


def test_two_runs_give_the_same_bits():
    mesh = grid(3, 5)
    one, two = (odt_plugins.refine(mesh, optimize=False) for _ in range(2))
    assert all(np.array_equal(a, b) for a, b in zip(one, two, strict=True))


def test_what_cannot_be_refined_is_refused_with_one_sentence(monkeypatch):
    points, cells = grid(2, 3)
    far = [("tetra", cells), ("triangle", np.array([[0, 13, 26]]))]
    with pytest.raises(InvalidMeshError, match=r"1 triangle \(first: \[0, 13, 26\]\) with an edge"):
        generate.uniform_refine(meshio.Mesh(points, far))
    with pytest.raises(UnsupportedMeshError, match="quad cells beside"):
        generate.uniform_refine(
            meshio.Mesh(points, [("tetra", cells), ("quad", np.array([[0, 1, 4, 3]]))]))
    with pytest.raises(UnsupportedMeshError, match="Trimesh; expected arrays"):
        generate.uniform_refine(trimesh.creation.box())
    strange = pyvista.UnstructuredGrid(
        np.concatenate([np.insert(cells, 0, 4, axis=1).ravel(), [2, 0, 1]]),
        [10] * len(cells) + [2], points)
    with pytest.raises(UnsupportedMeshError, match="poly-vertex"):
        generate.uniform_refine(strange)
    monkeypatch.setattr(refine3d, "MOST_CELLS", 100)
    with pytest.raises(InvalidMeshError, match=r"1 level of refinement would make 384 tetrahedra"):
        generate.uniform_refine((points, cells))


def test_polydata_stays_polydata_with_its_lines_and_vertices():
    sphere = pyvista.Sphere(theta_resolution=6, phi_resolution=6)
    faces = sphere.regular_faces
    mesh = pyvista.PolyData(sphere.points, faces=sphere.faces)
    mesh.lines = np.array([2, *faces[0, :2], 3, *faces[5], 1, 7])
    mesh.verts = np.array([1, 3])
    mesh["height"] = mesh.points[:, 2]
    mesh["Normals"] = sphere.point_normals
    mesh.cell_data["number"] = np.arange(mesh.n_cells)
    found = odt_plugins.refine(mesh, levels=1, optimize=False)
    assert type(found) is pyvista.PolyData
    assert found.is_manifold
    assert found.n_open_edges == 0
    points, n = np.asarray(found.points), mesh.n_points
    middles = 0.5 * (mesh.points[faces] + mesh.points[np.roll(faces, -1, axis=1)])
    lines = np.asarray(found.lines)
    assert lines[[0, 1, 3, 4, 5, 7, 9]].tolist() == [3, *faces[0, :2], 5, *faces[5]]
    assert np.allclose(points[lines[2]], middles[0, 0])
    assert np.allclose(points[lines[[6, 8]]], middles[5, :2])
    assert lines[10:].tolist() == [1, 7]
    assert found.verts.tolist() == [1, 3]
    assert np.allclose(found["height"], points[:, 2])
    assert np.array_equal(points[:n], mesh.points)
    assert np.allclose((found["Normals"] ** 2).sum(axis=1), 1.0)
    assert found.cell_data["number"].tolist() == [
        0, 1, 2, 3, *np.repeat(4 + np.arange(len(faces)), 4)]
    mesh.lines = [2, 0, 1, 2, 3, n - 1]
    with pytest.raises(InvalidMeshError, match="with an edge that no refined cell has"):
        odt_plugins.refine(mesh, optimize=False)


def test_no_refinement_gives_what_any_gives_with_the_cells_of_the_mesh(tmp_path):
    points, cells = surface_meshes.sphere(1)
    meshio.Mesh(points, [("triangle", cells)]).write(tmp_path / "mesh.vtu")
    found = odt_plugins.refine(tmp_path / "mesh.vtu", 0, optimize=False)
    assert type(found) is meshio.Mesh
    same, rows = odt_plugins.refine((points, cells), 0, optimize=False)
    assert np.array_equal(same, points)
    assert np.array_equal(rows, cells)
    assert not np.shares_memory(same, points)
    with pytest.raises(UnsupportedMeshError, match="got an object of type NoneType"):
        odt_plugins.refine(None, 0, optimize=False)


def test_refinement_alone_is_as_often_as_asked_and_takes_no_options():
    mesh = surface_meshes.sphere(1)
    twice = generate.uniform_refine(generate.uniform_refine(mesh))
    found = odt_plugins.refine(mesh, 2, optimize=False)
    assert all(np.array_equal(a, b) for a, b in zip(found, twice, strict=True))
    for other in ({"surface": mesh}, {"threads": 2}):
        with pytest.raises(InvalidOptionError, match=f"got {next(iter(other))}= with optimize=Fal"):
            odt_plugins.refine(mesh, optimize=False, **other)
