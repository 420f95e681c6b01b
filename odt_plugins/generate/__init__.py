"""Mesh generation: distance functions, size functions, odtmesh2d and uniform refinement.

- `odtmesh2d` meshes {fd < 0} with edge lengths in proportion to fh (Section 5.3): a truss catches
  the domain (`truss_smoothing`, `settle`), `refine_triangles` halves the edges, `relax` runs ODT
  with rho = h^-3 on every level, `clean_up` and `repair` end it. `distmesh2d` is the truss alone.
- Distance functions: `dcircle`, `drectangle`, `dpoly`, ..., joined by `dunion`, `ddiff` and
  `dintersect`; sizes: `huniform`, `hgraded`, `hmin`. `SAMPLES` are the six domains of Table 1.
- `refine` makes large meshes of tetrahedra from coarse ones: `red_refinement` cuts
  every tetrahedron into eight, around the diagonal that is best (`best_diagonals`), `project`
  moves the boundary to the surface, and the engine follows.
- `uniform_refine` is the refinement alone, on any mesh that the adapters read.

References
----------
L. Chen, M. Holst, CMAME 200 (2011) 967-984, doi:10.1016/j.cma.2010.11.007, Section 5.3.
P.-O. Persson, G. Strang, A simple mesh generator in MATLAB, SIAM Review 46 (2004) 329-345.
J. Bey, Tetrahedral grid refinement, Computing 55 (1995) 355-378.
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
from odt_plugins.generate.levels import refine, refine_with_report
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
    "refine",
    "refine_triangles",
    "refine_with_report",
    "uniform_refine",
]
