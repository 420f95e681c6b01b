"""The accessor `.odt` on the meshes of pyvista: what `odt_plugins.register("pyvista")` adds."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from odt_plugins.adapters import pyvista_mesh
from odt_plugins.api import optimize, optimize_with_report, quality
from odt_plugins.errors import UnsupportedMeshError
from odt_plugins.figures import QualitySummary
from odt_plugins.keywords import OptionKeywords, with_option_signature
from odt_plugins.remeshing import remesh
from odt_plugins.tetwild import tetrahedralize

if TYPE_CHECKING:
    from collections.abc import Mapping

    from odt_plugins.report.report import Report

NAME = "odt"

RATIO = "odt_radius_ratio"
"""Name of the cell array of radius ratios."""


class _Accessor:
    """What meshes have, and MultiBlocks."""

    def __init__(self, mesh: Any) -> None:
        self._mesh = mesh

    @with_option_signature()
    def optimize(self, **options: Unpack[OptionKeywords]) -> Any:
        """Improve the tetrahedra, or where there are none the triangles.

        Parameters
        ----------
        **options     of :func:`odt_plugins.optimize`

        Returns
        -------
        same class    a new one with all arrays; blocks of other cells are copied
        """
        return optimize(self._mesh, **options)

    @with_option_signature()
    def optimize_with_report(self, **options: Unpack[OptionKeywords]) -> tuple[Any, Report]:
        """Improve as :meth:`optimize` does and tell what was done; of blocks to each."""
        return optimize_with_report(self._mesh, **options)

    def remesh(self, size: Any = None, **options: Any) -> Any:
        """Give the cells other sizes, see :func:`odt_plugins.remesh`.

        Parameters
        ----------
        size : float, str, array or callable    length that edges should have, or the name of a
                                                point or cell array of lengths
        **options                               `scale`, `cells`, ... of :func:`odt_plugins.remesh`

        Returns
        -------
        same class    a new one
        """
        return remesh(self._mesh, size, **options)


class OdtBlocksAccessor(_Accessor):
    """Optimal Delaunay Triangulation of every block of a MultiBlock by itself."""


class OdtAccessor(_Accessor):
    """Optimal Delaunay Triangulation of this mesh; the mesh itself is never changed."""

    def quality(self) -> QualitySummary:
        """Sum up the quality: radius ratios, (dihedral) angles in degrees, counts."""
        return quality(self._mesh)

    def cell_quality(self) -> Any:
        """Copy the mesh and add the cell array "odt_radius_ratio".

        It is d r / R (5.1): 1 for a regular cell, 0 for a flat one, negative for an inverted one,
        NaN for cells that are not optimised, such as lines.
        """
        host = pyvista_mesh.read(self._mesh)
        out = self._mesh.copy(deep=True)
        values = np.full(out.n_cells, np.nan)
        ids = pyvista_mesh.optimised_cells(host)
        figures: Any = quality(self._mesh).cells
        values[ids] = figures.quality
        out.cell_data[RATIO] = values
        return out


class OdtSurfaceAccessor(OdtAccessor):
    """The same for PolyData, which can be filled with tetrahedra as well."""

    def tetrahedralize(
        self,
        *,
        sizing_field: Any = None,
        sizing_field_scalars: str | None = None,
        odt: Mapping[str, Any] | bool = True,
        **keywords: Any,
    ) -> Any:
        """Fill the surface with tetrahedra by TetWild and improve them: an UnstructuredGrid.

        Parameters
        ----------
        sizing_field : pyvista.UnstructuredGrid      tetrahedra with target edge lengths, which
                                                     are kept as the density of ODT too
        sizing_field_scalars : str                   name of their point array; the active one
        odt : bool or dict                           of :func:`odt_plugins.tetrahedralize`: False
                                                     for TetWild alone
        **keywords                                   of `pytetwild.tetrahedralize`:
                                                     edge_length_fac, epsilon, ..., and options of
                                                     :func:`odt_plugins.optimize`

        Raises
        ------
        MissingDependencyError, InvalidMeshError, InvalidOptionError, and what pytetwild raises
        """
        from pyvista import UnstructuredGrid

        surface = self._mesh
        surface = surface if surface.is_all_triangles else surface.triangulate()
        if sizing_field is not None:
            names = ("bg_vertices", "bg_tets", "bg_values")
            keywords.update(zip(names, _unpacked(sizing_field, sizing_field_scalars), strict=True))
        points, cells = tetrahedralize(
            np.array(surface.points, dtype=np.float64),
            np.array(surface.regular_faces, dtype=np.int32),
            **{**keywords, "vtk_ordering": True},
            odt=odt,
        )
        return UnstructuredGrid({pyvista_mesh.TETRA: cells}, points)


def _unpacked(field: Any, scalars: str | None) -> tuple[Any, Any, Any]:
    """Points, tetrahedra and target edge lengths of a sizing field."""
    if not pyvista_mesh.matches(field) or list(getattr(field, "cells_dict", ())) != [
        pyvista_mesh.TETRA
    ]:
        calls = ("to_tetrahedra()", "delaunay_3d()")
        call = next((call for call in calls if hasattr(field, call[:-2])), None)
        msg = (f"got a sizing_field of type {type(field).__name__}; expected a pyvista."
               f"UnstructuredGrid of tetrahedra only{f', try sizing_field.{call}' if call else ''}")
        raise UnsupportedMeshError(msg)
    name = scalars or field.point_data.active_scalars_name
    if name is None or name not in field.point_data:
        msg = (f"got a sizing_field without a point array {name!r}; expected sizing_field_scalars "
               f"to be one of {sorted(field.point_data.keys())}")
        raise UnsupportedMeshError(msg)
    cells = field.cells_dict[pyvista_mesh.TETRA].astype(np.int32)
    return np.array(field.points, dtype=np.float64), cells, np.array(field.point_data[name])


def register() -> None:
    """Add the accessors to the classes of pyvista; before its version 0.48 as properties."""
    import pyvista

    for kind, accessor in ((pyvista.UnstructuredGrid, OdtAccessor),
                           (pyvista.PolyData, OdtSurfaceAccessor),
                           (pyvista.MultiBlock, OdtBlocksAccessor)):
        if NAME in vars(kind):
            continue
        if hasattr(pyvista, "register_dataset_accessor"):
            pyvista.register_dataset_accessor(NAME, kind)(accessor)
        else:
            setattr(kind, NAME, property(accessor))
