"""Slow, obvious twins of the engine's formulas: loops over cells, dense algebra, quadrature."""

from __future__ import annotations

from fractions import Fraction
from itertools import combinations
from math import factorial

import numpy as np


def volume(x):
    return np.linalg.det(x[1:] - x[0]) / factorial(len(x) - 1)


def volumes(points, cells):
    x = points[cells]
    return np.linalg.det(x[:, 1:] - x[:, :1]) / factorial(cells.shape[1] - 1)


def circumcenter(x):
    """Equal distances to all vertices as a linear system."""
    return np.linalg.solve(2.0 * (x[1:] - x[0]), (x[1:] ** 2).sum(axis=1) - (x[0] ** 2).sum())


def exact_circumcenter(x):
    """The same system by Cramer's rule in exact arithmetic."""
    exact = [[Fraction(float(v)) for v in row] for row in x]
    rows = [[a - b for a, b in zip(row, exact[0], strict=True)] for row in exact[1:]]
    right = [sum(v * v for v in row) / 2 for row in rows]
    det = _det(rows)
    offset = [
        _det([[*row[:j], r, *row[j + 1 :]] for row, r in zip(rows, right, strict=True)]) / det
        for j in range(len(rows))
    ]
    return np.array([float(a + b) for a, b in zip(exact[0], offset, strict=True)])


def _det(rows):
    if len(rows) == 1:
        return rows[0][0]
    return sum(
        (-1) ** j * rows[0][j] * _det([row[:j] + row[j + 1 :] for row in rows[1:]])
        for j in range(len(rows))
    )


def quadrature(d, order=7):
    """Barycentric points and weights (sum 1) on a simplex: Gauss-Legendre collapsed from a cube."""
    x, w = np.polynomial.legendre.leggauss(order)
    x, w = (x + 1) / 2, w / 2
    nodes, weights = [], []
    for index in np.ndindex(*(order,) * d):
        rest, weight, coordinates = 1.0, float(factorial(d)), []
        for level, i in enumerate(index):
            coordinates.append(rest * x[i])
            weight *= w[i] * (1 - x[i]) ** (d - 1 - level)
            rest *= 1 - x[i]
        nodes.append([*coordinates, rest])
        weights.append(weight)
    return np.array(nodes), np.array(weights)


def integral(points, cells, function):
    """Integral of function(x, barycentric coordinates, cell) over the mesh."""
    nodes, weights = quadrature(cells.shape[1] - 1)
    return sum(
        volume(points[cell]) * weights @ function(nodes @ points[cell], nodes, cell)
        for cell in cells
    )


def energy(points, cells, rho=lambda x: np.ones(len(x))):
    """(1.1) by quadrature."""

    def error(x, nodes, cell):
        interpolant = nodes @ (points[cell] ** 2).sum(axis=1)
        return np.abs(interpolant - (x**2).sum(axis=1)) * rho(x)

    return integral(points, cells, error)


def energy_tilde(points, cells, rho, factor):
    """(4.15) by quadrature with the given factor in front."""

    def moment(x, nodes, cell):
        return sum(((x - points[i]) ** 2).sum(axis=1) for i in cell) * rho(x)

    return factor * integral(points, cells, moment)


def difference_gradient(function, points, i, step):
    """Central differences of function(points) with respect to vertex i."""
    slope = np.zeros(points.shape[1])
    for axis in range(points.shape[1]):
        ahead, behind = points.copy(), points.copy()
        ahead[i, axis] += step
        behind[i, axis] -= step
        slope[axis] = (function(ahead) - function(behind)) / (2 * step)
    return slope


def star(cells, i):
    return [c for c, cell in enumerate(cells) if i in cell]


def facets(cells):
    """Cells of every facet."""
    table = {}
    for c, cell in enumerate(cells):
        for opposite in range(len(cell)):
            table.setdefault(frozenset(np.delete(cell, opposite).tolist()), []).append(c)
    return table


def laplacian_matrix(points, cells, rho_tau):
    """(4.24) element matrices added up, dense."""
    d = cells.shape[1] - 1
    matrix = np.zeros((len(points), len(points)))
    for c, cell in enumerate(cells):
        element = (d + 1) * np.eye(d + 1) - np.ones((d + 1, d + 1))
        weight = rho_tau[c] * volume(points[cell])
        matrix[np.ix_(cell, cell)] += 2 * weight / (d * (d + 1)) * element
    return matrix


def target(points, cells, i, rho, method, boundary_cells, inverse_volume):
    """Where (4.13), (4.20), (4.21) or (4.22) want vertex i."""
    cells_of_i = star(cells, i)
    if method == "laplacian":
        neighbors = sorted({j for c in cells_of_i for j in cells[c]} - {i})
        return points[neighbors].mean(axis=0)
    total, weights = np.zeros(points.shape[1]), 0.0
    for c in cells_of_i:
        x = points[cells[c]]
        use_barycenter = method == "cpt" or boundary_cells[c]
        center = x.mean(axis=0) if use_barycenter else circumcenter(x)
        weight = 1.0 if inverse_volume else volume(x) * rho[cells[c]].mean()
        total += weight * center
        weights += weight
    return total / weights


def move(points, cells, i, goal, thin, halvings):
    """alpha = 1, 1/2, ... until the star is sound: new place of vertex i and alpha, 0 if none."""
    mine = cells[star(cells, i)]
    old = volumes(points, mine)
    floor = min(old.min(), thin * old.mean()) * (1 - 1e-12)
    for power in range(halvings + 1):
        trial = points.copy()
        trial[i] += 0.5**power * (goal - points[i])
        if volumes(trial, mine).min() >= floor:
            return trial[i], 0.5**power
    return points[i], 0.0


def unsplit_energy(points, cells):
    """(2.2), one cell and one edge at a time."""
    d = cells.shape[1] - 1
    total = 0.0
    for cell in cells:
        edges = sum(((points[i] - points[j]) ** 2).sum() for i, j in combinations(cell, 2))
        total += volume(points[cell]) * edges / ((d + 1) * (d + 2))
    return total


def determinants(points, cells):
    """Signed volumes times d! in extended precision."""
    x = np.asarray(points)[cells].astype(np.longdouble)
    e = x[:, 1:] - x[:, :1]
    if e.shape[1] == 2:
        return e[:, 0, 0] * e[:, 1, 1] - e[:, 0, 1] * e[:, 1, 0]
    return (e[:, 0] * np.cross(e[:, 1], e[:, 2])).sum(axis=1)


def exact_signs(points, cells):
    """Signs of the volumes; in rational numbers where extended precision does not tell."""
    x = np.asarray(points)[cells].astype(np.longdouble)
    extent = np.ptp(x, axis=1).max(axis=1)
    det = determinants(points, cells)
    signs = np.sign(det).astype(int)
    d = cells.shape[1] - 1
    for i in np.flatnonzero(~(np.abs(det) > 100 * np.finfo(np.longdouble).eps * extent**d)):
        row = [[Fraction(float(v)) for v in p] for p in np.asarray(points)[cells[i]]]
        exact = _det([[a - b for a, b in zip(p, row[0], strict=True)] for p in row[1:]])
        signs[i] = (exact > 0) - (exact < 0)
    return signs


def areas(points, cells, kind=np.longdouble):
    """Twice the areas of triangles in space."""
    x = np.asarray(points)[cells].astype(kind)
    normal = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    size = np.abs(normal).max(axis=1)
    unit = np.where(size > 0, size, 1)
    return size * np.sqrt(((normal / unit[:, None]) ** 2).sum(axis=1))


def _length(x):
    return np.sqrt((x**2).sum(axis=-1))


def cell_figures(points, cells, kind=np.longdouble):
    """Radius ratio, least and largest (dihedral) angle in degrees of every cell, without sign.

    d r / R with r = d V / S; R from the product of the sides of a triangle, or the length of
    |a|^2 b x c + |b|^2 c x a + |c|^2 a x b = 12 V R. Angles from a sine and a cosine; of a triangle
    without area, whose corners may be one point, 0, 0 and 180.
    """
    x = np.asarray(points)[cells].astype(kind)
    e = x - x[:, :1]
    unit = np.abs(e).max(axis=(1, 2))
    x = e / np.where(unit > 0, unit, 1)[:, None, None]
    if cells.shape[1] == 3:
        if x.shape[2] == 2:
            x = np.concatenate([x, np.zeros((len(x), 3, 1), kind)], axis=2)
        sides = [x[:, (i + 2) % 3] - x[:, (i + 1) % 3] for i in range(3)]
        area = _length(np.cross(sides[0], sides[1]))
        a, b, c = map(_length, sides)
        top, bottom = 4 * area**2, (a + b + c) * a * b * c
        q = np.divide(top, bottom, out=np.zeros_like(top), where=bottom > 0)
        angle = [np.arctan2(area, -(sides[(i + 1) % 3] * sides[(i + 2) % 3]).sum(axis=1))
                 for i in range(3)]
        angle = np.where(area > 0, angle, np.array([[0], [0], [np.pi]], kind))
    else:
        a, b, c = (x[:, i] for i in (1, 2, 3))
        volume = np.abs((a * np.cross(b, c)).sum(axis=1))
        center = _length((a**2).sum(axis=1)[:, None] * np.cross(b, c)
                         + (b**2).sum(axis=1)[:, None] * np.cross(c, a)
                         + (c**2).sum(axis=1)[:, None] * np.cross(a, b))
        face = [np.cross(x[:, j] - x[:, i], x[:, k] - x[:, i])
                for i, j, k in ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))]
        surface = sum(_length(n) for n in face)
        top, bottom = 6 * volume**2, surface * center
        q = np.divide(top, bottom, out=np.zeros_like(top), where=bottom > 0)
        angle = []
        for i, j in combinations(range(4), 2):
            k, m = (v for v in range(4) if v not in (i, j))
            edge = _length(x[:, m] - x[:, k])
            angle.append(np.arctan2(volume * edge, -(face[i] * face[j]).sum(axis=1)))
    angle = np.degrees(np.array(angle))
    return q, angle.min(axis=0), angle.max(axis=0)


def least_altitude(points, cells, kind=np.longdouble):
    """Least altitude of all cells."""
    x = np.asarray(points)[cells].astype(kind)
    if x.shape[2] == 2:
        x = np.concatenate([x, np.zeros((*x.shape[:2], 1), kind)], axis=2)
    a, b = x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]
    if cells.shape[1] == 3:
        size, facets = _length(np.cross(a, b)), [_length(v) for v in (a, b, b - a)]
    else:
        c = x[:, 3] - x[:, 0]
        size = np.abs((a * np.cross(b, c)).sum(axis=1))
        facets = [_length(np.cross(u, v)) for u, v in ((a, b), (b, c), (c, a), (b - a, c - a))]
    most = np.max(facets, axis=0)
    return np.divide(size, most, out=np.zeros_like(size), where=most > 0).min()


def figures(points, cells, kind=np.longdouble):
    """The figures that an option can keep."""
    q, least, largest = cell_figures(points, np.asarray(cells).astype(np.int64), kind)
    return {"min_quality": q.min(), "p1_quality": np.quantile(q, 0.01), "mean_quality": q.mean(),
            "min_angle": least.min(), "max_angle": largest.max(),
            "share_below_20": (least < 20.0).mean(),
            "min_altitude": least_altitude(points, np.asarray(cells).astype(np.int64), kind)}
