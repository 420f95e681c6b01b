"""Filter scripts of MeshLab (.mlx) that mix its filters with those of odt_plugins."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

from odt_plugins.adapters import pymeshlab_mesh as adapter
from odt_plugins.errors import InvalidMeshError, MeshFileError
from odt_plugins.hosts.filter_table import BY_GUI, FILTERS, Filter, ParameterError

HEAD = b"<!DOCTYPE FilterScript>\n"


class Step(NamedTuple):
    """One filter of a script: its name there, its element, and the filter of ours it names."""

    name: str
    entry: ElementTree.Element
    own: Filter | None


def run_filter_script(
    meshes: Any,
    file: str | os.PathLike[str],
    *,
    progress: Callable[[str], None] | None = None,
) -> list[dict[str, Any]]:
    """Apply a filter script of MeshLab to a MeshSet, in place.

    Parameters
    ----------
    meshes : pymeshlab.MeshSet    its own filter script stays as it is
    file : path                   .mlx as MeshLab or `save_filter_script` writes it; the filters of
                                  odt_plugins are named as in MeshLab ("ODT Smoothing") or as in
                                  Python ("apply_coord_odt_smoothing")
    progress : callable           is told, line by line, what each filter did

    Returns
    -------
    list of dict                  what each filter returned; empty for the filters of MeshLab

    Raises
    ------
    MeshFileError                 the file cannot be read or is no filter script; nothing was done
    InvalidOptionError            a filter of odt_plugins has no such parameter; nothing was done
    InvalidMeshError              a filter of MeshLab failed; those before it were applied
    pymeshlab.PyMeshLabException  a filter of odt_plugins failed; those before it were applied
    """
    path = Path(file)
    try:
        text = path.read_bytes()
    except OSError as exc:
        msg = f"cannot read {path}: {exc.strerror or exc}; expected a filter script (.mlx)"
        raise MeshFileError(msg) from exc
    return apply_script(meshes, text, str(path), progress=progress)


def apply_script(
    meshes: Any, text: bytes, source: str, *, progress: Callable[[str], None] | None = None
) -> list[dict[str, Any]]:
    """Apply the text of a filter script; see :func:`run_filter_script`."""
    steps = read_script(text, source)
    given = [_parameters(step) for step in steps]
    before = adapter.saved_script(meshes)
    results: list[dict[str, Any]] = []
    try:
        for number, (step, parameters) in enumerate(zip(steps, given, strict=True), start=1):
            clock = time.perf_counter()
            if step.own is None:
                _run_native(meshes, step, f"filter {number} of {len(steps)} in {source}")
                took = 1000.0 * (time.perf_counter() - clock)
                results.append({})
                lines = [f"Applied filter {step.name} in {took:.0f} msec"]
            else:
                from odt_plugins.hosts.pymeshlab_filters import apply

                effect = apply(meshes, step.own.name, _lengths(step.own, parameters))
                results.append(effect.values)
                lines = effect.lines
            if progress is not None:
                for line in lines:
                    progress(line)
    finally:
        adapter.restore_script(meshes, before)
    return results


def read_script(text: bytes, source: str) -> list[Step]:
    """Split a filter script into its filters.

    Raises
    ------
    MeshFileError    it is no filter script
    """
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as exc:
        msg = f"{source} is no filter script: {exc}; expected XML with the root <FilterScript>"
        raise MeshFileError(msg) from exc
    if root.tag != "FilterScript":
        msg = f"{source} is no filter script: its root is <{root.tag}>, expected <FilterScript>"
        raise MeshFileError(msg)
    steps = []
    for entry in root:
        name = entry.get("name", "")
        if entry.tag not in ("filter", "xmlfilter") or not name:
            msg = f"{source} holds <{entry.tag}> without a filter; expected <filter name=...>"
            raise MeshFileError(msg)
        steps.append(Step(name, entry, BY_GUI.get(name) or FILTERS.get(name)))
    return steps


def _parameters(step: Step) -> dict[str, Any]:
    """Values of the parameters of one of our filters, by their Python names."""
    if step.own is None:
        return {}
    known = {parameter.name: parameter for parameter in step.own.parameters}
    values = {}
    for entry in step.entry:
        name = entry.get("name", "").lower()
        if name not in known:
            msg = (
                f"Parameter {name} not found for filter {step.name}. "
                f"Its parameters are {', '.join(known) or 'none'}."
            )
            raise ParameterError(msg)
        values[name] = known[name].from_script(entry.attrib)
        if entry.get("type") == "RichPercentage":
            values[name] = (values[name],)
    return values


def _lengths(chosen: Filter, values: dict[str, Any]) -> dict[str, Any]:
    """Wrap lengths as pymeshlab does: absolute ones, or percent of the diagonal."""
    from pymeshlab import PercentageValue, PureValue

    out = dict(values)
    for parameter in chosen.parameters:
        if parameter.kind == "length" and parameter.name in values:
            value = values[parameter.name]
            percent = isinstance(value, tuple)
            out[parameter.name] = PercentageValue(value[0]) if percent else PureValue(value)
    return out


def _run_native(meshes: Any, step: Step, where: str) -> None:
    """Let MeshLab apply one filter of its own."""
    from pymeshlab import PyMeshLabException

    root = ElementTree.Element("FilterScript")
    root.append(step.entry)
    adapter.restore_script(meshes, HEAD + ElementTree.tostring(root))
    try:
        meshes.apply_filter_script()
    except PyMeshLabException as exc:
        reason = str(exc).partition("\n")[0]
        msg = (
            f"MeshLab could not apply {step.name!r}, {where}: {reason}; expected the name of a "
            f"filter in MeshLab's menus and a mesh that it can work on"
        )
        raise InvalidMeshError(msg) from exc
