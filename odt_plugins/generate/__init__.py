"""Mesh generation: distance functions, size functions and uniform refinement.

References
----------
L. Chen, M. Holst, CMAME 200 (2011) 967-984, doi:10.1016/j.cma.2010.11.007, Section 5.3.
"""

from odt_plugins.generate.distance import (
    dblock,
    dblock0,
    dcircle,
    ddiff,
    dintersect,
    dpoly,
    drectangle,
    drectangle0,
    dsphere,
    dunion,
    protate,
    pshift,
)
from odt_plugins.generate.refine2d import refine_triangles
from odt_plugins.generate.sizes import hgraded, hmin, huniform
from odt_plugins.generate.uniform import uniform_refine

__all__ = [
    "dblock",
    "dblock0",
    "dcircle",
    "ddiff",
    "dintersect",
    "dpoly",
    "drectangle",
    "drectangle0",
    "dsphere",
    "dunion",
    "hgraded",
    "hmin",
    "huniform",
    "protate",
    "pshift",
    "refine_triangles",
    "uniform_refine",
]
