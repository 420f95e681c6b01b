"""Filters of odt_plugins inside pymeshlab: methods, apply_filter, scripts, lists and log."""

from __future__ import annotations

import inspect
import io
import re
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import redirect_stdout
from typing import TYPE_CHECKING, Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters import pymeshlab_mesh as adapter
from odt_plugins.api import optimize_with_report
from odt_plugins.errors import (
    InvalidMeshError,
    ODTError,
    UnsupportedMeshError,
)
from odt_plugins.hosts.filter_table import BY_GUI, FILTERS, ChoiceError, Filter, ParameterError
from odt_plugins.options import FIGURES
from odt_plugins.tetwild import run_tetwild

if TYPE_CHECKING:
    from odt_plugins.report import Report

WORDS = (
    (r"pytetwild\.tetrahedralize", "generate_odt_tetrahedralization"),
    (r"closing its holes", "meshing_close_holes()"),
    (r"orient=True", "meshing_re_orient_faces_coherently()"),
    (r"removing the cells that overlap", "meshing_repair_non_manifold_edges()"),
    (r"removing repeated cells", "meshing_remove_duplicate_faces()"),
    (r"removing such cells", "meshing_remove_null_faces()"),
    (r"\bcells\b", "faces"),
    (r"\bcell\b", "face"),
    (r"\bpoints\b", "vertices"),
    (r"\bpoint\b", "vertex"),
)
"""What MeshLab calls the things that error messages speak of."""

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


def register() -> None:
    """Add the filters to pymeshlab: methods, apply_filter, lists, filter scripts."""
    import pymeshlab

    kind = pymeshlab.MeshSet
    if hasattr(kind, next(iter(FILTERS))):
        return
    for chosen in FILTERS.values():
        setattr(kind, chosen.name, _method(chosen))
    _replace(kind, "apply_filter", _apply_filter)
    _replace(kind, "filter_parameter_values", _filter_parameter_values)
    _replace(kind, "apply_filter_script", _apply_filter_script)
    for name, function in (
        ("filter_list", _filter_list),
        ("print_filter_list", _print_filter_list),
        ("print_filter_parameter_list", _print_filter_parameter_list),
        ("search", _search),
    ):
        _replace(pymeshlab, name, function)


def run_filter(meshes: Any, name: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """Apply one of the filters to a MeshSet, in place, as its apply_filter does.

    Parameters
    ----------
    meshes : pymeshlab.MeshSet    its current mesh is changed, or a new one added
    name : str                    in FILTERS
    given : dict                  parameters; the others take their defaults

    Returns
    -------
    dict                          what the filter returns

    Raises
    ------
    pymeshlab.PyMeshLabException  and at the same time the error of odt_plugins
    """
    return apply(meshes, name, given).values


def apply(meshes: Any, name: str, given: Mapping[str, Any]) -> Effect:
    """Apply a filter as :func:`run_filter` does and tell its lines in the log as well."""
    try:
        return _apply(meshes, FILTERS[name], given)
    except ODTError as exc:
        raise _in_words(exc, name) from exc


def _apply(meshes: Any, chosen: Filter, given: Mapping[str, Any]) -> Effect:
    _require_faces(meshes, chosen.name)
    values = chosen.values(given, _diagonal(meshes), _has_selection(meshes))
    script = adapter.saved_script(meshes)
    verbose = _is_verbose(meshes)
    if verbose:
        _say(f"\nApplying filter {chosen.name} with the following parameters:\n{values}\n")
    meshes.set_verbosity(False)
    clock = time.perf_counter()
    entry = script_entry(chosen, values, _diagonal(meshes))
    try:
        effect = WORK[chosen.name](meshes, values)
        script = _with_entry(script, entry)
    finally:
        meshes.set_verbosity(verbose)
        adapter.restore_script(meshes, script)
    took = 1000.0 * (time.perf_counter() - clock)
    effect.lines.append(f"Applied filter {chosen.gui} in {took:.0f} msec")
    if verbose:
        _log([*effect.lines, f"{chosen.name} applied!    [ 100% ]"])
        _say("\n")
    return effect


def _smooth(meshes: Any, values: Mapping[str, Any], method: str, solver: str) -> Effect:
    old = np.array(meshes.current_mesh().vertex_matrix())
    options = _options(values, _diagonal(meshes)) | {"method": method, "solver": solver}
    _, report = optimize_with_report(
        adapter.InPlace(meshes), connectivity="none", finish=False, cycles=1, **options,
        **_scope(meshes, values["selected"]),
    )
    return _effect(old, meshes.current_mesh().vertex_matrix(), report, "Smoothed {} vertices")


def _optimize(meshes: Any, values: Mapping[str, Any]) -> Effect:
    old, faces = _arrays(meshes)
    _, report = optimize_with_report(
        adapter.InPlace(meshes), cycles=values["iterations"],
        **_options(values, _diagonal(meshes)),
        **_scope(meshes, values["selected"]),
    )
    points, new = _arrays(meshes)
    fresh = _new_rows(faces, new)
    effect = _effect(old, points, report, "Moved {} vertices")
    effect.values["new_faces"] = fresh
    effect.lines.insert(1, f"Flipped edges, {fresh} faces are new")
    return effect


def _arrays(meshes: Any) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    mesh = meshes.current_mesh()
    return np.array(mesh.vertex_matrix()), np.array(mesh.face_matrix())


def _radius_ratio(meshes: Any, values: Mapping[str, Any]) -> Effect:
    """MeshLab's function filter, which bears no attributes of faces but those of a copy."""
    if any(attribute.reader.startswith("face") for attribute in adapter.custom_attributes(meshes)):
        adapter.exchange(meshes, adapter.private_copy(meshes.current_mesh()))
    meshes.apply_filter("compute_scalar_by_function_per_face", q=RADIUS_RATIO)
    quality = meshes.current_mesh().face_scalar_array()
    found = {"min_radius_ratio": float(quality.min()), "mean_radius_ratio": float(quality.mean())}
    figures = f"min {quality.min():.4f}, mean {quality.mean():.4f}"
    return Effect(found, [f"Radius ratio of {len(quality)} faces: {figures}"])


def _tetrahedralize(meshes: Any, values: Mapping[str, Any]) -> Effect:
    surface = meshes.current_mesh()
    diagonal = _diagonal(meshes)
    try:
        tets = run_tetwild({
            "vertices": np.array(surface.vertex_matrix()),
            "faces": np.array(surface.face_matrix()),
            "edge_length_fac": values["targetlen"] / diagonal,
            "epsilon": values["maxsurfdist"] / diagonal,
            "vtk_ordering": True,
        })
    except (RuntimeError, ValueError) as exc:
        if isinstance(exc, ODTError):
            raise
        msg = f"TetWild failed: {exc}; expected a closed surface, try meshing_close_holes()"
        raise InvalidMeshError(msg) from exc
    (points, cells), report = optimize_with_report(
        tets, cycles=values["iterations"], **_options(values, diagonal))
    used, faces = boundary_surface(cells)
    matrix = np.array(surface.transform_matrix())
    from pymeshlab import Mesh

    meshes.add_mesh(Mesh(points[used], faces), f"{surface.label()} tetrahedralization", True)
    if not np.array_equal(matrix, np.eye(4)):
        meshes.apply_filter("set_matrix", transformmatrix=matrix, freeze=False)
    effect = _effect(tets[0], points, report, "Moved {} vertices of the tetrahedra")
    effect.values.update(
        tet_vertex_matrix=points, tet_matrix=cells, boundary_vertex_index=used)
    effect.lines.insert(0, f"{len(points)} vertices, {len(cells)} tetrahedra, "
                           f"{len(faces)} boundary faces")
    return effect


WORK: dict[str, Callable[[Any, Mapping[str, Any]], Effect]] = {
    "apply_coord_odt_smoothing": lambda m, v: _smooth(m, v, "odt", "gauss-seidel"),
    "apply_coord_cpt_smoothing": lambda m, v: _smooth(m, v, "cpt", "gauss-seidel"),
    "apply_coord_odt_global_smoothing": lambda m, v: _smooth(m, v, "odt", "global"),
    "meshing_odt_optimization": _optimize,
    "compute_scalar_by_radius_ratio_per_face": _radius_ratio,
    "generate_odt_tetrahedralization": _tetrahedralize,
}
"""What every filter does."""


def boundary_surface(
    cells: NDArray[np.int32],
) -> tuple[NDArray[np.intp], NDArray[np.int32]]:
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


def _options(values: Mapping[str, Any], diagonal: float) -> dict[str, Any]:
    """Options of :func:`odt_plugins.optimize` that MeshLab's words stand for."""
    options = {"rounds": values["stepsmoothnum"], "density": values["density"],
               "keep": FIGURES if values["keepquality"] else ()}
    if values.get("boundary"):
        options["boundary"] = "slide"
    if "envelope" in values:
        options |= {"envelope": values["envelope"] / diagonal,
                    "feature_angle": values["featuredeg"]}
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
    moved = int((old != new).any(axis=1).sum())
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


def _require_faces(meshes: Any, name: str) -> None:
    if not meshes.mesh_number():
        msg = f"{name} requires at least one mesh loaded in the MeshSet."
        raise UnsupportedMeshError(msg)
    mesh = meshes.current_mesh()
    if not mesh.is_compact():
        mesh.compact()
    if not mesh.face_number():
        msg = "Current mesh does not have any faces."
        raise UnsupportedMeshError(msg)


def _diagonal(meshes: Any) -> float:
    points = meshes.current_mesh().vertex_matrix()
    return float(np.sqrt(((points.max(axis=0) - points.min(axis=0)) ** 2).sum()))


def _has_selection(meshes: Any) -> bool:
    return bool(meshes.current_mesh().selected_face_number() > 0)


def _in_words(exc: ODTError, name: str) -> Exception:
    """Make the same error an exception of pymeshlab too, in MeshLab's words."""
    import pymeshlab

    text = str(exc)
    host = pymeshlab.InvalidEnumException if isinstance(exc, ChoiceError) else (
        pymeshlab.PyMeshLabException)
    if not isinstance(exc, ParameterError | ChoiceError):
        for pattern, word in WORDS:
            text = re.sub(pattern, word, text)
        if not text.startswith(name):
            text = f"Failed to apply filter: {name}\n{text}"
    error: Exception = type(type(exc).__name__, (type(exc), host), {})(text)
    return error


def _is_verbose(meshes: Any) -> bool:
    """Watch a filter that changes nothing: pymeshlab does not tell whether a set is verbose."""
    heard = io.StringIO()
    with adapter.muted(), redirect_stdout(heard):
        meshes.apply_filter("set_mesh_name")
    return bool(heard.getvalue())


def _say(text: str) -> None:
    sys.stdout.write(text)
    sys.stdout.flush()


def _log(lines: list[str]) -> None:
    """Write lines where and as MeshLab's own filters do."""
    for line in lines:
        sys.stderr.write(f"LOG: 2 {line}\n")
    sys.stderr.flush()


def script_entry(
    chosen: Filter, values: Mapping[str, Any], diagonal: float
) -> ElementTree.Element:
    """Make the element <filter> of a filter script."""
    entry = ElementTree.Element("filter", name=chosen.gui)
    for parameter in chosen.parameters:
        attributes = parameter.to_script(values[parameter.name], diagonal)
        ElementTree.SubElement(entry, "Param", attributes)
    return entry


def _with_entry(script: bytes, entry: ElementTree.Element) -> bytes:
    root = ElementTree.fromstring(script)
    root.append(entry)
    return b"<!DOCTYPE FilterScript>\n" + ElementTree.tostring(root)


def _method(chosen: Filter) -> Callable[..., Any]:
    def method(self: Any, **parameters: Any) -> Any:
        return run_filter(self, chosen.name, parameters)

    own = inspect.Parameter("self", inspect.Parameter.POSITIONAL_ONLY)
    keywords = [
        inspect.Parameter(p.name, inspect.Parameter.KEYWORD_ONLY, default=p.default)
        for p in chosen.parameters
    ]
    method.__name__ = chosen.name
    method.__qualname__ = f"MeshSet.{chosen.name}"
    method.__doc__ = chosen.doc()
    method.__signature__ = inspect.Signature([own, *keywords])  # type: ignore[attr-defined]
    return method


def _replace(owner: Any, name: str, wrapper: Callable[..., Any]) -> None:
    """Put a wrapper before a function of pymeshlab; it gets that function first."""
    native = getattr(owner, name)

    def wrapped(*args: Any, **kwargs: Any) -> Any:
        return wrapper(native, *args, **kwargs)

    wrapped.__name__ = name
    wrapped.__doc__ = native.__doc__
    setattr(owner, name, wrapped)


def _apply_filter(native: Any, self: Any, filter_name: str, **kwargs: Any) -> Any:
    if filter_name in FILTERS:
        return run_filter(self, filter_name, kwargs)
    return native(self, filter_name, **kwargs)


def _filter_parameter_values(native: Any, self: Any, name: str, **kwargs: Any) -> Any:
    if name not in FILTERS:
        return native(self, name, **kwargs)
    try:
        _require_faces(self, name)
        return FILTERS[name].values(kwargs, _diagonal(self), _has_selection(self))
    except ODTError as exc:
        raise _in_words(exc, name) from exc


def _apply_filter_script(native: Any, self: Any) -> None:
    from odt_plugins.script import apply_script

    script = adapter.saved_script(self)
    names = [entry.get("name") for entry in ElementTree.fromstring(script)]
    if any(name in BY_GUI for name in names):
        apply_script(self, script, "the filter script")
    else:
        native(self)


def _filter_list(native: Any) -> list[str]:
    return sorted([*native(), *FILTERS])


def _print_filter_list(native: Any) -> None:
    native()
    _say("".join(f"\t{name}\n" for name in FILTERS))


def _print_filter_parameter_list(native: Any, name: str) -> None:
    if name not in FILTERS:
        native(name)
        return
    _say(f"{name} filter - list of parameter names:\n")
    for p in FILTERS[name].parameters:
        if p.kind == "length":
            shown = f"PercentageValue = {p.default}%"
        elif p.kind == "enum":
            shown = f"str = {p.default!r} (or one of {', '.join(map(repr, p.choices))})"
        else:
            shown = f"{p.kind} = {bool(p.default) if p.kind == 'bool' else p.default}"
        _say(f"\t{p.name} : {shown}\n")


def _search(native: Any, keyword: str) -> None:
    native(keyword)
    _say("".join(f"{name}\n" for name in FILTERS if keyword.lower() in name))
