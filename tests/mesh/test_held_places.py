"""Places of a mesh that must not come apart, or that are worked around."""

from __future__ import annotations

import meshio
import numpy as np
import pytest
import trimesh

import odt_plugins
from odt_plugins.errors import InvalidMeshError


def patches(n=6):
    """The six sides of a cube as patches of their own, which share places but no vertices."""
    rng = np.random.default_rng(2)
    points, cells = [], []
    u = np.linspace(0, 1, n + 1)
    index = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = (i.ravel() for i in (index[:-1, :-1], index[1:, :-1], index[1:, 1:],
                                      index[:-1, 1:]))
    square = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    for axis in range(3):
        for side in (0, 1):
            x = np.stack([i.ravel() for i in np.meshgrid(u, u, indexing="ij")], axis=1)
            inside = ((x > 0) & (x < 1)).all(axis=1)
            x[inside] += rng.uniform(-0.3, 0.3, (inside.sum(), 2)) / n
            cells.append((square if side else square[:, ::-1]) + len(points) * len(x))
            place = np.insert(x, axis, side, axis=1)
            points.append(place[:, [2, 1, 0]] if axis == 1 else place)
    return np.concatenate(points), np.concatenate(cells)


def test_patches_that_share_places_do_not_come_apart():
    points, cells = patches()
    mesh = trimesh.Trimesh(points, cells, process=False)
    better, report = odt_plugins.optimize_with_report(mesh)
    assert report.after.mean_quality > report.before.mean_quality
    counts = []
    for one in (mesh, better):
        merged = one.copy()
        merged.merge_vertices()
        counts.append(len(merged.vertices))
    assert counts[0] == counts[1] < len(points)
    assert "merge_vertices" in str(report)


def test_a_few_places_where_neighbours_disagree_are_worked_around_and_named():
    sphere = trimesh.creation.icosphere(3)
    points = sphere.vertices + np.random.default_rng(5).normal(0, 0.02, sphere.vertices.shape)
    cells = np.array(sphere.faces)
    cells[100] = cells[100, ::-1]
    better, report = odt_plugins.optimize_with_report((points, cells))
    assert report.after.mean_quality > report.before.mean_quality
    assert "disagree about the outside at 3 edges" in str(report)
    rows = {tuple(np.roll(c, -int(np.argmin(c))).tolist()) for c in better[1]}
    assert tuple(np.roll(cells[100], -int(np.argmin(cells[100]))).tolist()) in rows
    assert (better[0][cells[100]] == points[cells[100]]).all()
    cells[::3] = cells[::3, ::-1]
    with pytest.raises(InvalidMeshError, match="disagree about the outside; expected one orient"):
        odt_plugins.optimize((points, cells))


def test_faces_that_a_file_calls_periodic_still_correspond_when_the_surface_slides(tmp_path):
    gmsh = pytest.importorskip("gmsh")
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.clear()
        gmsh.model.add("periodic")
        gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)
        gmsh.model.occ.synchronize()
        gmsh.model.mesh.setPeriodic(2, [2], [1], [1, 0, 0, 1, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1])
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.25)
        gmsh.model.mesh.generate(3)
        gmsh.write(str(tmp_path / "a.msh"))
    finally:
        gmsh.finalize()
    report = odt_plugins.optimize_file(tmp_path / "a.msh", tmp_path / "b.msh", boundary="slide")
    assert "of periodic faces stay" in str(report)
    x = meshio.read(tmp_path / "b.msh").points
    low, high = (x[np.abs(x[:, 0] - side) < 1e-9][:, 1:] for side in (0, 1))
    away = np.linalg.norm(low[:, None] - high[None], axis=2).min(axis=1)
    assert len(low) == len(high)
    assert away.max() < 1e-9
