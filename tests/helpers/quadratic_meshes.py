"""Quadratic meshes made node by node, and what is checked of them, all by plain slow code."""

from __future__ import annotations

import itertools
from collections import Counter

import contract
import meshio
import numpy as np

from odt_plugins.carrying import roundtrip
from odt_plugins.carrying.curved import Kept
from odt_plugins.engine.run import plan

EDGES = {2: [(0, 1), (1, 2), (2, 0)], 3: [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)]}
VTK = {2: 22, 3: 24}
MESHIO = {2: "triangle6", 3: "tetra10"}


def churned(monkeypatch):
    """Let the engine return any mesh of the same corners, however bent its cells are."""
    monkeypatch.setattr(plan, "run", contract.churn)
    monkeypatch.setattr(roundtrip, "keep_curved",
                        lambda _, mesh, run, *__, **___: Kept(mesh, run(mesh, 0), None))


def widened(points, cells):
    """Nodes and cells with mid-nodes after the corners, as VTK orders them.

    The mid-nodes of the boundary lie beside the middle of their edge.
    """
    dim = cells.shape[1] - 1
    owners = Counter(f for c in cells.tolist() for f in itertools.combinations(sorted(c), dim))
    rim = {(a, b) for f, count in owners.items() if count == 1 for a in f for b in f if a < b}
    nodes, mid, rows = list(points), {}, []
    for cell in cells.tolist():
        row = list(cell)
        for i, j in EDGES[dim]:
            edge = tuple(sorted((cell[i], cell[j])))
            if edge not in mid:
                mid[edge] = len(nodes)
                middle = (points[edge[0]] + points[edge[1]]) / 2
                off = 0.02 if edge in rim else 0.0
                nodes.append(middle + off * np.sin(np.arange(1, len(middle) + 1) * (1 + edge[0])))
            row.append(mid[edge])
        rows.append(row)
    return np.array(nodes), np.array(rows, dtype=int).reshape(-1, dim + 1 + len(EDGES[dim]))


def edges_of(rows, dim):
    """Mid-node of every edge, by its corners; fails where an edge has two."""
    found = {}
    for row in np.asarray(rows).tolist():
        for (i, j), node in zip(EDGES[dim], row[dim + 1 :], strict=True):
            edge = tuple(sorted((row[i], row[j])))
            assert found.setdefault(edge, node) == node
    assert len(set(found.values())) == len(found)
    return found


def _pyvista(points, rows, labels, point, dim):
    import pyvista

    space = np.zeros((len(points), 3))
    space[:, : points.shape[1]] = points
    mesh = pyvista.UnstructuredGrid({VTK[dim]: rows}, space)
    mesh.point_data.update(point)
    if len(rows):
        mesh.cell_data["marker"] = labels
        mesh.cell_data["origin"] = np.arange(len(rows))
    return mesh


def _meshio(points, rows, labels, point, dim):
    return meshio.Mesh(points, [(MESHIO[dim], rows)], point_data=point,
                       cell_data={"marker": [labels], "origin": [np.arange(len(rows))]})


def _skfem(points, rows, labels, point, dim):
    """Without point data, which scikit-fem has none of; the labels as subdomains."""
    import skfem

    kind = {2: skfem.MeshTri2, 3: skfem.MeshTet2}[dim]
    rows = rows if len(rows) else rows[:, : dim + 1]
    mesh = kind(points.T.copy(), rows.T.astype(np.int32), validate=False)
    names = {f"{label}": np.flatnonzero(labels == label) for label in np.unique(labels)}
    return mesh.with_subdomains(names) if len(rows) else mesh


def view(mesh, dim):
    """Nodes, rows, point and cell data of a mesh of any kind; planar nodes in the plane."""
    if hasattr(mesh, "doflocs"):
        labels = np.zeros(mesh.t.shape[1], dtype=int)
        for name, members in mesh.subdomains.items():
            labels[members] = int(name)
        return mesh.doflocs.T.copy(), mesh.dofs.element_dofs.T.copy(), {}, {"marker": labels}
    width = 3 if np.any(np.asarray(mesh.points)[:, dim:]) else dim
    if isinstance(mesh, meshio.Mesh):
        return (mesh.points[:, :width], mesh.cells[0].data, dict(mesh.point_data),
                {name: values[0] for name, values in mesh.cell_data.items()})
    return (np.array(mesh.points)[:, :width], mesh.cells_dict[VTK[dim]],
            {name: np.array(mesh.point_data[name]) for name in mesh.point_data},
            {name: np.array(mesh.cell_data[name]) for name in mesh.cell_data})


MAKERS = {"pyvista": _pyvista, "meshio": _meshio, "skfem": _skfem}
"""Each makes a mesh of nodes, rows, labels, point data and the dimension."""

WITH_DATA = ("pyvista", "meshio")
"""Those of them whose meshes have data of nodes, and their order."""
