"""Stage 1: rounds of a position step and of connectivity, both lowering the ODT energy."""

from __future__ import annotations

import time
from collections.abc import Callable, Container, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from odt_plugins.engine.cells.cost import ENERGY, Cost
from odt_plugins.engine.cells.extremes import Bounds
from odt_plugins.engine.cells.measures import NO_CELL, QUALITY
from odt_plugins.engine.cells.sphere import mark_non_delaunay
from odt_plugins.engine.compiled.threads import run_ranges
from odt_plugins.engine.moves.passes import flip_pending, measures
from odt_plugins.engine.odt.delaunay import delaunay_exchange
from odt_plugins.engine.odt.density import Density
from odt_plugins.engine.odt.sweeps import StepStats, gauss_seidel_sweep, jacobi_sweep
from odt_plugins.engine.odt.total_energy import total_energy
from odt_plugins.engine.policy import POLICY
from odt_plugins.engine.record.figures import cell_shapes
from odt_plugins.engine.topology.complex import Complex, make_complex, renumbered
from odt_plugins.engine.topology.stencil import Topology, make_topology
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.mesh.chunks import Pool
from odt_plugins.options import Options


@dataclass
class Log:
    """What the stages count and record, and what they leave out.

    Attributes
    ----------
    energy : list of (stage, E)
    counts : dict name -> int
    times : dict stage -> seconds
    without : container of str    names of the phases of stage 2 that are left out
    flips : bool                  whether stage 2 may change cells, or moves vertices alone
    """

    energy: list[tuple[str, float]] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=dict)
    times: dict[str, float] = field(default_factory=dict)
    without: Container[str] = frozenset()
    flips: bool = True

    def add(self, name: str, amount: int) -> None:
        """Add to a count."""
        self.counts[name] = self.counts.get(name, 0) + int(amount)

    def add_time(self, stage: str, seconds: float) -> None:
        """Add to the time of a stage."""
        self.times[stage] = self.times.get(stage, 0.0) + seconds

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Add the time that is spent inside to that of a stage."""
        clock = time.perf_counter()
        yield
        self.add_time(stage, time.perf_counter() - clock)


def overrelaxes(options: Options, dim: int) -> bool:
    """Whether sweeps go beyond the centres of the stars, which pays where finishing follows.

    A move by alpha > 2 raises the energy of its star and the flips lower it again: that leads out
    of more shallow minima than it costs.
    """
    return (
        options.smoothing.omega is None and dim == 3 and options.finish
        and (options.method, options.smoothing.solver) == ("odt", "gauss-seidel")
    )


def relaxation(options: Options, dim: int, k: int) -> float:
    """First alpha of a local sweep in round k = 0, 1, ..."""
    if overrelaxes(options, dim):
        return POLICY.stirred if k < POLICY.stirred_rounds else POLICY.overrelaxed
    if options.smoothing.omega is not None:
        return options.smoothing.omega
    return POLICY.damped if options.smoothing.solver == "jacobi" else 1.0


Step = Callable[
    [FloatArray, Topology, FloatArray | None, Options, bool, float], tuple[FloatArray, StepStats]
]


def _local(
    sweep: Callable[..., tuple[FloatArray, StepStats]], points: FloatArray, topology: Topology,
    rho: FloatArray | None, options: Options, inverse_volume: bool, omega: float,
) -> tuple[FloatArray, StepStats]:
    """A sweep over the vertices, each to the centre of its star: (4.13), (4.20), (4.21)."""
    return sweep(
        points, topology, rho, method=options.method, inverse_volume=inverse_volume,
        omega=omega, threads=options.threads,
    )


def _global(
    points: FloatArray, topology: Topology, rho: FloatArray | None, options: Options,
    inverse_volume: bool, _omega: float,
) -> tuple[FloatArray, StepStats]:
    """All vertices by one linear system: (4.27) of ODT, (4.28) of CPT."""
    from odt_plugins.engine.odt.global_step import global_step

    return global_step(
        points, topology, rho, method="cpt" if options.method == "cpt" else "odt",
        inverse_volume=inverse_volume, linear_solver=options.smoothing.linear_solver,
    )


def _descent(
    points: FloatArray, topology: Topology, rho: FloatArray | None, options: Options,
    inverse_volume: bool, _omega: float,
) -> tuple[FloatArray, StepStats]:
    """All vertices down the gradient of the energy, or by what L-BFGS makes of it."""
    from odt_plugins.engine.odt.descent import lbfgs_step, richardson_step

    step = lbfgs_step if options.smoothing.solver == "lbfgs" else richardson_step
    return step(points, topology, rho, inverse_volume=inverse_volume)


def _voronoi(
    points: FloatArray, topology: Topology, rho: FloatArray | None, _options: Options,
    inverse_volume: bool, _omega: float,
) -> tuple[FloatArray, StepStats]:
    """Every vertex to the centroid of its Voronoi cell, for comparison."""
    from odt_plugins.engine.odt.cvt import cvt_step

    return cvt_step(points, topology, rho, inverse_volume=inverse_volume)


STEPS: dict[tuple[str, str], Step] = {
    ("odt", "gauss-seidel"): partial(_local, gauss_seidel_sweep),
    ("odt", "jacobi"): partial(_local, jacobi_sweep),
    ("odt", "richardson"): _descent,
    ("odt", "global"): _global,
    ("odt", "lbfgs"): _descent,
    ("cpt", "gauss-seidel"): partial(_local, gauss_seidel_sweep),
    ("cpt", "jacobi"): partial(_local, jacobi_sweep),
    ("cpt", "global"): _global,
    ("laplacian", "gauss-seidel"): partial(_local, gauss_seidel_sweep),
    ("laplacian", "jacobi"): partial(_local, jacobi_sweep),
    ("cvt", "gauss-seidel"): _voronoi,
}
"""The position step of every method and solver: those of ``odt_plugins.options.SOLVERS``."""


def position_step(
    points: FloatArray, topology: Topology, rho: FloatArray | None, options: Options,
    inverse_volume: bool, omega: float = 1.0,
) -> tuple[FloatArray, StepStats]:
    """Move all vertices once by the chosen method and solver, (4.1) of Section 4.1.

    Parameters
    ----------
    points : (n, d) float64, topology : Topology
    rho : (n,) float64 or None     density at the vertices
    options : Options              method, solver, linear_solver, threads
    inverse_volume : bool          density (4.22)
    omega : float                  first alpha of a local sweep, see :func:`relaxation`
    """
    step = STEPS[options.method, options.smoothing.solver]
    return step(points, topology, rho, options, inverse_volume, omega)


def held_to_bounds(old: FloatArray, new: FloatArray, cells: IntArray, bounds: Bounds) -> FloatArray:
    """Take back the moves around cells that left the bounds, for steps that no finishing follows.

    Parameters
    ----------
    old, new : (n, d) float64     positions before and after a step
    cells : (m, d + 1) int32
    bounds : Bounds               those of all cells count

    Returns
    -------
    (n, d) float64                ``new`` with some vertices where they were
    """
    new = new.copy()
    before = cell_shapes(old, cells)
    limit = bounds.cells
    quality = np.minimum(before[:, 0], limit.quality)
    large = np.maximum(before[:, 1], limit.large)
    small = np.minimum(before[:, 2], limit.small)
    while True:
        shapes = cell_shapes(new, cells)
        bad = (shapes[:, 0] < quality) | (shapes[:, 1] > large) | (shapes[:, 2] < small)
        back = np.unique(cells[bad])
        back = back[(new[back] != old[back]).any(axis=1)]
        if not back.size:
            return new
        new[back] = old[back]


def exchange(mesh: Complex, bounds: Bounds, log: Log) -> Complex:
    """Replace pieces of the mesh by scipy's Delaunay triangulation (Section 3.2)."""
    cells, regions = mesh.mesh_arrays()
    cells, regions, stats = delaunay_exchange(
        mesh.points, cells, regions, mesh.locked, limit=bounds.locked)
    log.add("delaunay calls", 1)
    log.add("regions exchanged", stats.exchanged)
    if not stats.exchanged:
        return mesh
    return make_complex(mesh.points, cells, regions, mesh.locked, mesh.boundary, mesh.skin)


def exchange_pays(mesh: Complex) -> bool:
    """Whether connectivity 'auto' asks scipy in the first round: of few cells, in space poor ones.

    See ``POLICY.exchange_cells`` and ``POLICY.flips_quality``. Qhull knows no metric.
    """
    if mesh.count() > POLICY.exchange_cells or mesh.points.shape[1] > mesh.dim:
        return False
    if mesh.dim == 2:
        return True
    q = measures(mesh, QUALITY)
    return float(q[q < NO_CELL].mean()) < POLICY.flips_quality


def local_flips(mesh: Complex, bounds: Bounds, log: Log, pool: Pool | None) -> int:
    """Flip towards Delaunay (Section 3.1): Lawson's edges in the plane, energy flips in space."""
    if mesh.dim == 2:
        from odt_plugins.engine.moves.flips2d import lawson_flips

        flips = lawson_flips(
            mesh.points, mesh.cells, mesh.neighbors, mesh.regions, fixed=mesh.locked
        )
    else:
        mesh.status[:] = 0
        work = partial(
            mark_non_delaunay, mesh.points, mesh.cells, mesh.neighbors, mesh.regions, mesh.status
        )
        run_ranges(pool, mesh.used, work)
        flips = flip_pending(
            mesh, Cost(ENERGY, 1.0), POLICY.energy_ring, bounds, POLICY.energy_passes, pool
        )
    log.add("energy flips", flips)
    return flips


def _cells(mesh: Complex, options: Options) -> IntArray:
    """Cells for a position step; sweeps over stars take all slots, also the free ones."""
    sweeps = options.smoothing.solver == "gauss-seidel" and options.method != "cvt"
    return mesh.cells[: mesh.used] if sweeps and options.finish else mesh.mesh_arrays()[0]


def smooth(
    mesh: Complex,
    density: Density,
    options: Options,
    bounds: Bounds,
    log: Log,
    tick: Callable[[float], None],
    watch: Callable[[Complex], object] | None = None,
    pool: Pool | None = None,
) -> tuple[Complex, str]:
    """Run stage 1 until the energy settles or the rounds are used up.

    Parameters
    ----------
    mesh : Complex              its points are changed
    density : Density
    options : Options
    bounds : Bounds
    log : Log
    tick : callable             called with the share of the rounds that is done
    watch : callable, optional  called with the mesh after every round
    pool : Pool, optional
        of options.threads workers

    Returns
    -------
    mesh : Complex              the same or, after an exchange, a new one
    reason : str                why it stopped
    """
    least: list[float] = []
    reason = f"the {options.smoothing.rounds} rounds were used up"
    movable = ~mesh.locked
    cells = _cells(mesh, options)
    topology = make_topology(cells, movable, mesh.boundary, pool=pool)
    settled = POLICY.settled_energy
    if overrelaxes(options, mesh.dim):
        settled = POLICY.stirred_settled * topology.movable_share
    scattered = 0
    pays = options.smoothing.connectivity == "auto" and exchange_pays(mesh)
    walk = density.walk_start(len(mesh.points))
    for k in range(options.smoothing.rounds):
        rho = density.at(mesh.points, pool, walk)
        points, stats = position_step(
            mesh.points, topology, rho, options, density.inverse_volume,
            relaxation(options, mesh.dim, k),
        )
        if not options.finish:
            points = held_to_bounds(mesh.points, points, cells, bounds)
        mesh.points[:] = points
        density.resample(mesh.points, pool, walk)
        log.add("vertex moves", stats.moved)
        log.add("shortened moves", stats.reduced)
        count = mesh.count()
        far = stats.max_move > POLICY.exchange_move
        old = mesh
        flips = 0
        if options.smoothing.connectivity == "delaunay" or (k == 0 and far and pays):
            mesh = exchange(mesh, bounds, log)
        if options.smoothing.connectivity in ("auto", "flips") or (
            options.smoothing.connectivity == "delaunay" and not far
        ):
            flips = local_flips(mesh, bounds, log, pool)
        scattered += flips
        if scattered > POLICY.scattered * count:
            mesh = renumbered(mesh, pool)
            scattered = 0
        if flips > 0 or mesh is not old:
            cells = _cells(mesh, options)
            topology = make_topology(cells, movable, mesh.boundary, pool=pool)
        current = total_energy(mesh.points, cells, rho, pool)
        log.energy.append((options.method, current))
        tick((k + 1) / options.smoothing.rounds)
        if watch is not None:
            watch(mesh)
        least.append(min(current, least[-1]) if least else current)
        before = POLICY.settled_rounds
        if k >= before and least[-1 - before] - least[-1] <= settled * least[-1]:
            reason = f"the energy settled after {k + 1} rounds"
            break
    return renumbered(mesh, pool) if scattered else mesh, reason
