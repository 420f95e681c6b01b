"""Filter scripts of MeshLab (.mlx) that mix its filters with those of odt_plugins."""

from __future__ import annotations

import difflib
import os
import re
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

from odt_plugins.adapters import files
from odt_plugins.adapters.meshio_mesh import one_cell
from odt_plugins.adapters.pymeshlab_copy import muted
from odt_plugins.adapters.pymeshlab_set import restore_script, saved_script
from odt_plugins.errors import InvalidMeshError, MeshFileError, require
from odt_plugins.hosts.filter_table import BY_GUI, FILTERS, ChoiceError, Filter, ParameterError
from odt_plugins.hosts.pymeshlab_apply import apply

HEAD = b"<!DOCTYPE FilterScript>\n"

SILENT = "Something really bad happened."
"""What MeshLab says when it does not know what happened."""

SURFACES = (".ply", ".obj", ".stl", ".off", ".wrl", ".dae", ".x3d", ".3ds", ".u3d", ".ctm", ".dxf")
"""Suffixes of the files that MeshLab writes."""

CREATING = frozenset((
    "Annulus", "Box/Cube", "Cone", "Dodecahedron", "Dodecahedron (symmetric)", "Fractal Terrain",
    "Grid Generator", "Icosahedron", "Implicit Surface", "Noisy Isosurface", "Octahedron",
    "Points on a Sphere", "Sphere", "Sphere Cap", "Tetrahedron", "Torus",
))
"""Filters of MeshLab that need no mesh; scripts with others crash it in an empty MeshSet."""

TETRAHEDRA = "generate_odt_tetrahedralization"


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
    InvalidOptionError            a filter of odt_plugins has no such parameter or refuses its
                                  value; nothing was done
    InvalidMeshError              a filter of MeshLab failed; those before it were applied
    pymeshlab.PyMeshLabException  a filter of odt_plugins failed; those before it were applied
    """
    return apply_script(meshes, _script_text(Path(file)), str(file), progress=progress)


def _script_text(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as exc:
        msg = f"cannot read {path}: {exc.strerror or exc}; expected a filter script (.mlx)"
        raise MeshFileError(msg) from exc


def run_script_on_files(
    script: Path,
    source: Path,
    target: Path,
    *,
    progress: Callable[[str], None] | None = None,
) -> None:
    """Load a mesh into MeshLab, apply a filter script, and write the current mesh.

    Parameters
    ----------
    script : path          .mlx
    source : path          of a format that MeshLab reads
    target : path          of a format that MeshLab writes; of a tetrahedral format of meshio
                           (.vtu, .msh, ...) it gets the tetrahedra of the script's last
                           "ODT Tetrahedralization"
    progress : callable    see :func:`run_filter_script`

    Raises
    ------
    MissingDependencyError    pymeshlab is not installed
    MeshFileError             a file cannot be read or written; `target` is then as it was before
    """
    require("a filter script", "pymeshlab", "pymeshlab")
    from pymeshlab import MeshSet, PyMeshLabException

    text = _script_text(script)
    steps = read_script(text, str(script))
    surface = target.suffix.lower() in SURFACES
    if not surface and not any(step.own and step.own.name == TETRAHEDRA for step in steps):
        msg = (f"cannot write {target}: MeshLab has no format {target.suffix!r}; expected one of "
               f"{' '.join(SURFACES)}, or {TETRAHEDRA} in the script for a file of tetrahedra")
        raise MeshFileError(msg)
    if surface:
        files.check_place(target)
    else:
        files.check_output(target)
        files.expect_same_kind(one_cell(4), target)
    if not source.is_file():
        msg = f"cannot read {source}: it is missing; expected a mesh file"
        raise MeshFileError(msg)
    meshes = MeshSet()
    try:
        with muted():
            meshes.load_new_mesh(str(source))
    except PyMeshLabException as exc:
        msg = f"cannot read {source}: {' '.join(str(exc).split())}; expected a file of MeshLab's"
        raise MeshFileError(msg) from exc
    results = apply_script(meshes, text, str(script), progress=progress)
    if surface:
        _save(meshes, target)
        return
    import meshio

    tets = next(result for result in reversed(results) if "tet_matrix" in result)
    cells = meshio.CellBlock("tetra", tets["tet_matrix"])
    files.write_file(target, meshio.Mesh(tets["tet_vertex_matrix"], [cells]))


def _save(meshes: Any, target: Path) -> None:
    """Write the current mesh beside its place, behind a link too, and rename it when complete."""
    from pymeshlab import PyMeshLabException

    try:
        real = Path(os.path.realpath(target))
        with tempfile.TemporaryDirectory(prefix=f".{target.stem}-", dir=real.parent) as folder:
            meshes.save_current_mesh(str(Path(folder) / target.name))
            # A texture or a material file is written beside the mesh, which refers to it.
            for part in sorted(Path(folder).iterdir(), key=lambda part: part.name == target.name):
                own = part.name == target.name
                os.replace(part, real if own else real.parent / part.name)
    except (PyMeshLabException, OSError) as exc:
        msg = f"cannot write {target}: {' '.join(str(exc).split())}; try another path or format"
        raise MeshFileError(msg) from exc


def apply_script(
    meshes: Any, text: bytes, source: str, *, progress: Callable[[str], None] | None = None
) -> list[dict[str, Any]]:
    """Apply the text of a filter script; see :func:`run_filter_script`."""
    steps = read_script(text, source)
    places = [f"filter {i} of {len(steps)} in {source}" for i in range(1, len(steps) + 1)]
    given = [_parameters(*step) for step in zip(steps, places, strict=True)]
    before = saved_script(meshes)
    results: list[dict[str, Any]] = []
    try:
        for step, parameters, place in zip(steps, given, places, strict=True):
            clock = time.perf_counter()
            if step.own is None:
                _run_native(meshes, step, place)
                took = 1000.0 * (time.perf_counter() - clock)
                results.append({})
                lines = [f"Applied filter {step.name} in {took:.0f} msec"]
            else:
                effect = apply(meshes, step.own.name, parameters)
                results.append(effect.values)
                lines = effect.lines
            if progress is not None:
                for line in lines:
                    progress(line)
    finally:
        restore_script(meshes, before)
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


def _parameters(step: Step, place: str) -> dict[str, Any]:
    """Values of the parameters of one of our filters, by their Python names.

    Raises
    ------
    ParameterError    an unknown name, or a value that the filter refuses
    """
    if step.own is None:
        return {}
    known = {parameter.name: parameter for parameter in step.own.parameters}
    values = {}
    try:
        for entry in step.entry:
            name = entry.get("name", "").lower()
            # An unknown one is refused with the values below.
            values[name] = known[name].from_script(entry.attrib) if name in known else None
            if entry.get("type") == "RichPercentage":
                values[name] = (values[name],)
        values = _lengths(step.own, values)
        step.own.values(values, diagonal=1.0, selected=False)
    except (ParameterError, ChoiceError) as exc:
        msg = f"{step.name}, {place}: {exc}"
        raise ParameterError(msg) from exc
    return values


def _lengths(chosen: Filter, values: dict[str, Any]) -> dict[str, Any]:
    """Wrap lengths as pymeshlab does: absolute ones, or percent of the diagonal.

    Raises
    ------
    ParameterError    a percentage out of range
    """
    from pymeshlab import InvalidPercentageException, PercentageValue, PureValue

    out = dict(values)
    for parameter in chosen.parameters:
        if parameter.kind == "length" and parameter.name in values:
            value = values[parameter.name]
            percent = isinstance(value, tuple)
            try:
                out[parameter.name] = PercentageValue(value[0]) if percent else PureValue(value)
            except InvalidPercentageException as exc:
                msg = f"Parameter {parameter.name}: {exc}"
                raise ParameterError(msg) from exc
    return out


def _run_native(meshes: Any, step: Step, where: str) -> None:
    """Let MeshLab apply one filter of its own, unless it would end the process."""
    from pymeshlab import PyMeshLabException

    if not meshes.mesh_number() and step.name not in CREATING:
        msg = (f"{step.name} requires at least one mesh loaded in the MeshSet ({where}), try "
               f"load_new_mesh()")
        raise InvalidMeshError(msg)
    for entry in step.entry:
        value = entry.get("value", "")
        if entry.get("type") == "RichMesh" and not (
                value.isdecimal() and meshes.mesh_id_exists(int(value))):
            msg = (f"{step.name}, {where}: {entry.get('name')} is {value!r}; expected the id of a "
                   f"mesh of the MeshSet")
            raise InvalidMeshError(msg)
    root = ElementTree.Element("FilterScript")
    root.append(step.entry)
    restore_script(meshes, HEAD + ElementTree.tostring(root))
    try:
        meshes.apply_filter_script()
    except PyMeshLabException as exc:
        if unknown := _unknown(step.name):
            msg = f"MeshLab has no filter {step.name!r}, {where}; {unknown}"
            raise InvalidMeshError(msg) from exc
        reason = str(exc).partition("\n")[0]
        reason = "it does not say why" if reason == SILENT else reason
        msg = (f"MeshLab could not apply {step.name!r}, {where}: {reason}; expected a mesh that "
               "this filter can work on")
        raise InvalidMeshError(msg) from exc


def _unknown(name: str) -> str:
    """What to try instead of a name that no filter has in MeshLab's menus; empty for one.

    pymeshlab has a list of names in menus only as its old names in Python, which are those in
    small letters, and what they are now.
    """
    import pymeshlab

    keys = Path(pymeshlab.__path__[0]) / "keys.txt"
    pairs = [line.split() for line in keys.read_text(encoding="utf-8").splitlines()]
    menus = {old: (old.replace("_", " ").title(), new) for old, new in pairs}
    menus |= {_small(gui): (gui, own.name) for gui, own in BY_GUI.items()}
    if _small(name) in menus:
        return ""
    known = menus | {new: (gui, new) for gui, new in menus.values()}
    near = difflib.get_close_matches(_small(name), known, n=1)
    if not near:
        return "expected the name of a filter in MeshLab's menus"
    gui, new = known[near[0]]
    return f"the nearest in its menus is {gui!r} ({new} in Python)"


def _small(name: str) -> str:
    """A name in menus as pymeshlab makes names in Python of them."""
    return "_".join(re.findall("[a-z0-9]+", name.lower()))
