"""What the filters of odt_plugins inside pymeshlab do to a MeshSet."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.pymeshlab_copy import custom_attributes, private_copy
from odt_plugins.adapters.pymeshlab_mesh import InPlace
from odt_plugins.adapters.pymeshlab_set import exchange
from odt_plugins.api import optimize_with_report
from odt_plugins.errors import InvalidMeshError, ODTError
from odt_plugins.hosts.filter_table import ParameterError
from odt_plugins.mesh.simplex import vertices_of
from odt_plugins.options import KEPT
from odt_plugins.remeshing import remesh_with_report
from odt_plugins.tetwild import compare_with_surface, read_surface, run_tetwild

if TYPE_CHECKING:
    from odt_plugins.report.report import Report

EDGES = tuple(
    f"sqrt((x{i}-x{j})^2+(y{i}-y{j})^2+(z{i}-z{j})^2)" for i, j in ((0, 1), (1, 2), (2, 0))
)
_A, _B, _C = EDGES
RADIUS_RATIO = (
    f"min(({_A}), ({_B}), ({_C})) > 0 ? "
    f"max(0, ({_B}+{_C}-{_A})/({_A}) * ({_C}+{_A}-{_B})/({_B}) * ({_A}+{_B}-{_C})/({_C})) : 0"
)
"""2 r/R (5.1) of a triangle in the language of MeshLab's function filters."""


class Effect(NamedTuple):
    """What a filter did: the values it returns, and its lines in the log."""

    values: dict[str, Any]
    lines: list[str]


def _smooth(meshes: Any, values: Mapping[str, Any], method: str, solver: str) -> Effect:
    old = np.array(meshes.current_mesh().vertex_matrix())
    options = _options(values, diagonal(meshes)) | {"method": method, "finish": False}
    options["smoothing"] |= {"solver": solver, "connectivity": "none"}
    _, report = optimize_with_report(
        InPlace(meshes), **options, **_scope(meshes, values["selected"]),
    )
    return _effect(old, meshes.current_mesh().vertex_matrix(), report, "Smoothed {} vertices")


def _optimize(meshes: Any, values: Mapping[str, Any]) -> Effect:
    old, faces = _arrays(meshes)
    _, report = optimize_with_report(
        InPlace(meshes), **_options(values, diagonal(meshes)),
        **_scope(meshes, values["selected"]),
    )
    points, new = _arrays(meshes)
    fresh = _new_rows(faces, new)
    effect = _effect(old, points, report, "Moved {} vertices")
    effect.values["new_faces"] = fresh
    effect.lines.insert(1, f"Flipped edges, {fresh} faces are new")
    return effect


def _remesh(meshes: Any, values: Mapping[str, Any]) -> Effect:
    old, _ = _arrays(meshes)
    length = diagonal(meshes)
    count, name = values["targetfacenum"], values["adaptto"]
    sizes: dict[str, Any] = {"size": "curvature" if values["adaptive"] else values["targetlen"]}
    if count:
        sizes = {"cells": count}
    if name:
        if not count:
            msg = f"Parameter adaptto: got {name!r}; expected targetfacenum above 0 beside it"
            raise ParameterError(msg)
        sizes["adapt"] = name
    _, report = remesh_with_report(
        InPlace(meshes), **sizes, envelope=values["maxsurfdist"] / length,
        feature_angle=values["featuredeg"], fields=values["fields"],
        **{"regions": values["regions"]} if values["regions"] else {},
        **_scope(meshes, values["selectedonly"]),
    )
    points, faces = _arrays(meshes)
    effect = _effect(old, points, report, "{} vertices moved or are new")
    effect.values.update(vertices=len(points), faces=len(faces))
    effect.lines[:1] = [f"{len(points)} vertices, {len(faces)} faces", effect.lines[0],
                        *report.notes]
    return effect


def _arrays(meshes: Any) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    mesh = meshes.current_mesh()
    return np.array(mesh.vertex_matrix()), np.array(mesh.face_matrix())


def _radius_ratio(meshes: Any, values: Mapping[str, Any]) -> Effect:
    """MeshLab's function filter, which bears no attributes of faces but those of a copy."""
    if any(attribute.reader.startswith("face") for attribute in custom_attributes(meshes)):
        exchange(meshes, private_copy(meshes.current_mesh()))
    meshes.apply_filter("compute_scalar_by_function_per_face", q=RADIUS_RATIO)
    quality = meshes.current_mesh().face_scalar_array()
    found = {"min_radius_ratio": float(quality.min()), "mean_radius_ratio": float(quality.mean())}
    figures = f"min {quality.min():.4f}, mean {quality.mean():.4f}"
    return Effect(found, [f"Radius ratio of {len(quality)} faces: {figures}"])


def _tetrahedralize(meshes: Any, values: Mapping[str, Any]) -> Effect:
    surface = meshes.current_mesh()
    length = diagonal(meshes)
    given = read_surface(*_arrays(meshes)) | {
        "edge_length_fac": values["targetlen"] / length,
        "epsilon": values["maxsurfdist"] / length,
        "vtk_ordering": True,
        "disable_filtering": False,
    }
    options = _options(values, length)
    try:
        tets = run_tetwild(given)
    except (RuntimeError, ValueError) as exc:
        if isinstance(exc, ODTError):
            raise
        msg = f"TetWild failed: {exc}; expected a closed surface, try meshing_close_holes()"
        raise InvalidMeshError(msg) from exc
    (points, cells), report = optimize_with_report(tets, **options)
    compare_with_surface(given, options, (points, cells))
    used, faces = boundary_surface(cells)
    matrix = np.array(surface.transform_matrix())
    from pymeshlab import Mesh

    meshes.add_mesh(Mesh(points[used], faces), f"{surface.label()} tetrahedralization", True)
    if not np.array_equal(matrix, np.eye(4)):
        meshes.apply_filter("set_matrix", transformmatrix=matrix, freeze=False)
    effect = _effect(tets[0], points, report, "Moved {} vertices of the tetrahedra")
    if values["insert"]:
        came, went = (report.counts[f"vertices {what}"] for what in ("added", "removed"))
        effect.values.update(vertices_added=came, vertices_removed=went)
        effect.lines.insert(1, f"{came} vertices added, {went} vertices removed")
    effect.values.update(tet_vertex_matrix=points, tet_matrix=cells, boundary_vertex_index=used)
    effect.lines.insert(0, f"{len(points)} vertices, {len(cells)} tetrahedra, "
                           f"{len(faces)} boundary faces")
    return effect


def boundary_surface(cells: NDArray[np.int32]) -> tuple[NDArray[np.intp], NDArray[np.int32]]:
    """Boundary of positively oriented tetrahedra, seen from outside.

    Returns
    -------
    used : (k,) int        vertices on the boundary, increasing
    faces : (f, 3) int32   triangles of positions in `used`, normals outwards
    """
    sides = np.concatenate([cells[:, [1, 2, 3]], cells[:, [0, 3, 2]], cells[:, [0, 1, 3]],
                            cells[:, [0, 2, 1]]])
    _, first, count = np.unique(
        np.sort(sides, axis=1), axis=0, return_index=True, return_counts=True)
    outer = sides[np.sort(first[count == 1])]
    used, faces = np.unique(outer, return_inverse=True)
    return used.astype(np.intp), faces.reshape(-1, 3).astype(np.int32)


def _options(values: Mapping[str, Any], length: float) -> dict[str, Any]:
    """Options of :func:`odt_plugins.optimize` that MeshLab's words stand for; length: diagonal."""
    lab = {"rounds": values["stepsmoothnum"], "cycles": values.get("iterations", 1)}
    options = {"smoothing": lab, "density": values["density"],
               "keep": KEPT if values["keepquality"] else ()}
    for name in ("fields", "objective", "insert"):
        if name in values:
            options[name] = values[name]
    if values.get("freelayers"):
        options["free"] = "layers"
    if values.get("regions"):
        options["regions"] = values["regions"]
    if values.get("boundary"):
        options["boundary"] = "slide"
    if "envelope" in values:
        options |= {"envelope": values["envelope"] / length, "feature_angle": values["featuredeg"]}
    return options


def _scope(meshes: Any, selected: bool) -> dict[str, Any]:
    """Restrict to the selected faces or, when there are none, to the selected vertices."""
    if not selected:
        return {}
    mesh = meshes.current_mesh()
    faces = np.array(mesh.face_selection_array())
    vertices = np.array(mesh.vertex_selection_array())
    if vertices.any() and not faces.any():
        return {"fixed": ~vertices}
    return {"selection": faces}


def _effect(
    old: NDArray[np.float64], new: NDArray[np.float64], report: Report, title: str
) -> Effect:
    """Figures of a run, for the result and for the log."""
    there = {point.tobytes() for point in old}
    moved = sum(point.tobytes() not in there for point in new)
    moved -= report.counts.get("vertices added", 0)
    a, b = report.before, report.after
    lines = [
        title.format(moved),
        f"Radius ratio min {a.min_quality:.4f} -> {b.min_quality:.4f}, "
        f"mean {a.mean_quality:.4f} -> {b.mean_quality:.4f}",
        f"Angles {a.min_angle:.2f} .. {a.max_angle:.2f} -> {b.min_angle:.2f} .. {b.max_angle:.2f}",
    ]
    if report.fallback:
        lines.append(f"Fell back: {report.fallback}")
    found = {"moved_vertices": moved, "min_radius_ratio": b.min_quality,
             "mean_radius_ratio": b.mean_quality, "min_angle": b.min_angle,
             "max_angle": b.max_angle, "min_radius_ratio_before": a.min_quality,
             "mean_radius_ratio_before": a.mean_quality}
    return Effect(found, lines)


def _new_rows(old: NDArray[np.int32], new: NDArray[np.int32]) -> int:
    """Count the faces of `new` whose vertices no face of `old` has."""
    both = np.concatenate([np.unique(np.sort(old, axis=1), axis=0), np.sort(new, axis=1)])
    return int(len(np.unique(both, axis=0)) - len(np.unique(np.sort(old, axis=1), axis=0)))


def diagonal(meshes: Any) -> float:
    """Length of the diagonal of the box around the current mesh's faces, 1 where it has none.

    Vertices without finite coordinates do not count: what refuses these names them.
    """
    points, faces = _arrays(meshes)
    points = points[vertices_of(faces)]
    points = points[np.isfinite(points).all(axis=1)]
    sides = points.max(axis=0) - points.min(axis=0) if len(points) else np.zeros(3)
    return float(np.sqrt((sides**2).sum())) or 1.0


WORK: dict[str, Callable[[Any, Mapping[str, Any]], Effect]] = {
    "apply_coord_odt_smoothing": lambda m, v: _smooth(m, v, "odt", "gauss-seidel"),
    "apply_coord_cpt_smoothing": lambda m, v: _smooth(m, v, "cpt", "gauss-seidel"),
    "apply_coord_odt_global_smoothing": lambda m, v: _smooth(m, v, "odt", "global"),
    "meshing_odt_optimization": _optimize,
    "meshing_odt_remeshing": _remesh,
    "compute_scalar_by_radius_ratio_per_face": _radius_ratio,
    "generate_odt_tetrahedralization": _tetrahedralize,
}
"""What every filter does."""
