"""Slow, obvious twins of the connectivity code: dictionaries, sets and loops over cells."""

from __future__ import annotations

import itertools
from fractions import Fraction

import numpy as np
from reference import cell_figures


def volume(points, cell):
    """Signed volume."""
    x = points[list(cell)]
    d = points.shape[1]
    return float(np.linalg.det(x[1:] - x[0]) / (1, 1, 2, 6)[d])


def cell_energy(points, cell):
    """Lemma 2.7."""
    d = points.shape[1]
    t = sum(float(((points[i] - points[j]) ** 2).sum())
            for i, j in itertools.combinations(cell, 2))
    return abs(volume(points, cell)) * t / ((d + 1) * (d + 2))


def total_energy(points, cells):
    """Sum of Lemma 2.7 over the cells."""
    return sum(cell_energy(points, cell) for cell in cells.tolist())


def radius_ratio(points, cell):
    """d r / R with R from the linear system of the circumcentre and r = d V / surface."""
    x = points[list(cell)]
    d = points.shape[1]
    edges = x[1:] - x[0]
    radius = np.linalg.norm(np.linalg.solve(2.0 * edges, (edges**2).sum(axis=1)))
    surface = 0.0
    for i in range(d + 1):
        f = np.delete(x, i, axis=0)
        e = f[1:] - f[0]
        surface += np.sqrt(np.linalg.det(e @ e.T)) / (1, 1, 2)[d - 1]
    return d * d * abs(volume(points, cell)) / surface / radius


def directed_facets(cell):
    """Facets of a positive cell as (sorted vertices, parity of the order seen from inside)."""
    out = []
    for i in range(len(cell)):
        facet = list(cell[:i]) + list(cell[i + 1:])
        inversions = sum(a > b for a, b in itertools.combinations(facet, 2))
        out.append((tuple(sorted(facet)), (inversions + i) % 2))
    return out


def facet_owners(cells):
    """Undirected facet -> indices of its cells."""
    owners: dict[tuple[int, ...], list[int]] = {}
    for t, cell in enumerate(cells.tolist()):
        for facet in itertools.combinations(sorted(cell), len(cell) - 1):
            owners.setdefault(facet, []).append(t)
    return owners


def kept_facets(cells, regions):
    """Boundary and interface facets."""
    return {f for f, own in facet_owners(cells).items()
            if len(own) == 1 or regions[own[0]] != regions[own[1]]}


def kept_vertices(cells, regions, n):
    """Mask of the vertices of :func:`kept_facets`."""
    mask = np.zeros(n, dtype=bool)
    mask[sorted({v for f in kept_facets(cells, regions) for v in f})] = True
    return mask


def brute_neighbors(cells):
    """Cell across the facet opposite each vertex, -1 outside."""
    owners = facet_owners(cells)
    out = np.full(cells.shape, -1, dtype=np.int32)
    for t, cell in enumerate(cells.tolist()):
        for i in range(len(cell)):
            facet = tuple(sorted(cell[:i] + cell[i + 1:]))
            others = [s for s in owners[facet] if s != t]
            out[t, i] = others[0] if others else -1
    return out


def in_sphere(points, cell, x):
    """Exact sign of the in-sphere test: 1 inside, 0 on, -1 outside the circumsphere."""
    rows = []
    for v in cell:
        e = [Fraction(float(a)) - Fraction(float(b)) for a, b in zip(points[v], x, strict=True)]
        rows.append([*e, sum(c * c for c in e)])
    edges = [[Fraction(float(a)) - Fraction(float(b)) for a, b in
              zip(points[v], points[cell[0]], strict=True)] for v in cell[1:]]
    orientation = _determinant(edges)
    value = _determinant(rows) * (1 if len(cell) == 3 else -1)
    return int(np.sign(value)) * (1 if orientation > 0 else -1)


def _determinant(m):
    if len(m) == 1:
        return m[0][0]
    return sum((-1) ** j * m[0][j] * _determinant([r[:j] + r[j + 1:] for r in m[1:]])
               for j in range(len(m)) if m[0][j] != 0)


def lawson(points, cells, regions):
    """Flip one edge after the other, each looked for from the start; energy after every flip."""
    cells = [list(c) for c in cells.tolist()]
    energies = [total_energy(points, np.array(cells))]
    drops = []
    while True:
        for (b, c), own in facet_owners(np.array(cells)).items():
            if len(own) == 1 or regions[own[0]] != regions[own[1]]:
                continue
            t, s = own
            (a,), (d,) = set(cells[t]) - {b, c}, set(cells[s]) - {b, c}
            if in_sphere(points, cells[t], points[d]) > 0:
                break
        else:
            return np.array(cells, dtype=np.int32), energies, drops
        i = cells[t].index(a)
        b, c = cells[t][(i + 1) % 3], cells[t][(i + 2) % 3]
        lift = points[[a, b, c]] - points[d]
        drops.append(np.linalg.det(np.c_[lift, (lift**2).sum(axis=1)]) / 6.0)
        cells[t], cells[s] = [a, b, d], [a, d, c]
        energies.append(total_energy(points, np.array(cells)))


def exchange(points, cells, regions, new_cells, fixed=None, limit=(0.0, 0.0, 180.0)):
    """Cells after the exchange of pieces with ``new_cells`` (any orientation), and the count.

    ``limit`` for new cells of fixed vertices: radius ratio, smallest and largest angle, degrees.
    """
    old = [tuple(c) for c in cells.tolist()]
    new = [tuple(c) if volume(points, c) > 0 else (c[1], c[0], *c[2:]) for c in new_cells.tolist()]
    old_owner, new_owner = facet_owners(np.array(old)), facet_owners(np.array(new))
    shared = set(old_owner) & set(new_owner)

    def pieces(owners, count):
        label = list(range(count))
        for facet, own in owners.items():
            if facet not in shared and len(own) == 2:
                x, y = label[own[0]], label[own[1]]
                label = [x if k == y else k for k in label]
        groups: dict[int, list[int]] = {}
        for t, k in enumerate(label):
            groups.setdefault(k, []).append(t)
        return list(groups.values())

    def around(mesh, owners, piece):
        if any(len(owners[f]) == 1 and f not in shared
               for t in piece for f, _ in directed_facets(mesh[t])):
            return None
        return frozenset(x for t in piece for x in directed_facets(mesh[t]) if x[0] in shared)

    by_facets = {around(new, new_owner, p): p for p in pieces(new_owner, len(new))}
    result, labels, count = [], [], 0
    for piece in pieces(old_owner, len(old)):
        ours = [old[t] for t in piece]
        key = around(old, old_owner, piece)
        theirs = None if key is None else by_facets.get(key)
        theirs = None if theirs is None else [new[t] for t in theirs]
        if theirs is not None and len({int(regions[t]) for t in piece}) == 1:
            same_vertices = set(itertools.chain(*ours)) == set(itertools.chain(*theirs))
            v = sum(volume(points, c) for c in ours)
            same_volume = abs(sum(abs(volume(points, c)) for c in theirs) - v) < 1e-9 * v
            size = max(np.ptp(points[list(c)], axis=0).max() for c in theirs)
            wide = all(abs(volume(points, c)) > 1e-9 * size ** points.shape[1] for c in theirs)
            e = sum(cell_energy(points, c) for c in ours)
            falls = sum(cell_energy(points, c) for c in theirs) < e * (1 - 1e-12)
            if same_vertices and same_volume and wide and falls and _agrees(
                    points, ours, theirs, fixed, limit):
                result += theirs
                labels += [int(regions[piece[0]])] * len(theirs)
                count += 1
                continue
        result += ours
        labels += [int(regions[t]) for t in piece]
    return result, labels, count


def _agrees(points, ours, theirs, fixed, limit):
    if fixed is None:
        return True
    before, after = ([c for c in mesh if all(fixed[v] for v in c)] for mesh in (ours, theirs))
    if not after:
        return True
    q, least, largest = cell_figures(points, np.array(after))
    if not before:
        needed = max(limit[0], min(radius_ratio(points, c) for c in ours))
        return q.min() >= needed and least.min() >= limit[1] and largest.max() <= limit[2]
    had = cell_figures(points, np.array(before))
    return (q.min() >= had[0].min() and least.min() >= min(limit[1], had[1].min())
            and largest.max() <= max(limit[2], had[2].max()))


def random_flips(points, cells, rng, count):
    """Other connectivity of the same vertices: random 2-2 flips (d = 2), 2-3 flips (d = 3)."""
    cells = [list(c) for c in cells.tolist()]
    d = points.shape[1]
    for _ in range(count):
        inner = [(f, own) for f, own in facet_owners(np.array(cells)).items() if len(own) == 2]
        facet, (t, s) = inner[rng.integers(len(inner))]
        (top,), (bottom,) = set(cells[t]) - set(facet), set(cells[s]) - set(facet)
        fresh = [[top, bottom, *ridge] for ridge in itertools.combinations(facet, d - 1)]
        size = abs(volume(points, cells[t])) + abs(volume(points, cells[s]))
        sizes = [volume(points, c) for c in fresh]
        if min(map(abs, sizes)) < 1e-3 * size or sum(map(abs, sizes)) > size * (1 + 1e-9):
            continue
        fresh = [c if v > 0 else [c[1], c[0], *c[2:]] for c, v in zip(fresh, sizes, strict=True)]
        cells[t], cells[s] = fresh[0], fresh[1]
        cells += fresh[2:]
    return np.array(cells, dtype=np.int32)


def interpolated(points, cells, x):
    """u_I(x) for u = |x|^2, by looking through all cells for the one that contains x."""
    d = points.shape[1]
    corners = points[cells]
    u = (points**2).sum(axis=1)
    frames = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)
    out = np.empty(len(x))
    for k, y in enumerate(x):
        weights = np.linalg.solve(frames, (y - corners[:, 0])[:, :, None])[:, :, 0]
        weights = np.c_[1.0 - weights.sum(axis=1), weights]
        best = int(np.argmax(weights.min(axis=1)))
        out[k] = weights[best] @ u[cells[best]]
    assert d == x.shape[1]
    return out


def tet_grid(shape, rng, amount=0.2, holes=()):
    """Six tetrahedra a cube around its diagonal, interior vertices moved, some cubes left out.

    The map at the end shortens the diagonals, so that the boundary facets tend to be Delaunay;
    every cell stays positive for amount <= 0.2.
    """
    nx, ny, nz = shape
    index = np.arange((nx + 1) * (ny + 1) * (nz + 1)).reshape(nx + 1, ny + 1, nz + 1)
    points = np.stack(np.meshgrid(*(np.arange(n + 1.0) for n in shape), indexing="ij"),
                      axis=-1).reshape(-1, 3)
    cells = []
    for cube in itertools.product(range(nx), range(ny), range(nz)):
        if cube in holes:
            continue
        for order in itertools.permutations(range(3)):
            corner = np.array(cube)
            cell = [int(index[tuple(corner)])]
            for axis in order:
                corner[axis] += 1
                cell.append(int(index[tuple(corner)]))
            cells.append(cell if volume(points, cell) > 0 else [cell[1], cell[0], *cell[2:]])
    cells = np.array(cells, dtype=np.int32)
    inner = ~kept_vertices(cells, np.zeros(len(cells), dtype=np.int32), len(points))
    points = points + rng.uniform(-amount, amount, points.shape) * inner[:, None]
    return points @ (np.eye(3) - 0.05), cells
