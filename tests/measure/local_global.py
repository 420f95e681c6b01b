"""Local against global methods on meshes whose error is in the low frequencies (Figs 7 and 8)."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np

from measure.meshes import along_curve, inside_free, kuhn_lattice
from measure.part import Part, power_laws
from odt_plugins.compare.start import refine
from odt_plugins.compare.table import Say, Table, Value
from odt_plugins.figures import radius_ratio, volumes
from odt_plugins.generate.clouds import SEED
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.mesh.simplex import reverse

ENOUGH = 1e-3
"""Part of the starting gap to the least energy at which a method has arrived."""

PATIENCE, MOST_STEPS = 20.0, 3000
"""Seconds and steps after which a method that has not arrived is given up."""

SWEEPS = 40
"""Sweeps of the local method whose energy the global one is to reach."""

REPEATS = 3
"""Runs of which the quickest counts."""

RACES = (3, 4, 5, 6)
"""Refinements of the triangle on which all methods run until they have arrived."""

PLANE, SPACE = range(4, 10), range(1, 7)
"""Refinements of the moved triangle and of the moved rhombohedron, as far as the largest size."""

Mesh = tuple[FloatArray, FloatArray, IntArray]


@dataclass(frozen=True)
class Race:
    """One method on one refined mesh.

    Attributes
    ----------
    method : str
    points : int
    gaps : list of float         energy above that of the regular mesh, by step, start first
    qualities : list of float    least radius ratio by step
    seconds : float              until it arrived or was given up
    arrived : bool               the gap fell below ENOUGH of its start
    """

    method: str
    points: int
    gaps: list[float]
    qualities: list[float]
    seconds: float
    arrived: bool


def moved_triangle(level: int, seed: int = SEED) -> Mesh:
    """Equilateral triangle cut into 16, its three inner vertices moved, refined (Section 5.2).

    Returns
    -------
    points (n, 2), the regular points (n, 2), cells (m, 3)
    """
    grid = [(i, j) for j in range(5) for i in range(5 - j)]
    number = {ij: k for k, ij in enumerate(grid)}
    points = np.array([((i + 0.5 * j) / 4.0, j * math.sqrt(0.75) / 4.0) for i, j in grid])
    rows = [(number[i, j], number[i + 1, j], number[i, j + 1])
            for i, j in grid if i + j < 4]
    rows += [(number[i + 1, j], number[i + 1, j + 1], number[i, j + 1])
             for i, j in grid if i + j < 3]
    cells: IntArray = np.array(rows, dtype=np.int32)
    inner = np.array([i > 0 and j > 0 and i + j < 4 for i, j in grid])
    return _moved(points, cells, inner, 0.09, level, seed)


def moved_rhombohedron(level: int, seed: int = SEED) -> Mesh:
    """The counterpart in space: congruent tetrahedra, eight inner vertices moved, refined.

    A lattice of 3^3 cubes is stretched along the diagonal until the six tetrahedra of a cube are
    Sommerville's, q = 0.949: the cells of the body-centred lattice, the best tiling by congruent
    ones, and refined into the same.

    Returns
    -------
    points (n, 3), the regular points (n, 3), cells (m, 4)
    """
    side = 3
    lattice, cells = kuhn_lattice(side)
    points = lattice @ np.array([[-0.5, 0.5, 0.5], [0.5, -0.5, 0.5], [0.5, 0.5, -0.5]]) / side
    cells = np.ascontiguousarray(reverse(cells, volumes(points, cells) < 0))
    inner = ((lattice > 0) & (lattice < side)).all(axis=1)
    return _moved(points, cells, inner, 0.25 / side, level, seed)


def _moved(
    points: FloatArray, cells: IntArray, inner: Any, reach: float, level: int, seed: int
) -> Mesh:
    """Move inner vertices at random and refine as the regular mesh is refined."""
    rng = np.random.default_rng(seed)
    moved = points.copy()
    moved[inner] += rng.uniform(-reach, reach, (int(inner.sum()), points.shape[1]))
    for _ in range(level):
        moved, _ = refine(moved, cells)
        points, cells = refine(points, cells)
    return moved, points, cells


def methods() -> list[tuple[str, Callable[[FloatArray, Any], FloatArray]]]:
    """Local and global methods, each as points, topology -> points."""
    from odt_plugins.engine.odt.global_step import global_step
    from odt_plugins.engine.odt.sweeps import gauss_seidel_sweep, jacobi_sweep

    return [
        ("Jacobi", lambda x, top: jacobi_sweep(x, top, omega=0.8)[0]),
        ("Gauss-Seidel", lambda x, top: gauss_seidel_sweep(x, top)[0]),
        ("global, direct", lambda x, top: global_step(x, top, linear_solver="direct")[0]),
        ("global, AMG", lambda x, top: global_step(x, top, linear_solver="amg")[0]),
    ]


def races_part(sizes: Sequence[int], threads: int, say: Say) -> Part:
    """Let all methods run on the triangle; the sizes only say how far it is refined."""
    levels = [k for k in RACES if 16 * 4**k <= sizes[-1]] or [RACES[0]]
    races = [race for level in levels for race in run_races(level, say)]
    rows: list[tuple[Value, ...]] = [
        (r.points, r.method,
         f"{len(r.gaps) - 1}" if r.arrived else f"more than {len(r.gaps) - 1}",
         r.seconds, r.qualities[-1]) for r in races]
    table = Table("races", f"Steps until the energy gap is {ENOUGH:g} of its start",
                  ("points", "method", "steps", "[s]", "least q"), rows)
    charts = []
    smallest = min(r.points for r in races)
    first = [r for r in races if r.points == smallest]
    for title, values, log in (("Energy above the least (Fig 8)", "gaps", True),
                               ("Least radius ratio (Fig 7)", "qualities", False)):
        series = [(r.method, list(range(len(getattr(r, values)))), getattr(r, values))
                  for r in first]
        charts.append(power_laws(f"{title}, {smallest} points", series, "steps", values,
                                 log_x=False, log_y=log))
    names = dict.fromkeys(r.method for r in races)
    for title, figure in (("Seconds until arrived", lambda r: r.seconds),
                          ("Steps until arrived", lambda r: len(r.gaps) - 1)):
        lines = [(m, [r.points for r in races if r.method == m and r.arrived],
                  [figure(r) for r in races if r.method == m and r.arrived]) for m in names]
        charts.append(power_laws(title, lines, "points", title.split()[0].lower()))
    return Part([table], charts, {"races": [asdict(r) for r in races]})


def run_races(level: int, say: Say) -> list[Race]:
    """Let Jacobi, Gauss-Seidel and the global step, direct and AMG, start from one triangle."""
    races = []
    for name, step in methods():
        races.append(_race(name, step, moved_triangle(level)))
        race = races[-1]
        end = "arrived" if race.arrived else "given up"
        say(f"{race.points} points, {name}: {end} after {len(race.gaps) - 1} steps, "
            f"{race.seconds:.2f} s")
    return races


def _race(name: str, step: Callable[[FloatArray, Any], FloatArray], mesh: Mesh) -> Race:
    from odt_plugins.engine.odt.energy import energy

    x, regular, cells = mesh
    topology = inside_free(cells, len(x))
    least = energy(regular, cells)
    step(x, topology)
    gaps = [energy(x, cells) - least]
    qualities = [float(radius_ratio(x, cells).min())]
    seconds = 0.0
    while gaps[-1] > ENOUGH * gaps[0] and seconds < PATIENCE and len(gaps) <= MOST_STEPS:
        clock = time.perf_counter()
        x = step(x, topology)
        seconds += time.perf_counter() - clock
        gaps.append(energy(x, cells) - least)
        qualities.append(float(radius_ratio(x, cells).min()))
    return Race(name, len(x), gaps, qualities, seconds, gaps[-1] <= ENOUGH * gaps[0])


def forty_sweeps_part(sizes: Sequence[int], threads: int, say: Say) -> Part:
    """Count the global steps that reach the energy of SWEEPS Gauss-Seidel sweeps, and the time.

    Parameters
    ----------
    sizes : ints         no mesh has more cells than the largest, but the coarsest are taken
    threads : int        both sides use one
    say : callable
    """
    meshes: list[Callable[[], Mesh]] = []
    for make, coarse, levels in ((moved_triangle, 16, PLANE), (moved_rhombohedron, 162, SPACE)):
        dim = 2 if make is moved_triangle else 3
        fitting = [k for k in levels if coarse * 2 ** (dim * k) <= sizes[-1]] or [levels[0]]
        meshes += [partial(make, k) for k in fitting[-3:]]
    rows: list[tuple[Value, ...]] = []
    for start in meshes:
        rows.append(_against_sweeps(start()))
        say(f"{rows[-1][0]}, {rows[-1][1]} vertices: {rows[-1][4]} global steps, "
            f"{rows[-1][7]:.2f} of the time of {SWEEPS} sweeps")
    heads = ("mesh", "vertices", f"gap after {SWEEPS} sweeps", "[s]", "global steps", "gap", "[s]",
             "time over time")
    return Part([Table(
        "forty-sweeps", f"Global steps to the energy of {SWEEPS} Gauss-Seidel sweeps (alpha = 1)",
        heads, rows, ["gap: energy above that of the regular mesh, over that of the start"])])


def _against_sweeps(mesh: Mesh) -> tuple[Value, ...]:
    from odt_plugins.engine.odt.energy import energy

    points, regular, cells = mesh
    vertices, cells = along_curve(points, cells)
    points, regular = points[vertices], regular[vertices]
    topology = inside_free(cells, len(points))
    least = energy(regular, cells)
    whole = energy(points, cells) - least
    table = dict(methods())

    def run(name: str, steps: int) -> tuple[float, float]:
        best = np.inf
        for _ in range(REPEATS):
            x, clock = points, time.perf_counter()
            for _ in range(steps):
                x = table[name](x, topology)
            best = min(best, time.perf_counter() - clock)
        return (energy(x, cells) - least) / whole, best

    for name in ("Gauss-Seidel", "global, AMG"):
        table[name](points, topology)
    goal, seconds = run("Gauss-Seidel", SWEEPS)
    steps, x = 0, points
    while steps < SWEEPS and energy(x, cells) - least > goal * whole:
        x = table["global, AMG"](x, topology)
        steps += 1
    reached, taken = run("global, AMG", steps)
    name = "triangle" if points.shape[1] == 2 else "rhombohedron"
    return (name, len(points), goal, seconds, steps, reached, taken, taken / seconds)
