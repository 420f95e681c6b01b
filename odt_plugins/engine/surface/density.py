"""Densities on a surface: values at the vertices of the ground, asked at the feet of the others."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from odt_plugins.engine.ground.build import ground_values
from odt_plugins.engine.ground.closest import Ground
from odt_plugins.engine.ground.features import Features
from odt_plugins.engine.ground.sheet import Sheet
from odt_plugins.engine.odt.density import Density, bounded_power, make_density
from odt_plugins.engine.surface.curvature import curvature_density
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.mesh.surface import Edges


@dataclass(frozen=True)
class SurfaceDensity:
    """A density that can be asked at the vertices of a sheet.

    Attributes
    ----------
    values : (n,) float64 or None    at the vertices of the ground
    plain : Density                  answers where there are no values
    """

    values: FloatArray | None
    plain: Density

    @property
    def equal_weights(self) -> bool:
        """Whether every triangle counts the same (4.22)."""
        return self.plain.inverse_volume

    def at(self, sheet: Sheet, ground: Ground) -> FloatArray:
        """Density rho at the vertices of the sheet, (n,)."""
        if self.values is None:
            return self.plain.at(sheet.points)
        rho = np.ones(len(sheet.points))
        ground_values(ground, self.values, sheet.points, sheet.foot, rho)
        return rho


def surface_density(
    spec: Any, exponent: float | None, points: FloatArray, triangles: IntArray, edges: Edges,
    features: Features,
) -> SurfaceDensity:
    """Turn ``Options.density`` into a density on the input surface.

    Parameters
    ----------
    spec : str, array or callable    as for :func:`odt_plugins.engine.odt.density.make_density`, or
                                     "curvature": fine where the surface is curved
    exponent : float or None         r in rho = h^-r of "keep"
    points : (n, 3) float64, triangles : (m, 3) int32, edges : Edges, features : Features

    Raises
    ------
    InvalidOptionError               see :func:`odt_plugins.engine.odt.density.make_density`
    """
    if isinstance(spec, str) and spec == "curvature":
        apart = features.edges[edges.of_cell]
        rho = curvature_density(points, triangles, np.where(apart, -1, edges.neighbors))
        plain = make_density("uniform", None, points, triangles, edges.neighbors)
        return SurfaceDensity(rho, plain)
    plain = make_density(spec, exponent, points, triangles, edges.neighbors)
    if not plain.field.size:
        return SurfaceDensity(None, plain)
    return SurfaceDensity(bounded_power(plain.field, plain.power), plain)
