"""Densities rho: how small cells should be where (Section 2 after Theorem 2.8, Section 4.2).

A size field h means rho = h^-r. Theorem 2.8 equidistributes |tau| rho^(d/(d + 2)), so r = d + 2
gives cells of size h. Densities are evaluated at the vertices, where they are now, from data on
the input mesh, so smoothing does not wear them out. A constant factor changes nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from odt_plugins.engine.cells.elementary import exp, log, power
from odt_plugins.engine.cells.geometry import signed_volumes
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.topology.adjacency import cell_neighbors
from odt_plugins.engine.topology.star import star_sum
from odt_plugins.errors import InvalidOptionError
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.mesh.chunks import Pool, chunks
from odt_plugins.mesh.simplex import corner_mean

NAMES = ("keep", "uniform", "inverse-volume")

SMOOTHING_PASSES = 3
"""Averaging passes over log h: noise of single cells is not worth keeping."""

LEAST_SIZE = 1e-6
"""Sizes below this part of the mean come from flat cells; none is smaller."""

RANGE = 1e100
"""Densities are kept within 1 / RANGE and RANGE: products with them neither overflow nor vanish."""

WALK_LIMIT = 500
"""Cells visited for one point before the best one seen is taken."""


@kernel
def _cell_at(
    queries: FloatArray, q: int, start: IntArray, nodes: FloatArray, cells: IntArray,
    neighbors: IntArray, limit: int,
) -> tuple[int, float, float, float, float]:
    """Cell at a point, by walking from start[q] over the facet with the lowest coordinate.

    Outside the mesh it is the best cell seen, to which the coordinates are clamped.

    Returns
    -------
    cell : int
    b0, b1, b2, b3 : float    barycentric coordinates, none negative; b3 = 0 in the plane
    """
    d = cells.shape[1] - 1
    c = start[q]
    before = -1
    best_low = -np.inf
    best_cell = c
    b0 = b1 = b2 = b3 = 0.0
    for _ in range(limit):
        o, i, j = cells[c, 0], cells[c, 1], cells[c, 2]
        x, y = queries[q, 0] - nodes[o, 0], queries[q, 1] - nodes[o, 1]
        ax, ay = nodes[i, 0] - nodes[o, 0], nodes[i, 1] - nodes[o, 1]
        bx, by = nodes[j, 0] - nodes[o, 0], nodes[j, 1] - nodes[o, 1]
        if d == 2:
            det = ax * by - ay * bx
            w1 = (x * by - y * bx) / det
            w2 = (ax * y - ay * x) / det
            w3 = 0.0
        else:
            e = cells[c, 3]
            z = queries[q, 2] - nodes[o, 2]
            az, bz = nodes[i, 2] - nodes[o, 2], nodes[j, 2] - nodes[o, 2]
            ex, ey = nodes[e, 0] - nodes[o, 0], nodes[e, 1] - nodes[o, 1]
            ez = nodes[e, 2] - nodes[o, 2]
            px, py, pz = by * ez - bz * ey, bz * ex - bx * ez, bx * ey - by * ex
            det = ax * px + ay * py + az * pz
            w1 = (x * px + y * py + z * pz) / det
            px, py, pz = ey * az - ez * ay, ez * ax - ex * az, ex * ay - ey * ax
            w2 = (x * px + y * py + z * pz) / det
            px, py, pz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
            w3 = (x * px + y * py + z * pz) / det
        w0 = 1.0 - w1 - w2 - w3
        low = min(min(min(w0, w1), w2), w3)
        if low > best_low:
            best_low, best_cell = low, c
            b0, b1, b2, b3 = w0, w1, w2, w3
        if low >= 0.0:
            break
        next_cell = -1
        lowest = 0.0
        for a in range(d + 1):
            across = neighbors[c, a]
            w = w0 if a == 0 else w1 if a == 1 else w2 if a == 2 else w3
            if w < lowest and across != -1 and across != before:
                lowest = w
                next_cell = across
        if next_cell == -1:
            break
        before = c
        c = next_cell
    b0, b1, b2, b3 = max(b0, 0.0), max(b1, 0.0), max(b2, 0.0), max(b3, 0.0)
    return best_cell, b0, b1, b2, b3


@kernel
def _interpolate(
    queries: FloatArray,
    start: IntArray,
    nodes: FloatArray,
    cells: IntArray,
    neighbors: IntArray,
    limit: int,
    exponent: float,
    bound: float,
    out: FloatArray,
) -> None:
    """P1 interpolation at points.

    The values stand behind the coordinates in nodes (n, d + 1).  The cell where the walk ends is
    left in start[q].  What is found is kept within 1 / bound and bound and raised to the exponent,
    as by :func:`bounded_power`.
    """
    d = cells.shape[1] - 1
    for q in range(queries.shape[0]):
        c, b0, b1, b2, b3 = _cell_at(queries, q, start, nodes, cells, neighbors, limit)
        result = b0 * nodes[cells[c, 0], d] + b1 * nodes[cells[c, 1], d]
        result += b2 * nodes[cells[c, 2], d]
        if d == 3:
            result += b3 * nodes[cells[c, 3], d]
        value = min(max(result / (b0 + b1 + b2 + b3), 1.0 / bound), bound)
        out[q] = value if exponent == 1.0 else value**exponent
        start[q] = c


@kernel
def _interpolate_metric(
    points: FloatArray, start: IntArray, nodes: FloatArray, metric: FloatArray, cells: IntArray,
    neighbors: IntArray, limit: int,
) -> None:
    """P1 interpolation of rows (n, k) at points, written behind the coordinates of these."""
    d = cells.shape[1] - 1
    for q in range(points.shape[0]):
        c, b0, b1, b2, b3 = _cell_at(points, q, start, nodes, cells, neighbors, limit)
        total = b0 + b1 + b2 + b3
        for k in range(metric.shape[1]):
            value = b0 * metric[cells[c, 0], k] + b1 * metric[cells[c, 1], k]
            value += b2 * metric[cells[c, 2], k]
            if d == 3:
                value += b3 * metric[cells[c, 3], k]
            points[q, d + k] = value / total
        start[q] = c


@dataclass(frozen=True)
class NodalDensity:
    """A density rho = values^power whose values, not powers, are interpolated between vertices.

    Attributes
    ----------
    values : (n,) float64        positive, one per vertex of the input mesh
    power : float
    keeps : bool                 whether they are the sizes of the input mesh
    """

    values: FloatArray
    power: float
    keeps: bool = False


@dataclass(frozen=True)
class Density:
    """A density that can be asked anywhere; made by :func:`make_density`.

    Attributes
    ----------
    inverse_volume : bool        every cell counts the same, rho_tau = 1/|tau| (4.22)
    function : callable or None  rho(points) of the user
    unit : int                   2^unit is about its largest value on the input mesh
    power : float                rho = field^power
    nodes : (n, d + 1) float64   vertices of the input mesh and the field there, in one row that
                                 lies in one line of the cache; empty for rho = 1
    cells, neighbors             the input mesh, where the field lives
    start : (n,) int32           a cell of the input mesh at every vertex
    metric : (n, k) float64       of the metric at the vertices of the input mesh; k = 0 without one
    """

    inverse_volume: bool
    function: Callable[[FloatArray], Any] | None
    unit: int
    power: float
    nodes: FloatArray
    cells: IntArray
    neighbors: IntArray
    start: IntArray
    metric: FloatArray

    @property
    def field(self) -> FloatArray:
        """Values at the vertices of the input mesh, (n,); empty for rho = 1."""
        return self.nodes[:, -1]

    def walk_start(self, count: int) -> IntArray:
        """Cells of the input mesh from which to look for ``count`` points, (count,) int32."""
        walk = np.zeros(count, dtype=np.int32)
        known = min(count, self.start.size)
        walk[:known] = self.start[:known]
        return walk

    def at(
        self,
        points: FloatArray,
        pool: Pool | None = None,
        walk: IntArray | None = None,
    ) -> FloatArray:
        """Evaluate rho, up to a constant factor.

        Parameters
        ----------
        points : (k, d) float64    the vertices of the input mesh, moved; further points may follow,
                                   further columns are not read
        pool                       whose threads share the work
        walk : (k,) int32, optional
            from :meth:`walk_start` or the last call, for points that moved little since; the
            cells where they are now are written to it, unless the field is constant

        Returns
        -------
        (k,) float64               rho > 0; 1 everywhere for "uniform" and "inverse-volume"

        Raises
        ------
        InvalidOptionError         the user's function gives a wrong length or a bad value
        """
        points = np.ascontiguousarray(points[:, : dimension(points)], dtype=np.float64)
        if self.function is not None:
            return bounded_power(np.ldexp(_asked(self.function, points), -self.unit), 1.0)
        if not self.nodes.size:
            return np.ones(len(points))
        if (self.field == self.field[0]).all():
            return np.full(len(points), bounded_power(self.field[:1], self.power)[0])
        start = self.walk_start(len(points)) if walk is None else walk
        values = np.empty(len(points))

        def work(part: slice) -> None:
            _interpolate(
                points[part], start[part], self.nodes, self.cells, self.neighbors, WALK_LIMIT,
                self.power, _bound(self.power), values[part],
            )

        list((map if pool is None else pool.map)(work, chunks(len(points))))
        return values


    def resample(
        self, points: FloatArray, pool: Pool | None = None, walk: IntArray | None = None
    ) -> None:
        """Write the metric behind the coordinates of points, as they are there.

        Parameters as of :meth:`at`.
        """
        if not self.metric.size:
            return
        start = self.walk_start(len(points)) if walk is None else walk

        def work(part: slice) -> None:
            _interpolate_metric(points[part], start[part], self.nodes, self.metric, self.cells,
                               self.neighbors, WALK_LIMIT)

        list((map if pool is None else pool.map)(work, chunks(len(points))))


def dimension(points: FloatArray) -> int:
    """Coordinates in a row of points, behind which a metric may stand, see ``cells.metric``."""
    columns: int = points.shape[1]
    return {5: 2, 9: 3}.get(columns, columns)


def _asked(function: Callable[[FloatArray], Any], points: FloatArray) -> FloatArray:
    """What a function of the user says, (k,), finite and positive."""
    values = _as_floats(function(points.copy()))
    if values.shape != (len(points),):
        msg = (
            f"got shape {values.shape} from the density function for {len(points)} points, "
            f"expected ({len(points)},), try one rho a point"
        )
        raise InvalidOptionError(msg)
    _check_positive(values)
    return values


def bounded_power(values: FloatArray, exponent: float) -> FloatArray:
    """values^exponent for values about 1, kept within 1 / RANGE and RANGE."""
    bound = _bound(exponent)
    kept: FloatArray = np.minimum(np.maximum(values, 1.0 / bound), bound)
    return kept if exponent == 1.0 else power(kept, exponent)


def _bound(exponent: float) -> float:
    """Values within this and its inverse stay within RANGE when raised to the exponent."""
    return RANGE ** (1.0 / max(1.0, abs(exponent)))


def cell_density(cells: IntArray, rho: FloatArray) -> FloatArray:
    """Mean of the vertex densities of every cell, rho_tau, shape (m,): exact for linear rho."""
    return corner_mean(rho, cells)


def inverse_volume_density(points: FloatArray, cells: IntArray) -> FloatArray:
    """rho_tau = 1/|tau| of (4.22) up to a factor: mean volume over volume, shape (m,).

    It is at most RANGE, so that flat cells count for nothing; 1 where all are flat.
    """
    volumes = signed_volumes(points, cells)
    mean = volumes.mean()
    values: FloatArray = mean / np.maximum(volumes, mean / RANGE) if mean else np.ones(len(cells))
    return values


def size_field(points: FloatArray, cells: IntArray, passes: int = SMOOTHING_PASSES) -> FloatArray:
    """Cell size h of a mesh at its vertices, smoothed, mean 1.

    Parameters
    ----------
    points : (n, d) float64
    cells : (m, d + 1) int32    positive
    passes : int                averaging passes over log h, vertices to cells and back

    Returns
    -------
    (n,) float64                mean of |tau|^(1/d) over the star, relative to its mean over the
                                mesh; 1 at vertices without cells, and where all cells are flat
    """
    d = cells.shape[1] - 1
    n = len(points)
    count = star_sum(np.ones(len(cells)), cells, n)
    used = count > 0
    size = star_sum(power(signed_volumes(points, cells), 1 / d), cells, n)
    h = np.ones(n)
    if size.any():
        h[used] = size[used] / count[used]
        h[used] = np.maximum(h[used] / h[used].mean(), LEAST_SIZE)
    return exp(smooth_over_stars(log(h), cells, passes))


def smooth_over_stars(values: FloatArray, cells: IntArray, passes: int) -> FloatArray:
    """Average values at vertices, (n,), over cells and back; those without cells keep theirs."""
    values = values.copy()
    count = star_sum(np.ones(len(cells)), cells, len(values))
    used = count > 0
    for _ in range(passes):
        mean = star_sum(corner_mean(values, cells), cells, len(values))
        values[used] = mean[used] / count[used]
    return values


def _as_floats(values: Any) -> FloatArray:
    cause: Exception | None = None
    found = type(values).__name__
    try:
        raw = np.asarray(values)
        if raw.dtype.kind in "biuf":
            return np.array(raw, dtype=np.float64)
        found += f" and dtype {raw.dtype}"
    except (TypeError, ValueError) as error:
        cause = error
    msg = (
        f"got a density of type {found} that is no array of real numbers, expected "
        f"one of {', '.join(NAMES)}, an array or a function, try density='keep'"
    )
    raise InvalidOptionError(msg) from cause


def _check_positive(values: FloatArray) -> None:
    bad = np.flatnonzero(~(np.isfinite(values) & (values > 0.0)))
    if bad.size:
        msg = (
            f"got density {values[bad[0]]} at index {bad[0]} ({bad.size} of them), expected "
            "finite values above 0, try rho = h^-r of a positive size h"
        )
        raise InvalidOptionError(msg)


def make_density(
    spec: Any,
    exponent: float | None,
    points: FloatArray,
    cells: IntArray,
    neighbors: IntArray | None = None,
) -> Density:
    """Turn ``Options.density`` into a :class:`Density` on the input mesh.

    Parameters
    ----------
    spec : str, array or callable
        "keep" sizes of the input mesh; "uniform"; "inverse-volume" (4.22); (n,) rho at vertices;
        (m,) rho of cells; rho(points) -> (k,); a :class:`NodalDensity`
    exponent : float or None                    r in rho = h^-r of "keep", None for d + 2
    points : (n, d) float64                     input mesh; with a metric behind them
    cells : (m, d + 1) int32                    input mesh, positive
    neighbors : (m, d + 1) int32, optional      from :func:`cell_neighbors`, when already known

    Returns
    -------
    Density

    Raises
    ------
    InvalidOptionError    unknown name, wrong length, values that are not finite and positive, an
                          exponent without "keep"

    References
    ----------
    CMAME 200 (2011) 967-984, Section 5.3: rho = 1/h^r with r = 2 or 3; d + 2 is from Theorem 2.8.
    """
    n, m, d = len(points), len(cells), cells.shape[1] - 1
    width = dimension(points)
    points, metric = points[:, :width], points[:, width:]
    keep = isinstance(spec, str) and spec == "keep"
    if exponent is not None and not keep:
        msg = (
            f"got exponent {exponent!r} with a density other than 'keep', expected None, try "
            "raising your own sizes to the power -r"
        )
        raise InvalidOptionError(msg)
    if exponent is not None and not np.isfinite(exponent):
        msg = f"got exponent {exponent!r}, expected a finite number, try {d + 2}"
        raise InvalidOptionError(msg)
    function: Callable[[FloatArray], Any] | None = None
    unit = 0
    power = 1.0
    field = np.empty(0)
    if isinstance(spec, str):
        if spec == "curvature":
            msg = (
                f"got density 'curvature' for a mesh that is no curved surface, expected one of "
                f"{', '.join(NAMES)}, an array or a function, try density='keep'"
            )
            raise InvalidOptionError(msg)
        if spec not in NAMES:
            msg = (
                f"got density {spec!r}, expected one of {', '.join(NAMES)}, an array or a "
                "function, try density='keep'"
            )
            raise InvalidOptionError(msg)
        if keep:
            field = size_field(points, cells)
            power = -float(d + 2 if exponent is None else exponent)
    elif isinstance(spec, NodalDensity):
        field, power = spec.values, spec.power
    elif callable(spec):
        function = spec
        unit = math.frexp(float(_asked(function, points).max()))[1]
    else:
        field = _vertex_field(_as_floats(spec), points, cells)
    start = np.zeros(n, dtype=np.int32)
    if metric.size and not field.size:
        field = np.ones(n)
    if field.size:
        nodes = np.column_stack([points, field])
        cells = np.array(cells, dtype=np.int32, order="C")
        neighbors = cell_neighbors(cells) if neighbors is None else neighbors
        start[cells] = np.arange(m, dtype=np.int32)[:, None]
    else:
        nodes, cells = np.empty((0, d + 1)), np.empty((0, d + 1), dtype=np.int32)
        neighbors = cells
    inverse = isinstance(spec, str) and spec == "inverse-volume"
    return Density(inverse, function, unit, power, nodes, cells, neighbors, start, metric.copy())


def _vertex_field(values: FloatArray, points: FloatArray, cells: IntArray) -> FloatArray:
    """Array of the user as (n,) values of mean 1; cell values averaged to vertices by volume."""
    n, m = len(points), len(cells)
    if values.shape not in ((n,), (m,)) or (n == m and values.ndim == 1):
        found = f"got a density of shape {values.shape} on {n} vertices and {m} cells"
        if n == m and values.shape == (n,):
            msg = f"{found}, expected what is not ambiguous, try a function rho(points)"
        else:
            msg = f"{found}, expected ({n},) or ({m},), try one rho a vertex or one a cell"
        raise InvalidOptionError(msg)
    _check_positive(values)
    values = np.maximum(values / values.max(), 1.0 / RANGE)
    if values.shape == (m,):
        volumes = signed_volumes(points, cells)
        total = star_sum(volumes, cells, n)
        used = total > 0
        nodal = np.full(n, values.mean())
        nodal[used] = star_sum(values * volumes, cells, n)[used] / total[used]
        values = nodal
    scaled: FloatArray = values / values.mean()
    return scaled
