"""Mesh generation: distance functions, size functions, odtmesh2d and uniform refinement.

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
from odt_plugins.generate.levels import refine_and_optimize
from odt_plugins.generate.levels_report import LevelsReport
from odt_plugins.generate.odtmesh import odtmesh2d
from odt_plugins.generate.refine2d import refine_triangles
from odt_plugins.generate.samples import SAMPLES, Sample
from odt_plugins.generate.sizes import hgraded, hmin, huniform
from odt_plugins.generate.truss import distmesh2d
from odt_plugins.generate.uniform import uniform_refine

__all__ = [
    "SAMPLES",
    "LevelsReport",
    "Sample",
    "dblock",
    "dblock0",
    "dcircle",
    "ddiff",
    "dintersect",
    "distmesh2d",
    "dpoly",
    "drectangle",
    "drectangle0",
    "dsphere",
    "dunion",
    "hgraded",
    "hmin",
    "huniform",
    "odtmesh2d",
    "protate",
    "pshift",
    "refine_and_optimize",
    "refine_triangles",
    "uniform_refine",
]
