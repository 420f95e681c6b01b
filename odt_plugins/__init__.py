"""Optimal Delaunay Triangulation for the tetrahedral and triangle meshes you already have.

>>> import odt_plugins
>>> better = odt_plugins.optimize(mesh)                        # doctest: +SKIP
>>> better, report = odt_plugins.optimize_with_report(mesh)    # doctest: +SKIP

Conventions
-----------
- `points` (n, d) float64 or float32, `cells` (m, d + 1) of any integer type or floats that hold
  integers, d = 2 or 3; triangles may also have points (n, 3), in one plane or on a curved surface.
- The caller's object is never changed. The result is of the same type with the same dtypes,
  orientation and data; cells of negative volume come back negative.
- Vertices keep their index, unless they may come and go. Cells may be renumbered; those that are
  still there keep their row and their order.
- Boundary vertices and facets stay bit for bit, and so do interfaces between region labels. A
  curved surface stays within `envelope` of the input's instead, and so does the boundary of
  tetrahedra with `boundary="slide"`.
- No figure in `keep` gets worse: by default least, 1 % and mean quality, both extreme angles and
  the share of cells with an angle below 20 degrees.
- Lengths are in the caller's unit; tolerances are relative to the mesh.
- The same input and options give the same bits, with any number of threads; what TetWild makes
  differs from run to run.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from odt_plugins.api import optimize as optimize
    from odt_plugins.api import optimize_with_report as optimize_with_report
    from odt_plugins.api import quality as quality
    from odt_plugins.api import untangle as untangle
    from odt_plugins.api import untangle_with_report as untangle_with_report
    from odt_plugins.errors import CrashError as CrashError
    from odt_plugins.errors import DataNotKeptWarning as DataNotKeptWarning
    from odt_plugins.errors import EndlessWalkError as EndlessWalkError
    from odt_plugins.errors import InvalidMeshError as InvalidMeshError
    from odt_plugins.errors import InvalidOptionError as InvalidOptionError
    from odt_plugins.errors import MeshFileError as MeshFileError
    from odt_plugins.errors import MissingDependencyError as MissingDependencyError
    from odt_plugins.errors import NotConvergedWarning as NotConvergedWarning
    from odt_plugins.errors import NotFilledWarning as NotFilledWarning
    from odt_plugins.errors import ODTError as ODTError
    from odt_plugins.errors import ODTWarning as ODTWarning
    from odt_plugins.errors import TangledMeshError as TangledMeshError
    from odt_plugins.errors import UnsupportedMeshError as UnsupportedMeshError
    from odt_plugins.errors import WorkerError as WorkerError
    from odt_plugins.figures import QualitySummary as QualitySummary
    from odt_plugins.generate import refine as refine
    from odt_plugins.generate import refine_with_report as refine_with_report
    from odt_plugins.generate.fill import tetrahedralize as tetrahedralize
    from odt_plugins.generate.fill import (
        tetrahedralize_with_report as tetrahedralize_with_report,
    )
    from odt_plugins.hosts import register as register
    from odt_plugins.hosts.script import run_filter_script as run_filter_script
    from odt_plugins.metric.field import metric_from_field as metric_from_field
    from odt_plugins.options import Options as Options
    from odt_plugins.remeshing import remesh as remesh
    from odt_plugins.remeshing import remesh_with_report as remesh_with_report
    from odt_plugins.report.report import Report as Report

    __version__: str

_HOMES = {
    "CrashError": "errors",
    "DataNotKeptWarning": "errors",
    "EndlessWalkError": "errors",
    "InvalidMeshError": "errors",
    "InvalidOptionError": "errors",
    "MeshFileError": "errors",
    "MissingDependencyError": "errors",
    "NotConvergedWarning": "errors",
    "NotFilledWarning": "errors",
    "ODTError": "errors",
    "ODTWarning": "errors",
    "Options": "options",
    "QualitySummary": "figures",
    "Report": "report.report",
    "TangledMeshError": "errors",
    "UnsupportedMeshError": "errors",
    "WorkerError": "errors",
    "metric_from_field": "metric.field",
    "optimize": "api",
    "optimize_with_report": "api",
    "quality": "api",
    "refine": "generate",
    "refine_with_report": "generate",
    "register": "hosts",
    "remesh": "remeshing",
    "remesh_with_report": "remeshing",
    "run_filter_script": "hosts.script",
    "tetrahedralize": "generate.fill",
    "tetrahedralize_with_report": "generate.fill",
    "untangle": "api",
    "untangle_with_report": "api",
}
"""Module of every public name. Type checkers read the imports above, which a test holds equal."""

__all__ = sorted([*_HOMES, "__version__"])


def __getattr__(name: str) -> Any:
    """Import a public name when it is first asked for (PEP 562)."""
    if name not in __all__:
        msg = f"module 'odt_plugins' has no attribute {name!r}"
        raise AttributeError(msg)
    if name == "__version__":
        from importlib.metadata import version

        return version("odt-plugins")
    return getattr(import_module(f"odt_plugins.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})
