"""Valid meshes whose cells are curved at their boundary, and what Gmsh makes of them."""

from __future__ import annotations

import numpy as np
from scipy.spatial import Delaunay

NAMES = {(2, 2): "triangle6", (2, 3): "triangle10", (2, 4): "triangle15",
         (3, 2): "tetra10", (3, 3): "tetra20", (3, 4): "tetra35"}


def annulus(shape, around=7, seed=0, inner=1.0, outer=1.9):
    """Nodes and cells of an annulus whose rims are round; vertices inside lie at random."""
    rng = np.random.default_rng(seed)
    turn = 2 * np.pi * np.arange(around) / around
    rings = [inner * np.exp(1j * turn), outer * np.exp(1j * turn)]
    r = rng.uniform(inner + 0.25 * (outer - inner), outer - 0.2 * (outer - inner), 3 * around)
    z = np.concatenate([*rings, r * np.exp(2j * np.pi * rng.random(3 * around))])
    points = np.column_stack([z.real, z.imag])
    cells = Delaunay(points).simplices
    hole = np.array([(c < around).all() for c in cells])
    cells = cells[~hole]
    x = points[cells]
    turned = np.linalg.det(x[:, 1:] - x[:, :1]) < 0
    cells[turned] = cells[turned][:, [0, 2, 1]]

    def bent(node, place):
        ring = {v // around for v, _ in place}
        if len(place) == 2 and len(ring) == 1 and max(ring) < 2:
            return node * (inner, outer)[ring.pop()] / np.linalg.norm(node)
        return node

    return _widened(points, cells.tolist(), shape, bent)


def notched(shape, *, flat=False):
    """A grid with one more cell below, which has a corner on its longest edge or beyond."""
    order, n = int(shape[0, 0]), 6
    x, y = np.meshgrid(np.arange(n + 1.0), np.arange(n + 1.0), indexing="ij")
    points = np.column_stack([x.ravel(), y.ravel()])
    points[:, :] += 0.25 * np.sin(np.arange(2 * len(points)).reshape(-1, 2)) * (
        (points > 0) & (points < n)).all(axis=1)[:, None]
    cells = []
    for i in range(n):
        for j in range(n):
            a, b, c, d = i * (n + 1) + j, (i + 1) * (n + 1) + j, (i + 1) * (n + 1) + j + 1, (
                i * (n + 1) + j + 1)
            cells += [[a, b, c], [a, c, d]]
    # A cell on the edge y = 0 between x = 2 and 4, whose outer edge is a deep arc.
    first, mid, last = 2 * (n + 1), 3 * (n + 1), 4 * (n + 1)
    cells.append([first, last, mid])
    points[mid, 1] = 0.0 if flat else -0.1
    deep = {frozenset([first, last]): 1.0, frozenset([first, mid]): 0.1,
            frozenset([mid, last]): 0.1}

    def bent(node, place):
        t = dict(place)[max(v for v, _ in place)] / order
        return node - [0.0, 4 * deep.get(frozenset(v for v, _ in place), 0.0) * t * (1 - t)]

    return _widened(points, cells, shape, bent)


def _widened(points, cells, shape, bent):
    """Nodes and rows of triangles of a higher order.

    A node between corners is where ``bent`` puts its straight place, told of which corners with
    which weights that is.
    """
    order = int(shape[0, 0])
    nodes, places, rows = list(points), {}, []
    for cell in cells:
        row = []
        for weights in shape.tolist():
            place = frozenset((v, w) for v, w in zip(cell, weights, strict=True) if w)
            if len(place) == 1:
                row.append(next(iter(place))[0])
                continue
            if place not in places:
                places[place] = len(nodes)
                nodes.append(bent(sum(w * points[v] for v, w in place) / order, place))
            row.append(places[place])
        if order == 3:
            # The serendipity place of the node in the middle.
            corners, edges = np.array(nodes)[row[:3]], np.array(nodes)[row[3:9]]
            nodes[row[9]] = edges.sum(axis=0) / 4 - corners.sum(axis=0) / 6
        rows.append(row)
    return np.array(nodes), np.array(rows)


def qualities(points, rows, dim, order):
    """Least determinant, largest one and least by that of the corners, by Gmsh."""
    import gmsh

    own = not gmsh.isInitialized()
    if own:
        gmsh.initialize(interruptible=False)
    gmsh.model.add("qualities")
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        entity = gmsh.model.addDiscreteEntity(dim)
        places = np.zeros((len(points), 3))
        places[:, : points.shape[1]] = points
        gmsh.model.mesh.addNodes(dim, entity, np.arange(1, len(points) + 1), places.ravel())
        kind = gmsh.model.mesh.getElementType({2: "triangle", 3: "tetrahedron"}[dim], order)
        tags = np.arange(1, len(rows) + 1)
        gmsh.model.mesh.addElementsByType(entity, kind, tags, np.ravel(rows) + 1)
        return [np.array(gmsh.model.mesh.getElementQualities(tags, name))
                for name in ("minDetJac", "maxDetJac", "minSJ")]
    finally:
        gmsh.model.remove()
        if own:
            gmsh.finalize()
