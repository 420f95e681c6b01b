"""The six domains of Table 1 of the paper (Fig 9)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from odt_plugins.generate.distance import (
    Distance,
    dcircle,
    ddiff,
    dintersect,
    drectangle,
    protate,
    pshift,
)
from odt_plugins.generate.sizes import Size, huniform
from odt_plugins.mesh.arrays import FloatArray


@dataclass(frozen=True)
class Sample:
    """Arguments of distmesh2d for one domain, and what the paper reports of its mesh.

    Attributes
    ----------
    title : str
    fd, fh : callable
    h0 : float
    bbox : ((xmin, ymin), (xmax, ymax))
    pfix : (f, 2) tuples
    paper : (min q, mean q, uniformity)    Table 1
    """

    title: str
    fd: Distance
    fh: Size
    h0: float
    bbox: tuple[tuple[float, float], tuple[float, float]]
    pfix: tuple[tuple[float, float], ...]
    paper: tuple[float, float, float]


SQUARE = ((-1.0, -1.0), (1.0, 1.0))
CORNERS = ((-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0))


def _circle(p: FloatArray) -> FloatArray:
    return dcircle(p, 0, 0, 1)


def _ring(p: FloatArray) -> FloatArray:
    return ddiff(dcircle(p, 0, 0, 1), dcircle(p, 0, 0, 0.4))


def _square(p: FloatArray) -> FloatArray:
    return ddiff(drectangle(p, -1, 1, -1, 1), dcircle(p, 0, 0, 0.4))


def _near_the_hole(p: FloatArray) -> FloatArray:
    return np.minimum(4 * np.hypot(p[:, 0], p[:, 1]) - 1, 2)


def _crescent(p: FloatArray) -> FloatArray:
    return dintersect(-p[:, 1], ddiff(dcircle(p, 0, 0, 1), dcircle(p, -0.4, 0, 0.55)))


def _between(p: FloatArray) -> FloatArray:
    d1, d2 = dcircle(p, 0, 0, 1), dcircle(p, -0.4, 0, 0.55)
    return np.minimum(np.minimum(0.15 - 0.2 * d1, 0.06 + 0.2 * d2), (d2 - d1) / 3)


def _pie(p: FloatArray) -> FloatArray:
    angle = np.pi / 12
    notch = protate(pshift(p, -0.9, 0), -np.pi / 4)
    return ddiff(
        dcircle(p, 0, 0, 1), drectangle(protate(p, angle), -1, 1, 0, 1),
        drectangle(protate(p, -angle), -1, 1, -1, 0), drectangle(notch, 0, 0.2, 0, 0.2),
        dcircle(p, 0.6, 0, 0.1),
    )


def _near_the_features(p: FloatArray) -> FloatArray:
    return np.minimum.reduce([
        0.005 + 0.2 * np.hypot(p[:, 0], p[:, 1]),
        0.02 + 0.2 * (np.hypot(p[:, 0] - 0.6, p[:, 1]) - 0.1),
        0.005 + 0.2 * np.hypot(p[:, 0] - 0.9, p[:, 1]), np.full(len(p), 0.03),
    ])


_NOTCH = (np.sqrt(119.0) - 9.0) / 20.0
_PIE = ((0.9 + _NOTCH, _NOTCH), (0.9 + _NOTCH, -_NOTCH),
        (math.cos(math.pi / 12), math.sin(math.pi / 12)),
        (math.cos(math.pi / 12), -math.sin(math.pi / 12)), (0.0, 0.0), (0.9, 0.0))

SAMPLES = {
    "circle": Sample("unit circle", _circle, huniform, 0.05, SQUARE, (), (0.74, 0.99, 0.029)),
    "ring": Sample("circle with a hole", _ring, huniform, 0.05, SQUARE, (), (0.74, 0.98, 0.045)),
    "square": Sample("square with a hole", _square, huniform, 0.035, SQUARE, CORNERS,
                     (0.76, 0.98, 0.038)),
    "graded-square": Sample("square with a hole, refined at the hole", _square, _near_the_hole,
                            0.02, SQUARE, CORNERS, (0.71, 0.97, 0.054)),
    "crescent": Sample("geometric adaptivity", _crescent, _between, 0.01,
                       ((-1.0, 0.0), (1.0, 1.0)),
                       ((-1.0, 0.0), (-0.95, 0.0), (0.15, 0.0), (1.0, 0.0)), (0.73, 0.97, 0.061)),
    "pie": Sample("pie with holes", _pie, _near_the_features, 0.0025, ((0.0, -1.0), (1.0, 1.0)),
                  _PIE, (0.57, 0.97, 0.076)),
}
"""Names of the domains (a) to (f), in order."""
