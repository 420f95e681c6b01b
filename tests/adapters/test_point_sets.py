"""Sets of points where vertices come: those of curved surfaces and of volumes have no holes."""

from __future__ import annotations

import boxes
import meshio
import numpy as np
import pytest

from odt_plugins import remesh, untangle


def walls(cells):
    """Facets of one cell alone."""
    rows = np.sort(np.concatenate([np.delete(cells, i, axis=1)
                                   for i in range(cells.shape[1])]), axis=1)
    rows, count = np.unique(rows, axis=0, return_counts=True)
    return rows[count == 1]


def ball(dim, n):
    """A ball or disk of two regions, the inner one of half the radius."""
    points, cells = boxes.box(dim, n)
    points = 2 * points - 1
    inner = np.abs(points[cells].mean(axis=1)).max(axis=1) < 0.5
    far, norm = np.abs(points).max(axis=1), np.linalg.norm(points, axis=1)
    points = points * (far / np.maximum(norm, 1e-300))[:, None]
    points, cells = untangle((points, cells))
    return points, cells, inner


def named(cells, inner):
    """What each of the sets is to have."""
    return {"inner": np.unique(cells[inner]), "outer": np.unique(cells[~inner]),
            "skin": np.unique(walls(cells)),
            "interface": np.intersect1d(cells[inner], cells[~inner])}


@pytest.mark.parametrize(("dim", "n"), [(2, 12), (3, 8)])
def test_sets_of_curved_surfaces_and_of_volumes_have_the_new_vertices(dim, n):
    points, cells, inner = ball(dim, n)
    before = named(cells, inner)
    mesh = meshio.Mesh(points, [("triangle" if dim == 2 else "tetra", cells)],
                       cell_data={"material": [inner.astype(int)]}, point_sets=before)
    after = remesh(mesh, scale=0.6)
    wanted = named(after.cells[0].data, after.cell_data["material"][0] == 1)
    for name, members in wanted.items():
        assert len(members) > len(before[name])
        np.testing.assert_array_equal(np.sort(after.point_sets[name]), members, err_msg=name)


def test_the_skin_of_a_coarse_box_is_no_volume_and_stays():
    points, cells = boxes.box(3, 5)
    skin, right = np.unique(walls(cells)), points[cells].mean(axis=1)[:, 0] > 0.5
    mesh = meshio.Mesh(points, [("tetra", cells)], point_sets={"skin": skin},
                       cell_data={"material": [right.astype(int)]})
    after = remesh(mesh, scale=0.6, free="periodic")
    now = np.unique(walls(after.cells[0].data))
    assert len(now) > len(skin)
    assert not len(np.setdiff1d(now, after.point_sets["skin"]))
    there = {tuple(row) for row in after.points.tolist()}
    assert all(tuple(row) in there for row in points[skin].tolist())
