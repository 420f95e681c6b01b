"""The method `gmsh.model.mesh.odt`: what `odt_plugins.register("gmsh")` adds."""

from __future__ import annotations

from typing import TYPE_CHECKING, Unpack

from odt_plugins.api import optimize_with_report
from odt_plugins.options import OptionKeywords, with_option_signature

if TYPE_CHECKING:
    from odt_plugins.report.report import Report


@with_option_signature()
def odt(**options: Unpack[OptionKeywords]) -> Report:
    """Improve the elements of the current model in place by Optimal Delaunay Triangulation.

    Parameters
    ----------
    **options     of :func:`odt_plugins.optimize`

    Returns
    -------
    Report
    """
    import gmsh

    report: Report = optimize_with_report(gmsh.model, **options)[1]
    return report


def register() -> None:
    """Add the function beside `gmsh.model.mesh.optimize`."""
    import gmsh

    gmsh.model.mesh.odt = staticmethod(odt)
