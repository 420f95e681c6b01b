"""Optimal Delaunay Triangulation for open3d, in functions shaped like open3d's own filters.

They take a TriangleMesh (legacy or tensor) or a TetraMesh and return a new mesh of the same class.
`odt_plugins.register("open3d")` makes them methods of these classes as well.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping
from typing import Any, TypeVar, Unpack, cast

from odt_plugins.adapters import open3d_mesh
from odt_plugins.adapters.host import is_instance
from odt_plugins.api import optimize as optimize_mesh
from odt_plugins.errors import InvalidOptionError, ODTError, UnsupportedMeshError, reworded
from odt_plugins.keywords import OptionKeywords, with_option_signature
from odt_plugins.options import OPTIONS, SMOOTHING, hint_for, make_options, worded
from odt_plugins.remeshing import remesh

MeshT = TypeVar("MeshT")

OWN = ("method", "finish")
"""Options that the smoothing filters set, with `connectivity` and `cycles` of `smoothing`, of which
`rounds` is number_of_iterations.
"""


@with_option_signature(*OWN, "objective", "insert")
def filter_smooth_odt(
    mesh: MeshT,
    number_of_iterations: int = 1,
    filter_scope: Any = None,
    **options: Unpack[OptionKeywords],
) -> MeshT:
    """Smooth a mesh by Optimal Delaunay Triangulation; no edge is flipped.

    Every vertex moves to the weighted mean of the circumcenters around it; the boundary stays.

    Parameters
    ----------
    mesh : open3d.geometry.TriangleMesh, open3d.geometry.TetraMesh or
        open3d.t.geometry.TriangleMesh
    number_of_iterations : int     most rounds of smoothing; fewer when the energy has settled
    filter_scope : open3d.geometry.FilterScope
        All (default): vertices move, normals are computed anew; Vertex: normals stay as they are.
        Those of a TetraMesh stay either way: only on its boundary, which does not move, do they
        mean something. Colours are never averaged.
    **options                      of :func:`odt_plugins.optimize`; without those that make this
                                   filter what it is: finish, method, connectivity in smoothing

    Raises
    ------
    InvalidOptionError             the scope is Normal or Color, an option is wrong or contradicts
                                   the filter
    InvalidMeshError, UnsupportedMeshError

    References
    ----------
    L. Chen, M. Holst, CMAME 200 (2011) 967-984, doi:10.1016/j.cma.2010.11.007, (4.13).
    """
    return cast("MeshT", _smooth(filter_smooth_odt, mesh, number_of_iterations, filter_scope,
                                 "odt", {}, options))


@with_option_signature(*OWN, "objective", "insert")
def filter_smooth_cpt(
    mesh: MeshT,
    number_of_iterations: int = 1,
    filter_scope: Any = None,
    **options: Unpack[OptionKeywords],
) -> MeshT:
    """Smooth a mesh by Centroidal Patch Triangulation: as :func:`filter_smooth_odt`, (4.20).

    Every vertex moves to the weighted mean of the barycenters around it.
    """
    return cast("MeshT", _smooth(filter_smooth_cpt, mesh, number_of_iterations, filter_scope,
                                 "cpt", {}, options))


@with_option_signature(*OWN, "objective", "insert")
def filter_smooth_odt_global(
    mesh: MeshT,
    number_of_iterations: int = 1,
    filter_scope: Any = None,
    **options: Unpack[OptionKeywords],
) -> MeshT:
    """Smooth a mesh as :func:`filter_smooth_odt` does, all vertices at once, (4.27).

    Every round solves a linear system with the graph Laplacian.
    """
    return cast("MeshT", _smooth(filter_smooth_odt_global, mesh, number_of_iterations, filter_scope,
                                 "odt", {"solver": "global"}, options))


@with_option_signature()
def optimize_odt(mesh: MeshT, **options: Unpack[OptionKeywords]) -> MeshT:
    """Improve a mesh by Optimal Delaunay Triangulation: moves vertices and flips edges or faces.

    Parameters
    ----------
    mesh : TriangleMesh, TetraMesh or t.geometry.TriangleMesh
    **options     of :func:`odt_plugins.optimize`
    """
    _expect_mesh(mesh)
    return optimize_mesh(mesh, **options)


def remesh_odt(mesh: MeshT, size: Any = None, **options: Any) -> MeshT:
    """Give a mesh other sizes, see :func:`odt_plugins.remesh`.

    Parameters
    ----------
    mesh : TriangleMesh, TetraMesh or t.geometry.TriangleMesh
    size : float, array, str or callable    length that edges should have
    **options                               of :func:`odt_plugins.remesh`, such as `scale`
    """
    _expect_mesh(mesh)
    return cast("MeshT", remesh(mesh, size, **options))


METHODS = (filter_smooth_odt, filter_smooth_cpt, filter_smooth_odt_global, optimize_odt, remesh_odt)
"""What register() adds to the mesh classes of open3d."""


def register() -> None:
    """Make the functions of this file methods of open3d's mesh classes."""
    import open3d

    for kind in (open3d.geometry.TriangleMesh, open3d.geometry.TetraMesh,
                 open3d.t.geometry.TriangleMesh):
        for function in METHODS:
            setattr(kind, function.__name__, function)


def _smooth(
    function: Any, mesh: Any, iterations: int, scope: Any, method: str, kind: Any, options: Any
) -> Any:
    _expect_mesh(mesh)
    name = "All" if scope is None else getattr(scope, "name", str(scope))
    if name not in ("All", "Vertex"):
        msg = (f"got filter_scope={scope!r}; expected FilterScope.All or FilterScope.Vertex: "
               "normals follow the vertices, and colours stay with them")
        raise InvalidOptionError(msg)
    own = {"method": method, "finish": False}
    lab = {"rounds": iterations, "cycles": 1, "connectivity": "none", **kind}
    values = options.get("smoothing", {})
    if not isinstance(values, Mapping):
        made = make_options(smoothing=values).smoothing
        values = {name: getattr(made, name) for name, about in SMOOTHING.items()
                  if getattr(made, name) != about.default}
    for given, fixed in ((options, own), (values, lab)):
        wrong = next((name for name in fixed if given.get(name, fixed[name]) != fixed[name]), None)
        if wrong is None:
            continue
        instead = "optimize_odt()" if wrong != "rounds" else (
            f"number_of_iterations={given[wrong]!r}")
        where, value = worded(wrong, given[wrong])
        msg = (f"got {where}={value!r}, which this filter sets to {fixed[wrong]!r}; expected other "
               f"options only, try {instead}")
        raise InvalidOptionError(msg)
    _expect_known(options, own, list(inspect.signature(function).parameters)[1:])
    try:
        out = optimize_mesh(mesh, **{**options, **own, "smoothing": {**values, **lab}})
    except ODTError as exc:
        words = re.sub(r"smoothing=\{'rounds': ([^{}]*)\}", r"number_of_iterations=\1", str(exc))
        raise reworded(exc, words, type(exc)) from exc
    if name == "Vertex":
        _restore_normals(out, mesh)
    return out


def _expect_known(options: Any, own: Any, parameters: list[str]) -> None:
    """Refuse keywords that a filter does not have, unless they say what it does anyway."""
    for name, value in options.items():
        plain = name in own or (name in OPTIONS and value == OPTIONS[name].default)
        if name in parameters or plain:
            continue
        hint = ", try optimize_odt()" if name in OPTIONS else hint_for(name, parameters)
        msg = f"got {name}={value!r}; expected some of {parameters} for this filter{hint}"
        raise InvalidOptionError(msg)


def _restore_normals(out: Any, mesh: Any) -> None:
    """Give the normals of another mesh back; vertices and triangles are the same."""
    if open3d_mesh.is_tensor(mesh):
        for new, old in ((out.vertex, mesh.vertex), (out.triangle, mesh.triangle)):
            if "normals" in old:
                new["normals"] = old["normals"].clone()
        return
    out.vertex_normals = mesh.vertex_normals
    if is_instance(mesh, "open3d", "TriangleMesh"):
        out.triangle_normals = mesh.triangle_normals


def _expect_mesh(mesh: Any) -> None:
    if not open3d_mesh.matches(mesh):
        kind = type(mesh)
        msg = (f"got an object of type {kind.__module__}.{kind.__qualname__}; expected an open3d "
               f"TriangleMesh or TetraMesh")
        raise UnsupportedMeshError(msg)
