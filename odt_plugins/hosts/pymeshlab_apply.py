"""One filter of odt_plugins applied to a MeshSet: its log, its errors, its entry in the script."""

from __future__ import annotations

import io
import re
import sys
import time
from collections.abc import Mapping
from contextlib import redirect_stdout
from typing import Any
from xml.etree import ElementTree

from odt_plugins.adapters.pymeshlab_copy import muted
from odt_plugins.adapters.pymeshlab_set import restore_script, saved_script
from odt_plugins.errors import ODTError, UnsupportedMeshError, reworded
from odt_plugins.hosts.filter_table import FILTERS, ChoiceError, Filter, ParameterError
from odt_plugins.hosts.pymeshlab_work import WORK, Effect, diagonal

WORDS = (
    (r"pytetwild\.tetrahedralize", "generate_odt_tetrahedralization"),
    (r"closing its holes", "meshing_close_holes()"),
    (r"repair='orient'", "meshing_re_orient_faces_coherently()"),
    (r"removing the (?:cells|faces) that overlap", "meshing_repair_non_manifold_edges()"),
    (r"removing repeated (?:cells|faces)", "meshing_remove_duplicate_faces()"),
    (r"removing such (?:cells|faces)", "meshing_remove_null_faces()"),
    (r"\bcells\b", "faces"),
    (r"\bcell\b", "face"),
    (r"\bpoints\b", "vertices"),
    (r"(?<!floating-)\bpoint\b", "vertex"),
)
"""What MeshLab calls the things that error messages speak of."""


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
        raise in_words(exc, name) from exc


def _apply(meshes: Any, chosen: Filter, given: Mapping[str, Any]) -> Effect:
    require_faces(meshes, chosen.name)
    values = chosen.values(given, diagonal(meshes), has_selection(meshes))
    script = saved_script(meshes)
    verbose = _is_verbose(meshes)
    if verbose:
        say(f"\nApplying filter {chosen.name} with the following parameters:\n{values}\n")
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
        say("\n")
    return effect


def require_faces(meshes: Any, name: str) -> None:
    """Refuse a MeshSet whose current mesh has no faces, in MeshLab's words."""
    if not meshes.mesh_number():
        msg = f"{name} requires at least one mesh loaded in the MeshSet."
        raise UnsupportedMeshError(msg)
    mesh = meshes.current_mesh()
    if not mesh.is_compact():
        mesh.compact()
    if not mesh.face_number():
        msg = "Current mesh does not have any faces."
        raise UnsupportedMeshError(msg)


def has_selection(meshes: Any) -> bool:
    """Whether faces of the current mesh are selected."""
    return bool(meshes.current_mesh().selected_face_number() > 0)


def in_words(exc: ODTError, name: str) -> Exception:
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
    error: Exception = reworded(exc, text, type(type(exc).__name__, (type(exc), host), {}))
    return error


def _is_verbose(meshes: Any) -> bool:
    """Watch a filter that changes nothing: pymeshlab does not tell whether a set is verbose."""
    heard = io.StringIO()
    with muted(), redirect_stdout(heard):
        meshes.apply_filter("set_mesh_name")
    return bool(heard.getvalue())


def say(text: str) -> None:
    """Write to standard output, where pymeshlab writes."""
    sys.stdout.write(text)
    sys.stdout.flush()


def _log(lines: list[str]) -> None:
    """Write lines where and as MeshLab's own filters do."""
    for line in lines:
        sys.stderr.write(f"LOG: 2 {line}\n")
    sys.stderr.flush()


def script_entry(chosen: Filter, values: Mapping[str, Any], diagonal: float) -> ElementTree.Element:
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
