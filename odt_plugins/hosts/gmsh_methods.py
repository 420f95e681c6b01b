"""The methods `gmsh.model.mesh.odt` and `odt_remesh`: what `odt_plugins.register("gmsh")` adds."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Unpack

from odt_plugins.api import optimize_with_report
from odt_plugins.keywords import OptionKeywords, with_option_signature
from odt_plugins.remeshing import remesh_with_report

if TYPE_CHECKING:
    from odt_plugins.report.report import Report


@with_option_signature()
def odt(**options: Unpack[OptionKeywords]) -> Report:
    """Improve the elements of the current model in place by Optimal Delaunay Triangulation.

    Parameters
    ----------
    **options     of :func:`odt_plugins.optimize`
    """
    import gmsh

    report: Report = optimize_with_report(gmsh.model, **options)[1]
    return report


def odt_remesh(size: Any = None, **options: Any) -> Report:
    """Give the elements of the current model other sizes, in place.

    Parameters
    ----------
    size : float, array or callable    length that edges should have
    **options                          of :func:`odt_plugins.remesh`, such as `scale`
    """
    import gmsh

    report: Report = remesh_with_report(gmsh.model, size, **options)[1]
    return report


def register() -> None:
    """Add the functions beside `gmsh.model.mesh.optimize`."""
    import gmsh

    gmsh.model.mesh.odt = staticmethod(odt)
    gmsh.model.mesh.odt_remesh = staticmethod(odt_remesh)
