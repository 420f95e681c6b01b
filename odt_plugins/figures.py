"""Mesh quality: one definition of every figure, in numpy only, for everybody.

The measures are those of L. Chen, M. Holst, CMAME 200 (2011) 967-984,
doi:10.1016/j.cma.2010.11.007, Section 5, and the (dihedral) angles that finite element
users ask for. Nothing here is shared with the optimiser's own kernels.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, fields
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from odt_plugins.errors import InvalidMeshError, InvalidOptionError
from odt_plugins.mesh.cell_geometry import CellGeometry
from odt_plugins.mesh.chunks import chunks, spread
from odt_plugins.mesh.quantiles import quantile
from odt_plugins.mesh.seen import as_seen
from odt_plugins.mesh.simplex import SimplexMesh
from odt_plugins.table import table_html, table_lines

FloatArray = NDArray[np.float64]

EDGES = {3: ((0, 1), (0, 2), (1, 2)), 4: ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))}
"""Local edges of a triangle and of a tetrahedron, in the order of the six dihedral angles."""

ANGLE_LIMITS = (5.0, 10.0, 20.0)


class CellFigures(NamedTuple):
    """What is known of every cell: seven arrays of shape (m,)."""

    quality: FloatArray
    min_angle: FloatArray
    max_angle: FloatArray
    amips: FloatArray
    volume: FloatArray
    circumradius: FloatArray
    altitude: FloatArray


@dataclass(frozen=True)
class QualitySummary:
    """The named figures of a mesh.

    Attributes
    ----------
    dim : int                                       2 for triangles, 3 for tetrahedra
    n_points, n_cells : int
    min_quality, p1_quality, mean_quality : float   radius ratio (5.1): least, 1 % quantile, mean
    min_angle, max_angle : float                    (dihedral) angles in degrees
    mean_amips, max_amips : float                   AMIPS energy: mean, greatest
    below_5, below_10, below_20 : int               cells whose smallest angle is below it
    inverted : int                                  cells of zero or negative signed volume
    uniformity : float                              std(R) / mean(R), h constant
    volume : float                                  sum of the signed volumes; of triangles their
                                                    areas, which is `area` as well. Curved cells
                                                    count as they are, but on surfaces
    min_altitude : float                            least altitude of a cell, in the caller's unit:
                                                    over the wave speed, the time step of explicit
                                                    dynamics
    turned : int                                    cells of mixed orientation that were turned
                                                    before they were measured
    cells : CellFigures or None                     of every cell, from :func:`odt_plugins.quality`
    """

    dim: int
    n_points: int
    n_cells: int
    min_quality: float
    p1_quality: float
    mean_quality: float
    min_angle: float
    max_angle: float
    mean_amips: float
    max_amips: float
    below_5: int
    below_10: int
    below_20: int
    inverted: int
    uniformity: float
    volume: float
    min_altitude: float
    turned: int = 0
    cells: CellFigures | None = field(default=None, compare=False, repr=False)

    @property
    def share_below_20(self) -> float:
        """Part of the cells whose smallest angle is below 20 degrees."""
        return self.below_20 / self.n_cells

    @property
    def area(self) -> float:
        """Sum of the areas; tetrahedra have a volume instead."""
        if self.dim != 2:
            msg = "got tetrahedra, which have no area; expected triangles, try volume"
            raise AttributeError(msg)
        return self.volume

    def __str__(self) -> str:
        """A table, one row per figure."""
        return "\n".join(table_lines({"": self})[1:])

    def _repr_html_(self) -> str:
        """The same for a notebook."""
        return table_html({"": self})

    def to_dict(self) -> dict[str, int | float | None]:
        """Give the figures as plain numbers; a figure that is not finite becomes None.

        The volume of triangles has the name "area".
        """
        values = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "cells"}
        if self.dim == 2:
            values["area"] = values.pop("volume")
        return {k: v if np.isfinite(v) else None for k, v in values.items()}


def radius_ratio(points: ArrayLike, cells: ArrayLike) -> FloatArray:
    """Radius ratio d r_in / R of every simplex (5.1): 1 for the regular one, 0 for a flat one.

    Parameters
    ----------
    points : (n, d) float    coordinates, d = 2 or 3, any unit
    cells : (m, k) int       triangles (k = 3, in the plane or in space) or tetrahedra (k = 4)

    Returns
    -------
    (m,) float64             in [-1, 1]; negative where the signed volume is negative

    Raises
    ------
    InvalidMeshError         shapes or indices that make no simplices

    Notes
    -----
    2 r/R = 16 A^2 / ((a + b + c) a b c) and 3 r/R = 108 V^2 / (S |N|) with S the surface and
    N = |a|^2 b x c + |b|^2 c x a + |c|^2 a x b for the edges a, b, c from the first vertex;
    |N| = 12 V R. Neither has the differences of side lengths of (5.1), which cancel in slivers.

    References
    ----------
    CMAME 200 (2011) 967-984, Section 5, (5.1).
    """
    p, t = _checked(points, cells)
    out = np.empty(len(t))
    for part, geometry in _geometries(p, t):
        out[part] = geometry.quality()
    return out


def angles(points: ArrayLike, cells: ArrayLike) -> FloatArray:
    """Angles of every triangle, or dihedral angles of every tetrahedron, in degrees.

    Parameters
    ----------
    points : (n, d) float    coordinates, d = 2 or 3
    cells : (m, k) int       triangles or tetrahedra

    Returns
    -------
    (m, 3) float64           angles at the three vertices, in the order of the cell, or
    (m, 6) float64           dihedral angles at the edges 01, 02, 03, 12, 13, 23

    Raises
    ------
    InvalidMeshError         shapes or indices that make no simplices

    Notes
    -----
    Every angle is arctan2 of a sine (from the volume) and a cosine (a scalar product), so that
    angles near 0 and 180 degrees are as exact as any other. Orientation plays no part.
    """
    p, t = _checked(points, cells)
    out = np.empty((len(t), 3 if t.shape[1] == 3 else 6))
    for part, geometry in _geometries(p, t):
        out[part] = geometry.angles().T
    return out


def volumes(points: ArrayLike, cells: ArrayLike) -> FloatArray:
    """Signed volume (area in 2-D) of every cell, (m,) float64, in the caller's unit."""
    p, t = _checked(points, cells)
    out = np.empty(len(t))
    for part, geometry in _geometries(p, t):
        out[part] = geometry.volume()
    return out


def uniformity(
    points: ArrayLike,
    cells: ArrayLike,
    h: Callable[[FloatArray], ArrayLike] | ArrayLike | None = None,
) -> float:
    """Uniformity std(R/h) / mean(R/h) of a mesh with respect to a size field h.

    Parameters
    ----------
    points : (n, d) float
    cells : (m, d + 1) int
    h : None or float        constant size (the value plays no part)
        (m,) float           size per cell; taken as such also when m = n
        (n,) float           size per vertex; a cell takes the mean of its vertices
        callable             h(x) for x (m, d), called at the circumcentres

    Returns
    -------
    float                    R is the circumradius, std the sample deviation (N - 1);
                             0 is perfectly uniform, infinite with a flat cell, 0 for one cell

    Raises
    ------
    InvalidMeshError         shapes or indices that make no simplices
    InvalidOptionError       h of a wrong length, or not finite and positive

    References
    ----------
    CMAME 200 (2011) 967-984, Section 5 (uniformity), Fig. 4.
    """
    p, t = _checked(points, cells)
    radius = np.empty(len(t))
    centre = np.empty((len(t), p.shape[1])) if callable(h) else None
    for part, geometry in _geometries(p, t):
        radius[part] = geometry.circumradius()
        if centre is not None:
            centre[part] = geometry.circumcenter()
    if h is None:
        return _variation(radius)
    if callable(h):
        if not np.isfinite(radius).all():
            return float("inf")
        size = np.asarray(h(np.asarray(centre)), dtype=np.float64)
    else:
        size = np.asarray(h, dtype=np.float64)
    per_vertex = size.shape == (len(p),) and not callable(h)
    if size.ndim and size.shape != (len(t),) and not per_vertex:
        msg = (f"h has shape {size.shape}; expected one value, ({len(t)},) for cells or "
               f"({len(p)},) for vertices")
        raise InvalidOptionError(msg)
    bad = np.flatnonzero(~(np.isfinite(size) & (size > 0)))
    if len(bad):
        msg = (f"h is {size.flat[bad[0]]} at index {bad[0]} ({len(bad)} of them); expected finite "
               "positive sizes")
        raise InvalidOptionError(msg)
    if size.ndim and size.shape != (len(t),):
        size = size[t].mean(axis=1)
    return _variation(radius / size)


def cell_figures(points: ArrayLike, cells: ArrayLike, threads: int = 1) -> CellFigures:
    """Measure every cell once, :class:`CellFigures` of seven (m,) arrays, by any number of threads.

    Parameters
    ----------
    points : (n, d) float
    cells : (m, d + 1) int
    threads : int              how many share the work
    """
    p, t = _checked(points, cells)
    figures = CellFigures(*(np.empty(len(t)) for _ in CellFigures._fields))
    axes = np.ascontiguousarray(p.T)

    def measure(part: slice) -> None:
        geometry = CellGeometry(axes, t[part])
        figures.quality[part] = geometry.quality()
        figures.min_angle[part], figures.max_angle[part] = geometry.angle_range()
        figures.amips[part] = geometry.amips()
        figures.volume[part] = geometry.volume()
        figures.circumradius[part] = geometry.circumradius()
        figures.altitude[part] = geometry.altitude()

    spread(measure, chunks(len(t)), threads)
    return figures


class Measured(NamedTuple):
    """What is kept of the figures of a mesh: their summary, and two of every cell, (m,)."""

    summary: QualitySummary
    quality: FloatArray
    volume: FloatArray


def measured(mesh: SimplexMesh, threads: int = 1) -> Measured:
    """Measure a mesh as its metric sees it, once: the arrays of a mesh stay."""
    known = vars(mesh)
    if "measured" not in known:
        found = cell_figures(*as_seen(mesh.points, mesh.cells, mesh.metric), threads)
        summary = summarize(mesh.points, mesh.cells, found)
        known["measured"] = Measured(summary, found.quality, found.volume)
    kept: Measured = known["measured"]
    return kept


def volumes_of(mesh: SimplexMesh) -> FloatArray:
    """Volumes or areas (m,) of the cells of a mesh, among its figures where those are at hand."""
    if "measured" in vars(mesh) and not len(mesh.metric):
        return measured(mesh).volume
    return volumes(mesh.points, mesh.cells)


def summarize(
    points: ArrayLike, cells: ArrayLike, figures: CellFigures | None = None
) -> QualitySummary:
    """Sum a mesh up in the named figures.

    Parameters
    ----------
    points : (n, d) float
    cells : (m, d + 1) int     m at least 1
    figures : CellFigures      of this very mesh, when they are at hand already

    Raises
    ------
    InvalidMeshError           no cells, or shapes or indices that make no simplices
    """
    p, t = _checked(points, cells)
    if not len(t):
        msg = "got a mesh of 0 cells; expected at least one triangle or tetrahedron to measure"
        raise InvalidMeshError(msg)
    f = cell_figures(p, t) if figures is None else figures
    below = [int(np.count_nonzero(f.min_angle < limit)) for limit in ANGLE_LIMITS]
    return QualitySummary(
        dim=t.shape[1] - 1,
        n_points=len(p),
        n_cells=len(t),
        min_quality=float(f.quality.min()),
        p1_quality=quantile(f.quality, 0.01),
        mean_quality=float(f.quality.mean()),
        min_angle=float(f.min_angle.min()),
        max_angle=float(f.max_angle.max()),
        mean_amips=_mean_energy(f.amips),
        max_amips=float(f.amips.max()),
        below_5=below[0],
        below_10=below[1],
        below_20=below[2],
        inverted=int(np.count_nonzero(~(f.volume > 0))),
        uniformity=_variation(f.circumradius),
        volume=float(f.volume.sum()),
        min_altitude=float(f.altitude.min()),
    )


def _mean_energy(x: FloatArray) -> float:
    """Mean of values from 1 to infinity, of which two may be too large to be added."""
    with np.errstate(over="ignore"):
        return float(x.mean())


def _variation(x: FloatArray) -> float:
    """Coefficient of variation with N - 1; infinite when a value is."""
    if not np.isfinite(x).all():
        return float("inf")
    if len(x) < 2:
        return 0.0
    part = x / np.max(x)
    return float(np.std(part, ddof=1) / np.mean(part))


def _geometries(points: FloatArray, cells: NDArray[Any]) -> Iterator[tuple[slice, CellGeometry]]:
    """A mesh in chunks, each with where its cells stand."""
    axes = np.ascontiguousarray(points.T)
    return ((part, CellGeometry(axes, cells[part])) for part in chunks(len(cells)))


def _checked(points: ArrayLike, cells: ArrayLike) -> tuple[FloatArray, NDArray[Any]]:
    p, t = np.asarray(points, dtype=np.float64), np.asarray(cells)
    if p.ndim != 2 or p.shape[1] not in (2, 3):
        msg = f"got points of shape {p.shape}; expected (n, 2) or (n, 3)"
        raise InvalidMeshError(msg)
    if t.ndim != 2 or t.shape[1] not in (3, 4) or t.shape[1] > p.shape[1] + 1:
        msg = (f"got cells of shape {t.shape} for points in {p.shape[1]}-D; expected (m, 3) "
               "triangles or, in space, (m, 4) tetrahedra")
        raise InvalidMeshError(msg)
    if not np.issubdtype(t.dtype, np.integer):
        msg = f"got cells of dtype {t.dtype}; expected integer vertex indices"
        raise InvalidMeshError(msg)
    if len(t) and (t.min() < 0 or t.max() >= len(p)):
        bad = np.flatnonzero(((t < 0) | (t >= len(p))).any(axis=1))
        msg = (f"got vertex indices {t[bad[0]].tolist()} in cell {bad[0]} ({len(bad)} such cells); "
               f"expected indices from 0 to {len(p) - 1}")
        raise InvalidMeshError(msg)
    return p, t
