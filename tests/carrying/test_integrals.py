"""Sums of value by volume over cell arrays: the report tells those that changed, and no others."""

from __future__ import annotations

import contract
import meshio
import numpy as np
import pytest

import odt_plugins
from odt_plugins.carrying.integrals import changed_integrals

KINDS = {2: "triangle", 3: "tetra"}


def sizes(points, cells):
    edges = points[cells[:, 1:]] - points[cells[:, :1]]
    return np.abs(np.linalg.det(edges)) / (2.0 if points.shape[1] == 2 else 6.0)


def mesh_with_arrays(d):
    points, cells, _ = contract.grid(d, 5, 3)
    middle = points[cells].mean(axis=1)
    data = {"heat": np.exp(middle[:, 0]) - 1.5, "even": np.full(len(cells), 2.5),
            "flux": np.stack([middle[:, 1], 0.0 * middle[:, 1], -middle[:, 0]], axis=1),
            "gap": np.where(middle[:, 0] > 0.5, np.nan, middle[:, 1]),
            "cell_id": np.arange(len(cells), dtype=np.float64)}
    return meshio.Mesh(points, [(KINDS[d], cells)],
                       cell_data={name: [values] for name, values in data.items()})


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("host", ["meshio", "pyvista"])
def test_integrals_that_changed_are_told(d, host):
    mesh = mesh_with_arrays(d)
    given = mesh
    if host == "pyvista":
        pyvista = pytest.importorskip("pyvista")
        given = pyvista.from_meshio(mesh)
    result, report = odt_plugins.optimize_with_report(given)
    if host == "pyvista":
        result = pyvista.to_meshio(result)
    old = sizes(mesh.points, mesh.cells[0].data)
    new = sizes(result.points[:, :d], result.cells[0].data)
    expected = {}
    for name in ("heat", "flux"):
        x, y = mesh.cell_data[name][0], np.asarray(result.cell_data[name][0])
        change = np.abs(new @ y - old @ x)
        size = old @ np.abs(x)
        expected[name] = np.max(change[size > 0] / size[size > 0]) if x.ndim > 1 else change / size
    assert set(report.integrals) == set(expected)
    for name, change in expected.items():
        assert report.integrals[name] == pytest.approx(change, rel=1e-6)
        assert change > 1e-9
    [line] = [line for line in str(report).splitlines() if line.startswith("integrals")]
    assert f"'heat' by {report.integrals['heat']:.3g}" in line
    assert report.to_dict()["integrals"] == report.integrals


def test_nothing_is_told_where_nothing_changed():
    mesh = mesh_with_arrays(3)
    everything = np.ones(len(mesh.points), dtype=bool)
    _, report = odt_plugins.optimize_with_report(
        mesh, fixed=everything, smoothing={"connectivity": "none"}, finish=False)
    assert report.integrals == {}
    assert "integrals" not in str(report)


def test_an_integral_by_hand():
    points = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0]])
    before = (points, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32))
    moved = points.copy()
    moved[1] = [1.0, 0.0]
    after = (moved, before[1])
    arrays = {"a": np.array([3.0, 1.0]), "zero": np.zeros(2), "single": np.float32([0.0, 1.0])}
    changes = changed_integrals({k: (v, v) for k, v in arrays.items()}, before, after)
    assert changes == pytest.approx({"a": 1.5 / 4.0})


@pytest.mark.parametrize("kind", [np.float32, np.float16])
def test_rounding_of_the_type_is_no_change_of_an_integral(kind):
    points, cells, _ = contract.grid(3, 5, 3)
    heat = np.exp(points[:, 0])
    mesh = meshio.Mesh(points, [("tetra", cells)], {"heat": heat.astype(kind)},
                       {"load": [heat[cells].mean(axis=1).astype(kind)]})
    _, report = odt_plugins.remesh_with_report(mesh, scale=1.5, fields="conserve")
    assert (report.integrals, report.point_integrals) == ({}, {})
    lost = odt_plugins.remesh_with_report(mesh, scale=1.5)[1]
    assert set(lost.integrals) == {"load"}
