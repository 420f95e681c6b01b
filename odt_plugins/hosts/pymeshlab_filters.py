"""Filters of odt_plugins inside pymeshlab: methods, apply_filter, scripts, lists and log."""

from __future__ import annotations

import inspect
import io
import re
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import redirect_stdout
from typing import Any
from xml.etree import ElementTree

from odt_plugins.adapters.pymeshlab_copy import muted
from odt_plugins.adapters.pymeshlab_set import restore_script, saved_script
from odt_plugins.errors import ODTError, UnsupportedMeshError
from odt_plugins.hosts.filter_table import BY_GUI, FILTERS, ChoiceError, Filter, ParameterError
from odt_plugins.hosts.pymeshlab_work import WORK, Effect, diagonal

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
    values = chosen.values(given, diagonal(meshes), _has_selection(meshes))
    script = saved_script(meshes)
    verbose = _is_verbose(meshes)
    if verbose:
        _say(f"\nApplying filter {chosen.name} with the following parameters:\n{values}\n")
    meshes.set_verbosity(False)
    clock = time.perf_counter()
    entry = script_entry(chosen, values, diagonal(meshes))
    try:
        effect = WORK[chosen.name](meshes, values)
        script = _with_entry(script, entry)
    finally:
        meshes.set_verbosity(verbose)
        restore_script(meshes, script)
    took = 1000.0 * (time.perf_counter() - clock)
    effect.lines.append(f"Applied filter {chosen.gui} in {took:.0f} msec")
    if verbose:
        _log([*effect.lines, f"{chosen.name} applied!    [ 100% ]"])
        _say("\n")
    return effect


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
    with muted(), redirect_stdout(heard):
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
        return FILTERS[name].values(kwargs, diagonal(self), _has_selection(self))
    except ODTError as exc:
        raise _in_words(exc, name) from exc


def _apply_filter_script(native: Any, self: Any) -> None:
    from odt_plugins.hosts.script import apply_script

    script = saved_script(self)
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
