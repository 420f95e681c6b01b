"""The physical limit of a Gauss-Seidel sweep: bytes it has to move, bytes a second it could."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from measure.meshes import along_curve, inside_free
from measure.multigrid import random_lattice
from measure.part import Part
from odt_plugins.compare.table import Say, Table, Value
from odt_plugins.mesh.arrays import FloatArray

REPEATS = 7
"""Runs of which the quickest counts."""

TRIAD = 1 << 23
"""Numbers in each array of the triad: far more than any cache holds."""

OPERATIONS = 96
"""Additions and multiplications of doubles for one cell of one star in space: 9 differences, three
squared lengths (15), three cross products (27), determinant (5), its gradient (6), moment (15),
density (4), sums (9), the test of the new volume (6)."""

NODE, MOVE = 32, 24
"""Bytes of a vertex that a sweep reads and writes: three coordinates and a density, and without."""


def sweep_bytes(topology: Any) -> tuple[int, int]:
    """Bytes of a sweep over the movable vertices.

    Parameters
    ----------
    topology : Topology

    Returns
    -------
    least : int       every array read once, the points written once: what must cross the bus
    touched : int     every read and write counted, as if no cache kept anything
    """
    cells, stars = topology.cells, topology.stars
    n, k = topology.movable.size, cells.shape[1]
    moving = int(topology.movable.sum())
    visits = int(np.diff(stars.indptr)[topology.movable].sum())
    least = (NODE * n + MOVE * moving + cells.nbytes + stars.indptr.nbytes
             + stars.indices.nbytes + topology.coloring.order.nbytes)
    touched = visits * (stars.indices.itemsize + cells.itemsize * k + NODE * (k - 1))
    touched += moving * (NODE + MOVE + 2 * stars.indptr.itemsize + 4)
    return int(least), int(touched)


def triad_bandwidth(size: int = TRIAD) -> float:
    """Bytes a second of a = b + s c on one thread; three arrays are counted."""
    from odt_plugins.engine.compiled.kernel import kernel

    @kernel
    def triad(a: FloatArray, b: FloatArray, c: FloatArray, s: float) -> None:
        for i in range(a.shape[0]):
            a[i] = b[i] + s * c[i]

    a, b, c = np.zeros(size), np.ones(size), np.ones(size)
    triad(a, b, c, 3.0)
    return 3 * a.nbytes / _quickest(lambda: triad(a, b, c, 3.0))


def bandwidth_part(sizes: Sequence[int], threads: int, say: Say) -> Part:
    """Hold ODT sweeps of one thread against the memory of the machine.

    Parameters
    ----------
    sizes : ints      about so many tetrahedra, of random lattices
    threads : int     one is used
    say : callable    is told what is measured
    """
    speed = triad_bandwidth()
    rows: list[tuple[Value, ...]] = []
    for size in sizes:
        rows.append(_row(size, speed))
        say(f"ODT sweep of {rows[-1][0]} tets: {rows[-1][1]:.3f} s, "
            f"{rows[-1][4]:.0f} times what the memory needs")
    heads = ("tets", "sweep [s]", "must move [MB]", "at the triad [s]", "sweep over that",
             "touches [MB]", "[GB/s]", "[Gflop/s]")
    notes = [
        f"triad a = b + s c: {speed / 1e9:.1f} GB/s on one thread",
        "must move: every array read once, the points written once; touches: again from every "
        "vertex, which the order along a curve leaves to the caches",
    ]
    return Part([Table("bandwidth", "A Gauss-Seidel sweep against the memory", heads, rows,
                       notes)])


def _row(tets: int, speed: float) -> tuple[Value, ...]:
    from odt_plugins.engine.odt.sweeps import gauss_seidel_sweep

    points, cells = random_lattice(max(tets // 6, 27))
    vertices, cells = along_curve(points, cells)
    points, topology = points[vertices], inside_free(cells, len(vertices))
    least, touched = sweep_bytes(topology)
    visits = int(np.diff(topology.stars.indptr)[topology.movable].sum())
    gauss_seidel_sweep(points, topology)
    seconds = _quickest(lambda: gauss_seidel_sweep(points, topology))
    return (len(cells), seconds, least / 1e6, least / speed, seconds * speed / least,
            touched / 1e6, touched / seconds / 1e9, visits * OPERATIONS / seconds / 1e9)


def _quickest(call: Callable[[], Any]) -> float:
    best = np.inf
    for _ in range(REPEATS):
        clock = time.perf_counter()
        call()
        best = min(best, time.perf_counter() - clock)
    return float(best)
