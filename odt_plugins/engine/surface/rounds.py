"""Stage 1 on a surface: rounds of a position step and of intrinsic Delaunay flips."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from odt_plugins.engine.cells.cost import ENERGY, Cost
from odt_plugins.engine.cells.extremes import Extremes
from odt_plugins.engine.cells.geometry import barycenters, circumcenters, signed_volumes
from odt_plugins.engine.ground.sheet import LOCKED, SMOOTH
from odt_plugins.engine.odt.energy import energy
from odt_plugins.engine.odt.global_step import (
    choose_solve,
    frozen_density,
    graph_laplacian,
    interior_matrix,
)
from odt_plugins.engine.odt.gradient import centers_gradient
from odt_plugins.engine.odt.rounds import Log
from odt_plugins.engine.odt.total_energy import total_energy
from odt_plugins.engine.policy import POLICY
from odt_plugins.engine.surface.density import SurfaceDensity
from odt_plugins.engine.surface.odt import CPT, GIVEN, LAPLACIAN, NOWHERE, ODT, Target, star_centres
from odt_plugins.engine.surface.passes import Surface, flip_all, move_all
from odt_plugins.engine.topology.star import star_sum
from odt_plugins.engine.topology.stencil import make_topology
from odt_plugins.errors import InvalidOptionError
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray
from odt_plugins.mesh.components import components
from odt_plugins.options import Options, worded

CONNECTIVITY = ("auto", "flips", "none")
"""How a surface is reconnected; scipy triangulates the plane and space only."""

TRIALS = 4
"""Step lengths alpha = 1, 1/2, 1/4, ... of a global step."""

LEAST_PULL = 1e-12
"""Part of the mean diagonal of A by which every vertex is held where it is."""


def check_method(
    options: Options, where: str = "for a curved surface", hint: str = ""
) -> None:
    """Refuse what a surface, which is what the error says it is ``where``, does not know.

    Raises
    ------
    InvalidOptionError    method, solver or connectivity
    """
    methods = tuple(dict.fromkeys(method for method, _ in STEPS))
    solvers = tuple(solver for method, solver in STEPS if method == options.method)
    for name, value, known in (("method", options.method, methods),
                               ("solver", options.smoothing.solver, solvers),
                               ("connectivity", options.smoothing.connectivity, CONNECTIVITY)):
        if value not in known:
            option, given = worded(name, value)
            msg = f"got {option}={given!r} {where}; expected one of {known} there{hint}"
            raise InvalidOptionError(msg)


def smooth_surface(
    surface: Surface,
    density: SurfaceDensity,
    options: Options,
    bounds: Extremes,
    log: Log,
    tick: Callable[[float], None],
    watch: Callable[[Surface], object] | None = None,
) -> str:
    """Run stage 1, in place, until the energy settles or the rounds are used up.

    Parameters
    ----------
    surface : Surface
    density : SurfaceDensity
    options : Options
    bounds : Extremes           see :func:`odt_plugins.engine.surface.odt.move_vertices`
    log : Log
    tick : callable             called with the share of the rounds that is done
    watch : callable, optional  called with the surface after every round

    Returns
    -------
    str                         why it stopped
    """
    _flip(surface, options, bounds, log)
    last = np.inf
    for k in range(options.smoothing.rounds):
        rho = density.at(surface.sheet, surface.guards.ground)
        step(surface, rho, options, bounds, log, equal_weights=density.equal_weights)
        surface.resample()
        _flip(surface, options, bounds, log)
        now = surface_energy(surface, rho)
        log.energy.append((options.method, now))
        tick((k + 1) / options.smoothing.rounds)
        if watch is not None:
            watch(surface)
        if last - now <= POLICY.surface_settled * now:
            return f"the energy settled after {k + 1} rounds"
        last = now
    return f"the {options.smoothing.rounds} rounds were used up"


def step(
    surface: Surface, rho: FloatArray, options: Options, bounds: Extremes, log: Log, *,
    equal_weights: bool,
) -> None:
    """Move all vertices once, in place, by the chosen method and solver (Sections 4.1 to 4.3)."""
    move = STEPS[options.method, options.smoothing.solver]
    moved = move(surface, rho, options, bounds, equal_weights)
    log.add("vertex moves", moved)


def _sweep(
    centre: int, surface: Surface, rho: FloatArray, options: Options, bounds: Extremes,
    equal_weights: bool,
) -> int:
    """Move the vertices one after another to the centres of their stars."""
    omega = 1.0 if options.smoothing.omega is None else options.smoothing.omega
    return move_all(surface, Target(centre, rho, equal_weights, omega, NOWHERE), bounds)[0]


def _jacobi(
    centre: int, surface: Surface, rho: FloatArray, options: Options, bounds: Extremes,
    equal_weights: bool,
) -> int:
    """Move all vertices towards the centres that their stars have before any of them moves."""
    vectors = np.zeros_like(surface.points)
    omega = POLICY.damped if options.smoothing.omega is None else options.smoothing.omega
    target = Target(centre, rho, equal_weights, omega, vectors)
    star_centres(surface.sheet, surface.stars(), target, vectors)
    return move_all(surface, target._replace(centre=GIVEN), bounds)[0]


def _global(
    barycentric: bool, surface: Surface, rho: FloatArray, options: Options, bounds: Extremes,
    equal_weights: bool,
) -> int:
    """One step of (4.27) or (4.28) in the tangent planes, shortened until the energy falls."""
    points, triangles = surface.points, surface.triangles
    rho_tau = frozen_density(points, triangles, rho, equal_weights)
    direction = _direction(surface, rho_tau, options, barycentric=barycentric)
    before = energy(points, triangles, rho_tau)
    start = surface.copy()
    for trial in range(TRIALS):
        target = Target(GIVEN, rho, equal_weights, 0.5**trial, direction)
        moved, _ = move_all(surface, target, bounds)
        if equal_weights or energy(points, triangles, rho_tau) < before:
            return moved
        surface.restore(start)
    return 0


STEPS: dict[tuple[str, str], Callable[..., int]] = {
    ("odt", "gauss-seidel"): partial(_sweep, ODT),
    ("odt", "jacobi"): partial(_jacobi, ODT),
    ("odt", "global"): partial(_global, False),
    ("cpt", "gauss-seidel"): partial(_sweep, CPT),
    ("cpt", "jacobi"): partial(_jacobi, CPT),
    ("cpt", "global"): partial(_global, True),
    ("laplacian", "gauss-seidel"): partial(_sweep, LAPLACIAN),
    ("laplacian", "jacobi"): partial(_jacobi, LAPLACIAN),
}
"""The step of every method and solver that surfaces have; it returns how many vertices moved."""


def _direction(
    surface: Surface, rho_tau: FloatArray, options: Options, *, barycentric: bool
) -> FloatArray:
    """Full step -A^-1 grad E of (4.27), or that of (4.28), the gradient in the tangent planes.

    A piece of the surface on which nothing is locked has one vertex pinned: A is singular there.
    So it is among triangles without area, which draw nothing: every vertex is held a little.
    """
    from scipy.sparse import identity

    points, triangles, kind = surface.points, surface.triangles, surface.sheet.kind
    movable = kind != LOCKED
    movable[_pins(triangles, movable)] = False
    topology = make_topology(triangles, movable, kind != SMOOTH, surface.stars())
    centers = barycenters(points, triangles)
    if not barycentric:
        inner = ~topology.boundary_cells
        centers[inner] = circumcenters(points, triangles[inner])
    slope = _tangential(centers_gradient(points, triangles, centers, rho_tau), points, triangles)
    direction = np.zeros_like(points)
    if not movable.any():
        return direction
    weights = rho_tau * signed_volumes(points, triangles)
    matrix, _ = interior_matrix(graph_laplacian(topology, weights), movable)
    scale = float(matrix.diagonal().mean())
    if not scale > 0.0:
        return direction
    solve = choose_solve(options.smoothing.linear_solver, int(movable.sum()))
    regular = matrix / scale + LEAST_PULL * identity(matrix.shape[0], format="csr")
    direction[movable] = -solve(regular, slope[movable] / scale)
    return direction


def _pins(triangles: IntArray, movable: BoolArray) -> IntArray:
    """First vertex of every connected piece without a vertex that is locked."""
    n = len(movable)
    start, end = triangles.ravel(), triangles[:, [1, 2, 0]].ravel()
    piece = components(start, end, n)
    loose = np.ones(int(piece.max()) + 1, dtype=np.bool_)
    loose[piece[~movable]] = False
    first = np.unique(piece, return_index=True)[1]
    return np.asarray(first[loose], dtype=np.int32)


def _tangential(vectors: FloatArray, points: FloatArray, triangles: IntArray) -> FloatArray:
    """Vectors (n, 3) without their part along the normals of the vertices."""
    a, b, c = (points[triangles[:, i]] for i in range(3))
    normal = star_sum(np.cross(b - a, c - a), triangles, len(points))
    square = (normal * normal).sum(axis=1)
    up = np.divide((vectors * normal).sum(axis=1), square, out=np.zeros(len(points)),
                   where=square > 0.0)
    return vectors - up[:, None] * normal


def _flip(surface: Surface, options: Options, bounds: Extremes, log: Log) -> None:
    """Flip to intrinsic Delaunay unless the connectivity is to stay."""
    if options.smoothing.connectivity == "none":
        return
    m = len(surface.triangles)
    everything, changed = np.ones(m, dtype=np.bool_), np.zeros(m, dtype=np.bool_)
    log.add("energy flips", flip_all(surface, Cost(ENERGY, 1.0), bounds, everything, changed))


def surface_energy(surface: Surface, rho: FloatArray) -> float:
    """ODT energy (2.2) of the flat triangles, density at the vertices."""
    if len(surface.metric):
        return total_energy(surface.points, surface.triangles, rho)
    return energy(surface.points, surface.triangles, rho[surface.triangles].mean(axis=1))
