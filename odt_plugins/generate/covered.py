"""Whether tetrahedra fill a surface: distances both ways between it and their boundary."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np

from odt_plugins.engine.cells.geometry import boundary_facets
from odt_plugins.engine.ground.reference import Reference, make_reference
from odt_plugins.errors import counted, place_within
from odt_plugins.figures import volumes
from odt_plugins.generate.bodies import HALF, find_bodies, winding
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray
from odt_plugins.mesh.components import components
from odt_plugins.mesh.simplex import diagonal
from odt_plugins.mesh.soup import first_there

MOST_GONE = 0.01
"""Largest share of an area that may have nothing beside it where a surface counts as filled."""

REACH = 2.0
"""Envelopes within which a facet stands for a face: TetWild checks its own at samples only."""

SAMPLES = 40_000
"""Points at which an area is looked at, about; at least one in every triangle."""

ROOTS = (0.7548776662466927, 0.5698402909980532)
"""Kronecker sequence in the plane: 1/g and 1/g^2, where g^3 = g + 1."""

NAMED = 3
"""Most places that a sentence names."""


class Place(NamedTuple):
    """A connected part of an area: the corners of its bounding box, its share of the area, and the
    extent of the area.
    """

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    share: float
    extent: float

    def __str__(self) -> str:
        """The box, by its intervals."""
        ends = zip("xyz", self.low, self.high, strict=True)
        return " ".join(
            f"{axis} {place_within(self.extent, (low,))}..{place_within(self.extent, (high,))}"
            for axis, low, high in ends)


@dataclass(frozen=True)
class Covered:
    """How a surface and the boundary of the tetrahedra that fill it lie to each other.

    Attributes
    ----------
    tolerance : float          length; what is further away than that has nothing beside it
    missing : float            share of the area of the surface that is neither at the boundary of
                               the tetrahedra nor where the surface runs inside of what it bounds
    missing_at : tuple         of :class:`Place`, largest share first
    inverted : bool            whether a closed component of what is missing faces inward
    elsewhere : float          share of the area of the boundary with no face beside it
    elsewhere_at : tuple       of :class:`Place`, largest share first
    volume : float             of the tetrahedra
    inside : float             sum of the signed volumes of the closed components of the surface
    """

    tolerance: float
    missing: float
    missing_at: tuple[Place, ...]
    inverted: bool
    elsewhere: float
    elsewhere_at: tuple[Place, ...]
    volume: float
    inside: float

    @property
    def filled(self) -> bool:
        """Whether no more than MOST_GONE of either area has nothing beside it."""
        return max(self.missing, self.elsewhere) <= MOST_GONE

    def __str__(self) -> str:
        """One line for a report."""
        return (f"{self.missing:.2%} of the surface gone, {self.elsewhere:.2%} of the boundary "
                f"elsewhere, farther than {self.tolerance:.3g}; volume {self.volume:.6g}, inside "
                f"closed components {self.inside:.6g}")

    def complaint(self) -> str:
        """Say in one sentence what is missing and where, what to try; "" where it is filled."""
        said = []
        hints = []
        if self.missing > MOST_GONE:
            said.append(f"{self.missing:.1%} of the area of the surface has nothing of the result "
                        f"beside it, {_where(self.missing_at)}")
            hints.append("repair='orient', since closed components face inward" if self.inverted
                         else "a smaller envelope")
        if self.elsewhere > MOST_GONE:
            said.append(f"{self.elsewhere:.1%} of the boundary of the result stands for no face, "
                        f"{_where(self.elsewhere_at)}")
            hints.append("closing the holes of the surface")
        if not said:
            return ""
        return (f"{'; '.join(said)}; expected at most {MOST_GONE:.0%} farther than "
                f"{self.tolerance:.3g}, try {' and '.join(hints)}")

    def to_dict(self) -> dict[str, Any]:
        """Give all as values that JSON knows."""
        data = asdict(self) | {"filled": self.filled}
        for name in ("missing_at", "elsewhere_at"):
            data[name] = [{"low": list(place.low), "high": list(place.high), "share": place.share}
                          for place in getattr(self, name)]
        return data


def compare(
    surface: tuple[FloatArray, IntArray], mesh: tuple[FloatArray, IntArray], tolerance: float
) -> Covered:
    """Compare a surface with the tetrahedra that are to fill it, at points spread by area.

    Parameters
    ----------
    surface : (points, faces)    (n, 3) float64, (m, 3) int32, oriented as it was filled
    mesh : (points, cells)       (k, 3) float64, (c, 4) int32, positive
    tolerance : float            length

    Notes
    -----
    Where the winding number of the surface is at least a half on both sides of a face, as where
    two bodies overlap, the face bounds nothing, and counts as there when tetrahedra are around it.
    """
    bodies = find_bodies(*surface)
    facets = boundary_facets(mesh[1])
    ours, theirs = make_reference(*surface), make_reference(mesh[0], facets)
    x, face, area = _spread(*surface)
    far = theirs.closest(x)[0] > tolerance
    far[far] = ~_inside(x[far], ours, face[far], theirs, tolerance)
    y, facet, boundary = _spread(mesh[0], facets)
    off = ours.closest(y)[0] > tolerance
    gone = np.unique(bodies.of_face[face[far]])
    merged = first_there(surface[0])[surface[1]].astype(np.int32)
    return Covered(
        tolerance=float(tolerance),
        missing=_share(area, far),
        missing_at=_places(x, face, area, far, merged),
        inverted=bool((bodies.volume[gone] < 0.0).any()),
        elsewhere=_share(boundary, off),
        elsewhere_at=_places(y, facet, boundary, off, facets),
        volume=float(np.abs(volumes(*mesh)).sum()),
        inside=float(bodies.volume[bodies.closed].sum()),
    )


def _spread(points: FloatArray, triangles: IntArray) -> tuple[FloatArray, IntArray, FloatArray]:
    """Points, the triangle of each, and the area that each stands for."""
    a, b, c = points[triangles].swapaxes(0, 1)
    area = 0.5 * np.sqrt((np.cross(b - a, c - a) ** 2).sum(axis=1))
    whole = float(area.sum()) or 1.0
    count = np.maximum(1, np.ceil(SAMPLES * area / whole)).astype(np.int64)
    at = np.repeat(np.arange(len(triangles)), count)
    step = np.arange(len(at)) - np.repeat(np.cumsum(count) - count, count)
    u, v = ((1.0 / 3.0 + step * root) % 1.0 for root in ROOTS)
    beyond = u + v > 1.0
    u, v = np.where(beyond, 1.0 - u, u)[:, None], np.where(beyond, 1.0 - v, v)[:, None]
    x = a[at] + u * (b - a)[at] + v * (c - a)[at]
    return x, at.astype(np.int32), (area / count)[at]


def _inside(
    x: FloatArray, ours: Reference, face: IntArray, theirs: Reference, tolerance: float
) -> BoolArray:
    """Whether points of faces lie inside tetrahedra where both sides are inside the surface."""
    within = winding(theirs.points, theirs.triangles, x) >= HALF
    for way in (tolerance, -tolerance):
        beside = x + way * ours.normals[face]
        within &= np.abs(winding(ours.points, ours.triangles, beside)) >= HALF
    return within


def _share(area: FloatArray, chosen: BoolArray) -> float:
    whole = float(area.sum())
    return float(area[chosen].sum()) / whole if whole else 0.0


def _places(
    x: FloatArray, triangle: IntArray, area: FloatArray, chosen: BoolArray, triangles: IntArray
) -> tuple[Place, ...]:
    """Boxes of the chosen points, one for every connected part of their triangles."""
    if not chosen.any():
        return ()
    rows, at = np.unique(triangle[chosen], return_inverse=True)
    used, corners = np.unique(triangles[rows], return_inverse=True)
    corners = corners.reshape(-1, 3)
    label = components(np.repeat(corners[:, 0], 2), corners[:, 1:].ravel(), len(used))
    part = np.unique(label[corners[:, 0]], return_inverse=True)[1][at]
    shares = np.bincount(part, area[chosen]) / float(area.sum())
    found, extent = x[chosen], diagonal(x)
    out = []
    for i in np.argsort(-shares, kind="stable"):
        own = found[part == i]
        low, high = own.min(axis=0).tolist(), own.max(axis=0).tolist()
        out.append(Place(tuple(low), tuple(high), float(shares[i]), extent))
    return tuple(out)


def _where(places: tuple[Place, ...]) -> str:
    text = f"at {counted(len(places), 'place')} ({'; '.join(map(str, places[:NAMED]))}"
    return text + ("; ...)" if len(places) > NAMED else ")")
