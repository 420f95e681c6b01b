"""odtmesh2d, Section 5.3: a coarse truss, uniform refinement, ODT on every level, clean-up."""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Integral, Real

import numpy as np
from numpy.typing import ArrayLike

from odt_plugins.engine.finish.phases import bulk
from odt_plugins.errors import InvalidOptionError, counted, place_within
from odt_plugins.generate.cleanup import clean_up
from odt_plugins.generate.clouds import SEED
from odt_plugins.generate.distance import Distance
from odt_plugins.generate.domain import Domain, fixed_points, make_domain
from odt_plugins.generate.sizes import Size
from odt_plugins.generate.stages import (
    Mesh,
    TooCoarseError,
    Watch,
    check_cover,
    check_edges,
    evened,
    finish,
    refine,
    relax,
    repair,
    settle,
)
from odt_plugins.generate.truss import initial_points, lattice, truss_smoothing
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.options import Progress
from odt_plugins.progress import telling

"""Seed of the points that are left out where sizes are larger."""

MOST_POINTS = 10_000_000
"""More points than this are refused unless ``most_points`` says otherwise."""

COARSE = 1000
"""The coarse mesh has between half and twice as many vertices, or all when there are fewer."""

MOST_COARSE = 60_000
"""Most vertices of a coarse mesh when the domain needs a finer one."""

PROBES = 200_000
"""Points of the bounding box at which the number of vertices is estimated."""

TRUSS_STEPS = 100
EVEN_STEPS = 50
COARSE_ROUNDS = 10
ROUNDS = 5
GLOBAL_STEPS = 2
"""Steps of the truss, and with an even boundary; rounds of ODT on the coarse mesh, twice, and on
every finer one; global steps at the end."""

FEWEST = 3
"""A triangle."""

ON_RIM = 1001
"""Points of each side of the box at which the domain must not go on."""

MOST_LATTICE = 30_000_000
"""Most points of the lattice of which the coarse mesh takes some."""


@dataclass(frozen=True)
class Plan:
    """What is known before a mesh is made.

    Attributes
    ----------
    least : float               smallest value of fh in the domain
    count : float               about how many vertices h0 gives
    """

    least: float
    count: float


def odtmesh2d(
    fd: Distance,
    fh: Size,
    h0: float,
    bbox: ArrayLike,
    pfix: ArrayLike | None = None,
    *,
    level: int | None = None,
    seed: int = SEED,
    most_points: int = MOST_POINTS,
    progress: Progress | bool | None = None,
    watch: Watch | None = None,
) -> tuple[FloatArray, IntArray]:
    """Mesh the domain where fd is negative; the interface is that of distmesh2d.

    Parameters
    ----------
    fd : callable               signed distance d(p) of points (n, 2): (n,), negative inside
    fh : callable               wanted edge length h(p) > 0, up to a constant factor
    h0 : float                  edge length where fh is least
    bbox : (2, 2)               [[xmin, ymin], [xmax, ymax]] around the domain
    pfix : (f, 2), optional     points that become vertices, the first ones of the mesh, in this
                                order; corners belong here, others are rounded off
    level : int, optional       how often the coarse mesh is refined; chosen by the number of
                                points unless given, and lowered while the coarse mesh misses a
                                part of the domain
    seed : int                  of the points left out where sizes are larger
    most_points : int           refuse to make about more vertices than this
    progress : callable         progress(stage, fraction), or True for a bar
    watch : callable            watch(stage, points, cells) after "truss", "coarse", "refinement"
                                and "smoothing" of every level, "optimization" and "clean-up"

    Returns
    -------
    points : (n, 2) float64     boundary vertices on fd = 0
    cells : (m, 3) int32        counterclockwise

    Raises
    ------
    InvalidOptionError          fd is nowhere negative, or beyond bbox as well, fd or fh give no
                                finite numbers or fh none above 0, fixed points outside, h0 too
                                large or too small for the domain, wrong shapes

    References
    ----------
    L. Chen, M. Holst, CMAME 200 (2011) 967-984, doi:10.1016/j.cma.2010.11.007, Section 5.3.
    P.-O. Persson, G. Strang, SIAM Review 46 (2004) 329-345, doi:10.1137/S0036144503429121.

    Examples
    --------
    >>> from odt_plugins.generate import dcircle, huniform, odtmesh2d
    >>> points, cells = odtmesh2d(lambda p: dcircle(p, 0, 0, 1), huniform, 0.2,
    ...                           [[-1, -1], [1, 1]])
    >>> points.shape[1], cells.shape[1]
    (2, 3)
    """
    domain = make_domain(fd, fh, bbox)
    for name, value in (("level", level), ("seed", seed), ("most_points", most_points)):
        whole = isinstance(value, Integral) and not isinstance(value, bool) and int(value) >= 0
        if not whole and not (name == "level" and value is None):
            msg = f"got {name}={value!r}; expected a whole number of at least 0"
            raise InvalidOptionError(msg)
    if isinstance(h0, bool) or not isinstance(h0, Real) or not 0.0 < h0 < math.inf:
        msg = f"got h0={h0!r}; expected an edge length above 0"
        raise InvalidOptionError(msg)
    h0 = float(h0)
    fixed = fixed_points(pfix, domain, h0)
    plan = _plan(domain, h0, fixed, most_points)
    see = watch or (lambda _stage, _points, _cells: None)
    reason = None
    with telling(progress, "coarse mesh") as tell:
        for chosen in _levels(plan, level):
            try:
                mesh = _build(domain, h0, fixed, plan, chosen, int(seed), tell, see)
            except TooCoarseError as exc:
                reason = exc
            else:
                return mesh.points, mesh.cells
    what, name = (f"level={level}", "level") if level else (f"h0={h0:g}", "h0")
    msg = (f"got {what}, too coarse for this domain: {reason}; expected edges shorter than its "
           f"narrowest part, try a smaller {name}=")
    raise InvalidOptionError(msg) from reason


def _levels(plan: Plan, level: int | None) -> list[int]:
    """Levels to try in turn."""
    if level is not None:
        return [int(level)]
    first = max(round(math.log2(max(plan.count, 1.0) / COARSE) / 2), 0)
    return [k for k in range(first, -1, -1) if k == first or plan.count / 4**k <= MOST_COARSE]


def _build(
    domain: Domain, h0: float, fixed: FloatArray, plan: Plan, level: int, seed: int,
    tell: Progress, see: Watch,
) -> Mesh:
    """Make the mesh from a coarse one that is refined ``level`` times.

    Raises
    ------
    TooCoarseError    the coarse mesh misses a part of the domain
    """
    spacing = h0 * 2.0**level
    scale = spacing / plan.least
    width, height = domain.high - domain.low
    boxed = width * height / (spacing**2 * math.sqrt(0.75))
    if boxed > MOST_LATTICE:
        msg = (f"got sizes that ask for a lattice of {boxed:.3g} points to choose from (about "
               f"{counted(round(plan.count / 4**level), 'point')} would stay); expected at most "
               f"{MOST_LATTICE:.3g}, try a larger h0, a smaller bbox or sizes that vary less")
        raise InvalidOptionError(msg)
    # The work of a level is four times that of the one before.
    share = [4.0 ** (k - level - 1) for k in range(level + 1)]
    tell("coarse mesh", 0.0)
    points = initial_points(domain, spacing, plan.least, fixed, np.random.default_rng(seed))
    points = truss_smoothing(points, domain, len(fixed), scale, TRUSS_STEPS)
    mesh = settle(points, domain, len(fixed), scale)
    points, held = evened(mesh, domain, scale)
    points = truss_smoothing(points, domain, held, scale, EVEN_STEPS)
    mesh = settle(points, domain, held, scale)
    mesh.fixed = len(fixed)
    see("truss", mesh.points, mesh.cells)
    check_cover(mesh, domain, scale, lattice(domain, spacing))
    check_edges(mesh, domain)
    refined = level > 0
    _clean(mesh, refined)
    finish(mesh, bulk(2))
    for _ in range(2):
        _clean(mesh, refined)
        relax(mesh, domain, COARSE_ROUNDS)
    check_edges(mesh, domain)
    see("coarse", mesh.points, mesh.cells)
    for k in range(level):
        tell(f"level {k + 1} of {level}", share[k])
        mesh = refine(mesh, domain)
        see("refinement", mesh.points, mesh.cells)
        relax(mesh, domain, ROUNDS)
        if k < level - 1:
            _clean(mesh, refined)
        see("smoothing", mesh.points, mesh.cells)
    tell("optimization", 0.5)
    relax(mesh, domain, GLOBAL_STEPS, globally=True)
    see("optimization", mesh.points, mesh.cells)
    tell("clean-up", 0.9)
    before = len(mesh.points)
    _clean(mesh, False)
    if len(mesh.points) < before:
        relax(mesh, domain, ROUNDS)
    repair(mesh, domain)
    see("clean-up", mesh.points, mesh.cells)
    tell("clean-up", 1.0)
    return mesh


def _clean(mesh: Mesh, always: bool) -> None:
    mesh.points, mesh.cells, _ = clean_up(mesh.points, mesh.cells, mesh.held(), always=always)


def _plan(domain: Domain, h0: float, fixed: FloatArray, most_points: int) -> Plan:
    """Estimate the smallest size and the number of vertices on a lattice of samples.

    Raises
    ------
    InvalidOptionError    fd is nowhere negative, or on the rim of the box; far too many or too few
                          vertices
    """
    width, height = domain.high - domain.low
    spacing = math.sqrt(width * height / PROBES)
    spacing = min(spacing, 0.05 * width, 0.05 * height)
    samples = lattice(domain, spacing)
    depth = domain.distance(samples)
    if not (depth < 0.0).any():
        place = place_within(domain.diagonal, samples[int(depth.argmin())], 6)
        msg = (f"got fd without a negative value at {len(samples)} points of bbox (the least is "
               f"{depth.min():.3g} at ({place})); expected fd < 0 inside the domain, try "
               "a bbox around it")
        raise InvalidOptionError(msg)
    _expect_within(domain, h0)
    size = domain.size(np.concatenate([samples[depth < 0.0], fixed]))
    least = float(size.min())
    inner = size[: len(size) - len(fixed)]
    area = spacing**2 * math.sqrt(0.75) * float(((least / inner) ** 2).sum())
    count = area / (h0**2 * math.sqrt(0.75))
    if count > most_points:
        fitting = h0 * math.sqrt(count / most_points)
        msg = (f"got h0={h0:g}, which gives about {count:.3g} points, more than "
               f"{most_points}; try h0={fitting:.2g} or a larger most_points=")
        raise InvalidOptionError(msg)
    if count < FEWEST / 4:
        msg = (f"got h0={h0:g}, which gives about {counted(round(count), 'point')} for this "
               f"domain; expected at least {FEWEST}, try h0={h0 * math.sqrt(count / 50):.2g}")
        raise InvalidOptionError(msg)
    return Plan(least, count)


def _expect_within(domain: Domain, h0: float) -> None:
    """Refuse a domain that goes on beyond the rim of its box, by more than half an edge.

    Raises
    ------
    InvalidOptionError    fd is below -h0 / 2 somewhere on the rim
    """
    share = np.linspace(0.0, 1.0, ON_RIM)
    one, other = (low + share * (high - low)
                  for low, high in zip(domain.low, domain.high, strict=True))
    rim = np.concatenate([
        *(np.column_stack([one, np.full(ON_RIM, y)]) for y in (domain.low[1], domain.high[1])),
        *(np.column_stack([np.full(ON_RIM, x), other]) for x in (domain.low[0], domain.high[0]))])
    depth = domain.distance(rim)
    least = int(depth.argmin())
    if depth[least] < -h0 / 2.0:
        place = place_within(domain.diagonal, rim[least], 6)
        msg = (f"got fd = {depth[least]:.3g} at ({place}) on the rim of bbox, so that the domain "
               "goes on beyond bbox; expected fd < 0 inside bbox alone, try a larger bbox, or -fd")
        raise InvalidOptionError(msg)
