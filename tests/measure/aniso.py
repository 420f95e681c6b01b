"""Adapting a mesh to a function: rounds of a metric from exact second derivatives and remeshing.

Where a mesh is best for the L^2 norm, the error times N^(2 / d), N vertices, does not depend on N.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from typing import NamedTuple

import numpy as np
from skfem import MeshTet, MeshTri

import odt_plugins
from measure.matched import matched
from measure.stretched import stretched
from odt_plugins.compare.table import Say, Table, Value
from odt_plugins.engine.cells.tensors import packed
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.metric.field import hessians_to_metric
from odt_plugins.metric.limits import GROWTH
from odt_plugins.report.interpolation import Errors, interpolation_errors

ROUNDS = 7
"""Metrics, each on the mesh of the one before."""

LARGEST = {2: 4000, 3: 13_800}
"""Vertices, about, of the largest meshes, by dimension."""

HALVINGS = 3
"""How many times as few vertices, half each time, other meshes have, for the order."""

BOTH = {2: 1.5, 3: 1.0}
"""Norm by which errors in L1 and L2 are about as far above the least ones, by dimension."""

SPREAD = range(2300, 2751, 50)
"""Vertices of runs in space whose errors should be near each other."""

PER_VERTEX = {2: 2.0, 3: 5.5}
"""Cells of a mesh for each of its vertices."""

STRETCH = 1e6
"""Largest ratio of lengths in two directions."""

LEAST = 1e-8
"""Second derivative that counts as none."""

STEP = 1e-4
"""Of central differences, which are exact enough for functions that are known."""

HEADS = ("test", "by", "vertices", "cells", "L1", "L2", "largest", "N^(2/d) L1", "N^(2/d) L2", "s")

Mesh = tuple[FloatArray, IntArray]


def sphere(x: FloatArray) -> FloatArray:
    """A layer along a circle or sphere of radius .7 around the origin."""
    return np.asarray(np.tanh(40 * (np.sqrt((x**2).sum(-1) + 1e-12) - 0.7)))


def layers(x: FloatArray) -> FloatArray:
    """A straight and a waved layer that cross each other."""
    waved = x[..., 0] - 0.5 + 0.1 * np.sin(2 * np.pi * x[..., 1])
    return np.asarray(np.tanh(60 * waved) + 0.5 * np.tanh(60 * (x[..., -1] - 0.3)))


def boundary(x: FloatArray) -> FloatArray:
    """Two layers on the boundary."""
    return np.asarray(np.exp(-x[..., 0] / 0.01) + np.exp(-x[..., -1] / 0.02))


TESTS: dict[str, Callable[[FloatArray], FloatArray]] = {
    "sphere": sphere, "layers": layers, "boundary": boundary}
"""Functions on the unit square and the unit cube."""


class Adapted(NamedTuple):
    """The last mesh, its errors, and the seconds that all rounds took."""

    mesh: Mesh
    errors: Errors
    seconds: float

    @property
    def vertices(self) -> int:
        """How many vertices cells have."""
        return len(np.unique(self.mesh[1]))


def hessians(f: Callable[[FloatArray], FloatArray], x: FloatArray) -> FloatArray:
    """Second derivatives (n, d, d) at places (n, d), by central differences."""
    d = x.shape[1]
    out, step = np.zeros((len(x), d, d)), STEP * np.eye(d)
    for i in range(d):
        for j in range(d):
            out[:, i, j] = (f(x + step[i] + step[j]) - f(x + step[i] - step[j])
                            - f(x - step[i] + step[j]) + f(x - step[i] - step[j])) / (4 * STEP**2)
    return out


def start(d: int) -> Mesh:
    """The unit square or cube."""
    axis = np.linspace(0.0, 1.0, 30 if d == 2 else 12)
    grid = (MeshTri if d == 2 else MeshTet).init_tensor(*[axis] * d)
    return grid.p.T.copy(), grid.t.T.astype(np.int32)


def by_us(mesh: Mesh, metric: FloatArray) -> Mesh:
    """The next mesh by this package."""
    points, cells = odt_plugins.remesh(mesh, metric=metric)
    return points, cells


def by_mmg(mesh: Mesh, metric: FloatArray) -> Mesh:
    """The next mesh by mmg2d or mmg3d, which limit the growth of the metric themselves."""
    import mmgpy

    flat = mesh[0].shape[1] == 2
    work = (mmgpy.MmgMesh2D if flat else mmgpy.MmgMesh3D)(
        np.ascontiguousarray(mesh[0]), np.ascontiguousarray(mesh[1]))
    order = [0, 1, 2] if flat else [0, 1, 3, 2, 4, 5]
    work.set_field("tensor", np.ascontiguousarray(packed(metric)[:, order]))
    work.remesh(verbose=-1, hausd=1e-3, hgrad=1.5)
    cells = work.get_triangles() if flat else work.get_tetrahedra()
    return work.get_vertices()[:, : mesh[0].shape[1]], cells.astype(np.int32)


WAYS: dict[str, Callable[[Mesh, FloatArray], Mesh]] = {"odt-plugins": by_us, "mmg": by_mmg}
"""Who makes the next mesh."""


def adapted(test: str, d: int, vertices: int, way: str, norm: float = 2.0) -> Adapted:
    """Adapt a mesh of about so many vertices to a function, for an L^p norm of the error."""
    f, mesh, clock = TESTS[test], start(d), time.perf_counter()
    limits = GROWTH if way == "odt-plugins" else 1e3, STRETCH
    for _ in range(ROUNDS):
        metric = hessians_to_metric(
            *mesh, hessians(f, mesh[0])[None], LEAST, PER_VERTEX[d] * vertices, norm, limits)
        mesh = WAYS[way](mesh, metric)
    seconds = time.perf_counter() - clock
    return Adapted(mesh, interpolation_errors(*mesh, f), seconds)


def order(d: int, found: Sequence[Adapted]) -> float:
    """Order of the L2 error in the length of cells, N^(-1 / d), by least squares."""
    x, y = np.log([[done.vertices, done.errors.l2] for done in found]).T
    return float(-d * ((x - x.mean()) * (y - y.mean())).sum() / ((x - x.mean()) ** 2).sum())


def aniso_tables(say: Say, dims: Sequence[int] = (2, 3)) -> list[Table]:
    """Errors of adapted meshes beside mmg's, and their order.

    Parameters
    ----------
    say : callable     is told what is measured
    dims : ints        2, 3 or both

    Notes
    -----
    For the same metric mmg makes other numbers of vertices; one row has as many as it has. A
    process that mmg ends takes this one with it; its rows are those of the tests that it ends by
    itself: all in the plane, and the sphere in space.
    """
    rows: list[tuple[Value, ...]] = []
    orders: list[tuple[Value, ...]] = []
    for d in dims:
        for test in TESTS:
            name = f"{'plane' if d == 2 else 'space'}, {test}"
            sizes = [LARGEST[d] >> k for k in range(HALVINGS, -1, -1)]
            found = [adapted(test, d, size, "odt-plugins") for size in sizes]
            if len(found) > 1:
                orders.append((name, *(f"{done.errors.l2:.3g}" for done in found),
                               order(d, found)))
            done = {"odt-plugins": found[-1], f"odt-plugins, norm={BOTH[d]}": adapted(
                test, d, LARGEST[d], "odt-plugins", BOTH[d])}
            if find_spec("mmgpy") and (d == 2 or test == "sphere"):
                done["mmg"] = adapted(test, d, LARGEST[d], "mmg")
                done[f"odt-plugins, norm={BOTH[d]}, as many"] = adapted(
                    test, d, done["mmg"].vertices, "odt-plugins", BOTH[d])
            for way, last in done.items():
                rows.append(_row(name, way, d, last))
                say(" ".join(f"{value:.4g}" if isinstance(value, float) else str(value)
                             for value in rows[-1]))
    heads = ("test", *(f"1 / {2**k}" if k else "all" for k in range(HALVINGS, -1, -1)), "order")
    return [Table("aniso", f"Errors after {ROUNDS} rounds", HEADS, rows),
            Table("order", "L2 errors with fewer vertices", heads, orders),
            *([spread(), matched(say)] if 3 in dims else []), stretched(say, dims)]


def spread() -> Table:
    """L2 errors of runs in space that differ by a few vertices."""
    rows: list[tuple[Value, ...]] = []
    for test in ("layers", "boundary"):
        runs = [adapted(test, 3, size, "odt-plugins") for size in SPREAD]
        scaled = [run.vertices ** (2.0 / 3.0) * run.errors.l2 for run in runs]
        rows.append((f"space, {test}", len(runs), f"{min(scaled):.4f}", f"{max(scaled):.4f}",
                     max(scaled) / min(scaled)))
    heads = ("test", "runs", "least N^(2/3) L2", "largest", "ratio")
    return Table("spread", "Runs that differ by a few vertices", heads, rows)


def _row(name: str, way: str, d: int, last: Adapted) -> tuple[Value, ...]:
    n, errors = last.vertices, last.errors
    scale = n ** (2.0 / d)
    return (name, way, n, len(last.mesh[1]), f"{errors.l1:.3g}", f"{errors.l2:.3g}",
            f"{errors.largest:.3g}", f"{scale * errors.l1:.4f}", f"{scale * errors.l2:.4f}",
            last.seconds)
