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
- Vertices keep their index. Cells may be renumbered; those that are still there keep their row
  and their order.
- Boundary vertices and facets stay bit for bit, and so do interfaces between region labels. A
  curved surface stays within `envelope` of the input's instead, and so does the boundary of
  tetrahedra with `boundary="slide"`.
- No figure in `keep` gets worse: by default least, 1 % and mean quality and both extreme angles.
- Lengths are in the caller's unit; tolerances are relative to the mesh.
- The same input and options give the same bits, with any number of threads.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from odt_plugins.api import measure, optimize, optimize_file, optimize_with_report
    from odt_plugins.distributed.optimize import (
        optimize_partitioned,
        optimize_partitioned_with_report,
    )
    from odt_plugins.distributed.pieces import optimize_pieces
    from odt_plugins.errors import (
        CrashError,
        DataNotKeptWarning,
        InvalidMeshError,
        InvalidOptionError,
        MeshFileError,
        MissingDependencyError,
        NotConvergedWarning,
        ODTError,
        ODTWarning,
        UnsupportedMeshError,
        WorkerError,
    )
    from odt_plugins.generate import refine_and_optimize, uniform_refine
    from odt_plugins.hosts import register
    from odt_plugins.hosts.script import run_filter_script
    from odt_plugins.options import Options
    from odt_plugins.quality import QualitySummary
    from odt_plugins.report.report import Report
    from odt_plugins.tetwild import tetrahedralize

    __version__: str

__all__ = [
    "CrashError",
    "DataNotKeptWarning",
    "InvalidMeshError",
    "InvalidOptionError",
    "MeshFileError",
    "MissingDependencyError",
    "NotConvergedWarning",
    "ODTError",
    "ODTWarning",
    "Options",
    "QualitySummary",
    "Report",
    "UnsupportedMeshError",
    "WorkerError",
    "__version__",
    "measure",
    "optimize",
    "optimize_file",
    "optimize_partitioned",
    "optimize_partitioned_with_report",
    "optimize_pieces",
    "optimize_with_report",
    "refine_and_optimize",
    "register",
    "run_filter_script",
    "tetrahedralize",
    "uniform_refine",
]

_HOMES = {
    "api": ("measure", "optimize", "optimize_file", "optimize_with_report"),
    "distributed.optimize": ("optimize_partitioned", "optimize_partitioned_with_report"),
    "distributed.pieces": ("optimize_pieces",),
    "generate": ("refine_and_optimize", "uniform_refine"),
    "hosts": ("register",),
    "options": ("Options",),
    "quality": ("QualitySummary",),
    "report.report": ("Report",),
    "hosts.script": ("run_filter_script",),
    "tetwild": ("tetrahedralize",),
}
"""Module of every public name that is not in `errors`."""


def __getattr__(name: str) -> Any:
    """Import a public name when it is first asked for (PEP 562)."""
    if name not in __all__:
        msg = f"module 'odt_plugins' has no attribute {name!r}"
        raise AttributeError(msg)
    if name == "__version__":
        from importlib.metadata import version

        return version("odt-plugins")
    home = next((module for module, names in _HOMES.items() if name in names), "errors")
    return getattr(import_module(f"odt_plugins.{home}"), name)


def __dir__() -> list[str]:
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})
