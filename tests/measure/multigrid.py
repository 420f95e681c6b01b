"""Multigrid for the global step: iterations and seconds over the number of unknowns."""

from __future__ import annotations

import importlib
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from measure.meshes import along_curve, inside_free, kuhn_lattice
from measure.part import Part
from odt_plugins.compare.table import Say, Table, Value
from odt_plugins.figures import volumes
from odt_plugins.generate.clouds import SEED
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.mesh.simplex import reverse

TIGHT = 1e-8
"""Relative residual far below that of a step, to show how iterations grow."""

JITTER = 0.1
"""Most that a coordinate of the lattice is moved by, in spacings."""

HEADS = ("mesh", "unknowns", "entries a row", "levels", "operator complexity",
         "iterations of a step", f"to {TIGHT:g}", "setup [s]", "solve, all components [s]",
         "setup by pyamg alone [s]", "solve by pyamg alone [s]", "assembly and gradient [s]")


def multigrid_part(sizes: Sequence[int], threads: int, say: Say) -> Part:
    """Solve the system of a global step on random meshes with so many unknowns.

    Parameters
    ----------
    sizes : ints      unknowns
    threads : int     one is used
    say : callable    is told what is measured
    """
    rows = []
    for name, start in (("Delaunay, plane", random_plane), ("lattice, space", random_lattice)):
        for size in sizes:
            rows.append(_row(name, *start(size)))
            say(f"multigrid, {name}: {rows[-1][1]} unknowns, {rows[-1][5]} iterations, "
                f"{rows[-1][6]} to {TIGHT:g}")
    return Part([Table("multigrid", "Multigrid of the global step (4.27)", HEADS, rows)])


def random_plane(unknowns: int, seed: int = SEED) -> tuple[FloatArray, IntArray]:
    """Delaunay mesh of random points in a square; its hull is the boundary."""
    from scipy.spatial import Delaunay

    points = np.random.default_rng(seed).random((unknowns, 2))
    cells = Delaunay(points).simplices
    return points, np.ascontiguousarray(reverse(cells, volumes(points, cells) < 0))


def random_lattice(unknowns: int, seed: int = SEED) -> tuple[FloatArray, IntArray]:
    """Lattice of cubes, each cut into six tetrahedra, with all its vertices moved at random."""
    side = round(unknowns ** (1 / 3)) + 1
    points, cells = kuhn_lattice(side)
    moves = np.random.default_rng(seed).uniform(-JITTER, JITTER, points.shape)
    return points + moves, cells


def _row(name: str, points: FloatArray, cells: IntArray) -> tuple[Value, ...]:
    from odt_plugins.engine.cells.geometry import signed_volumes
    from odt_plugins.engine.odt.global_step import graph_laplacian, interior_matrix, step_gradient
    from odt_plugins.engine.odt.multigrid import (
        ITERATIONS,
        STEP_TOLERANCE,
        multigrid,
        solve_columns,
    )

    vertices, cells = along_curve(points, cells)
    points, topology = points[vertices], inside_free(cells, len(vertices))
    clock = time.perf_counter()
    matrix, _ = interior_matrix(
        graph_laplacian(topology, signed_volumes(points, cells)), topology.movable
    )
    right = step_gradient(points, topology, np.ones(len(cells)), "odt", True)[topology.movable]
    scale = float(matrix.diagonal().mean())
    matrix, right = matrix / scale, right / scale
    assembly, clock = time.perf_counter() - clock, time.perf_counter()
    hierarchy = multigrid(matrix)
    setup = time.perf_counter() - clock
    _, tight = solve_columns(hierarchy, right, TIGHT, ITERATIONS)
    clock = time.perf_counter()
    _, taken = solve_columns(hierarchy, right, STEP_TOLERANCE, ITERATIONS)
    solve = time.perf_counter() - clock
    return (name, matrix.shape[0], matrix.nnz / matrix.shape[0], len(hierarchy.levels),
            hierarchy.operator_complexity(), int(taken.max()), int(tight.max()),
            setup, solve, *_pyamg_seconds(matrix, right), assembly)


def _pyamg_seconds(matrix: Any, right: FloatArray) -> tuple[float, float]:
    """Seconds for setup and solve of a step with nothing but pyamg, parameters as ours."""
    from odt_plugins.engine.odt.multigrid import (
        COARSEST,
        DAMPING,
        ITERATIONS,
        STEP_TOLERANCE,
        STRENGTH,
    )

    pyamg: Any = importlib.import_module("pyamg")
    clock = time.perf_counter()
    hierarchy = pyamg.smoothed_aggregation_solver(
        matrix, strength=("symmetric", {"theta": STRENGTH}), improve_candidates=None,
        smooth=("jacobi", {"omega": DAMPING, "weighting": "local"}), max_coarse=COARSEST,
        presmoother=("gauss_seidel", {"sweep": "forward"}),
        postsmoother=("gauss_seidel", {"sweep": "backward"}), coarse_solver="splu",
    )
    setup, clock = time.perf_counter() - clock, time.perf_counter()
    for column in right.T:
        hierarchy.solve(np.ascontiguousarray(column), tol=STEP_TOLERANCE, maxiter=ITERATIONS,
                        accel="cg")
    return setup, time.perf_counter() - clock
