"""What the figures of a cell are made of, in numpy: edges, normals, determinant, radii, angles."""

from __future__ import annotations

from functools import cached_property, reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


class CellGeometry:
    """One chunk of simplices, every cell scaled by its longest coordinate difference.

    The scale keeps sixth powers of lengths away from overflow and underflow. Coordinates come as
    (d, n): numpy is several times as fast along long rows as along short ones.
    """

    def __init__(self, axes: FloatArray, cells: NDArray[Any]) -> None:
        self.k = cells.shape[1]
        corner = axes.take(cells.T, axis=1)
        self.x0 = corner[:, 0]
        edge = corner[:, 1:] - corner[:, :1]
        scale = np.abs(edge).max(axis=(0, 1))
        self.scale = np.where(scale > 0, scale, 1.0)
        self.a, self.b, *rest = (edge / self.scale).swapaxes(0, 1)
        self.c = rest[0] if rest else self.a
        with np.errstate(invalid="ignore"):
            self.bc = _cross(self.b, self.c) if rest else self.a
            if rest:
                self.det = _dot(self.a, self.bc)
            elif len(self.a) == 3:
                self.det = _norm(_cross(self.a, self.b))
            else:
                self.det = self.a[0] * self.b[1] - self.a[1] * self.b[0]

    @cached_property
    def normals(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Inward normals of the faces of a tetrahedron, twice the areas long, opposite 0 first."""
        a, b, c = self.a, self.b, self.c
        with np.errstate(invalid="ignore"):
            return _cross(c - a, b - a), self.bc, _cross(c, a), _cross(a, b)

    @cached_property
    def areas(self) -> list[FloatArray]:
        """Twice the areas of the faces of a tetrahedron."""
        return [_norm(n) for n in self.normals]

    @cached_property
    def squares(self) -> list[FloatArray]:
        """Squares of :attr:`edges`."""
        a, b, c = self.a, self.b, self.c
        with np.errstate(invalid="ignore"):
            sides = [a, b, b - a] if self.k == 3 else [a, b, c, b - a, c - a, c - b]
            return [_dot(side, side) for side in sides]

    @cached_property
    def edges(self) -> list[FloatArray]:
        """Lengths of the edges, in the order of :data:`odt_plugins.figures.EDGES`."""
        with np.errstate(invalid="ignore"):
            return [np.sqrt(square) for square in self.squares]

    @cached_property
    def numerator(self) -> FloatArray:
        """Circumcenter from the first vertex, times twice the determinant."""
        with np.errstate(invalid="ignore"):
            _, bc, ca, ab = self.normals
            aa, bb, cc, *_ = self.squares
            return np.asarray(aa * bc + bb * ca + cc * ab)

    def volume(self) -> FloatArray:
        """Signed volume in the unit of the caller; of triangles, the area."""
        unit = 6.0 if self.k == 4 else 2.0
        return np.asarray(self.det / unit * self.scale ** (self.k - 1))

    def circumradius(self) -> FloatArray:
        """R in the unit of the caller."""
        with np.errstate(over="ignore"):
            return np.asarray(self.radius * self.scale)

    @cached_property
    def radius(self) -> FloatArray:
        """R of the scaled cell; never below half the longest edge, infinite when (nearly) flat."""
        size = np.abs(self.det)
        top = _norm(self.numerator) if self.k == 4 else np.prod(self.edges, axis=0)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            radius = np.where(size > 0, top / (2 * size), np.inf)
        return np.asarray(np.maximum(radius, reduce(np.maximum, self.edges) / 2))

    def circumcenter(self) -> FloatArray:
        """Circumcenters (m, d) in the unit of the caller."""
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            if self.k == 4:
                offset = self.numerator / (2 * self.det)
            else:
                a2, b2 = _dot(self.a, self.a), _dot(self.b, self.b)
                ab = _dot(self.a, self.b)
                w = 2 * self.det ** 2
                offset = (b2 * (a2 - ab) / w) * self.a + (a2 * (b2 - ab) / w) * self.b
        return np.asarray((self.x0 + offset * self.scale).T)

    def quality(self) -> FloatArray:
        """Radius ratio d r / R, with the sign of the volume."""
        size = np.abs(self.det)
        if self.k == 4:
            surface = sum(self.areas)
            inradius = np.divide(size, surface, out=np.zeros_like(size), where=surface > 0)
        else:
            perimeter = sum(self.edges)
            inradius = np.divide(size, perimeter, out=np.zeros_like(size), where=perimeter > 0)
        with np.errstate(invalid="ignore"):
            q = np.where(size > 0, (self.k - 1) * inradius / self.radius, 0.0)
        return np.where(np.isnan(self.det), np.nan, np.sign(self.det) * q)

    def altitude(self) -> FloatArray:
        """Least altitude, in the unit of the caller, with the sign of the volume."""
        most = reduce(np.maximum, self.areas if self.k == 4 else self.edges)
        least = np.divide(self.det, most, out=np.zeros_like(most), where=most > 0)
        return np.asarray(least * self.scale)

    def amips(self) -> FloatArray:
        """AMIPS energy as TetWild reports it, infinite for a cell without positive volume.

        Notes
        -----
        tr(J^T J) / det(J)^(2/d) with J the Jacobian of the map from the regular simplex, d = k - 1,
        which is d for that one. With l the edges, E = sum l^2 / (2 (sqrt(2) 6 V)^(2/3)) for a
        tetrahedron and E = sum l^2 / (2 sqrt(3) A) for a triangle.

        References
        ----------
        Y. Hu, Q. Zhou, X. Gao, A. Jacobson, D. Zorin, D. Panozzo, Tetrahedral meshing in the wild,
        ACM Trans. Graph. 37 (2018) 60.
        """
        squares = sum(self.squares)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            if self.k == 4:
                energy = squares / (2.0 * np.cbrt(2.0 * self.det ** 2))
            else:
                energy = squares / (np.sqrt(3.0) * self.det)
        return np.where(np.isnan(self.det), np.nan, np.where(self.det > 0, energy, np.inf))

    def angles(self) -> FloatArray:
        """Angles of a triangle or dihedral angles of a tetrahedron, degrees, (3 or 6, m)."""
        sine, a, b = np.abs(self.det), self.a, self.b
        if self.k == 3:
            cosine = [_dot(a, b), -_dot(a, b - a), _dot(b, b - a)]
            return np.degrees([np.arctan2(sine, x) for x in cosine])
        return np.degrees([np.arctan2(length * sine, x)
                           for length, x in zip(self.edges, self._cosines(), strict=True)])

    def angle_range(self) -> tuple[FloatArray, FloatArray]:
        """Smallest and largest angle of every cell in degrees, (m,) each."""
        if self.k == 3:
            angles = self.angles()
            return angles.min(axis=0), angles.max(axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            over_sine = [x / length for length, x in zip(self.edges, self._cosines(), strict=True)]
        ends = (reduce(end, over_sine) for end in (np.fmax, np.fmin))
        low, high = (np.degrees(np.arctan2(np.abs(self.det), x)) for x in ends)
        return low, high

    def _cosines(self) -> list[FloatArray]:
        """Cosines of the dihedral angles, each times the normals of its faces."""
        n = self.normals
        opposite = ((2, 3), (1, 3), (1, 2), (0, 3), (0, 2), (0, 1))
        return [-_dot(n[i], n[j]) for i, j in opposite]


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    total = a[0] * b[0]
    for x, y in zip(a[1:], b[1:], strict=True):
        total += x * y
    return np.asarray(total)


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.stack([a[1] * b[2] - a[2] * b[1],
                     a[2] * b[0] - a[0] * b[2],
                     a[0] * b[1] - a[1] * b[0]])


def _norm(a: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(_dot(a, a)))
