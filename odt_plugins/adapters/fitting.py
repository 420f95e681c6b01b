"""What of a mesh each format of meshio holds, and a mesh made so that its writer takes it."""

from __future__ import annotations

import re
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.formats.decks import alike, indices
from odt_plugins.adapters.formats.gmsh_tables import BOOKKEEPING, ENTITY, PHYSICAL
from odt_plugins.adapters.formats.med_families import with_families
from odt_plugins.adapters.formats.medit_solution import is_solution
from odt_plugins.adapters.gmsh_files import is_group, same_names
from odt_plugins.adapters.higher_order import HIGHER, LAGRANGE, lattice, order_of
from odt_plugins.adapters.host import POINT_LABELS
from odt_plugins.adapters.regions import REGION_ARRAYS, are_ids, is_known
from odt_plugins.adapters.set_labels import (
    RANGES,
    SIDES,
    are_few,
    are_groups,
    are_one,
    are_tags,
    are_within,
    join_sets,
    mask_of,
    number_turned,
    numbers_of,
    of_sets,
    within,
)
from odt_plugins.errors import UnsupportedMeshError, counted


class Form(NamedTuple):
    """What a format holds.

    Attributes
    ----------
    label : str or None    name that meshio gives to the one array of labels of cells
    points, cells : bool   whether it holds other arrays of points and of cells
    beside : bool          whether it holds cells of lower dimension beside the others
    blocks : bool          whether several blocks may have cells of one type
    sets : bool            whether it holds sets
    text : bool            whether it is written as text or binary, as asked
    vertices : bool        whether it holds vertices as cells
    lines : bool           whether it holds lines as cells
    bent : bool            whether it holds lines with a node between their ends
    kinds : str            types of numbers and texts in arrays, by the letters of NumPy
    vectors : bool         whether arrays may have several numbers for each point or cell
    """

    label: str | None = None
    points: bool = True
    cells: bool = True
    beside: bool = True
    blocks: bool = False
    sets: bool = False
    text: bool = False
    vertices: bool = True
    lines: bool = True
    bent: bool = True
    kinds: str = "biuf"
    vectors: bool = True


EVERYTHING = Form(sets=True, text=True, kinds="biufUS")

FORMS = {
    "abaqus": Form(points=False, cells=False, blocks=True, sets=True, vertices=False,
                   bent=False),
    "avsucd": Form("avsucd:material"),
    "cgns": Form(points=False, cells=False, sets=True),
    "dolfin-xml": Form(points=False, beside=False, kinds="iuf", vectors=False),
    "exodus": Form("exodus:block", blocks=True, sets=True),
    "flac3d": Form(points=False, cells=False, sets=True, text=True, vertices=False, lines=False),
    "gmsh": Form(blocks=True, sets=True, text=True),
    "gmsh22": Form(blocks=True, text=True),
    "h5m": Form(cells=False, vertices=False),
    "hmf": Form(kinds="biufc"),
    "mdpa": Form(vertices=False, bent=False),
    "med": Form("cell_tags", sets=True),
    "medit": Form("medit:ref", points=False, cells=False, vertices=False),
    "nastran": Form("nastran:ref", points=False, cells=False, vertices=False, bent=False),
    "netgen": Form("netgen:index", points=False, cells=False),
    "obj": Form(beside=False, blocks=True),
    "off": Form(beside=False, blocks=True),
    "ply": Form(blocks=True, text=True, vertices=False),
    "permas": Form(points=False, cells=False, blocks=True),
    "stl": Form(points=False, beside=False, blocks=True, sets=True, text=True),
    "su2": Form("su2:tag", points=False, cells=False, vertices=False),
    "tecplot": Form(beside=False, kinds="iuf", vectors=False),
    "tetgen": Form("tetgen:ref", points=False, cells=False, vertices=False),
    "ugrid": Form("ugrid:ref", points=False, cells=False, vertices=False, lines=False),
    "vtk": EVERYTHING,
    "vtp": EVERYTHING,
    "vtu": EVERYTHING,
    "wkt": Form(points=False, cells=False, beside=False),
    "xdmf": Form(kinds="iuf"),
}
"""Formats by their name in meshio; of those that are not here meshio is given all there is."""

NOT_XML = re.compile("[^\t\n\r -\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""A letter that XML 1.0 bars."""

TAGS = tuple(form.label for form in FORMS.values() if form.label)
"""Labels of cells of all formats, which are also physical groups in Gmsh's."""

LABELLED = ("avsucd", "exodus", "med")
"""Formats with a label of cells that hold other arrays of cells beside it."""

ARRAYS = ("dolfin-xml", "tecplot", "xdmf")
"""Formats without sets that hold arrays of cells, which have 0 and 1 for those of a set."""

MAIN = ("tetra", "triangle")

WIDTHS = (1, 3, 9)
"""Numbers that Gmsh's arrays may have for each point or cell."""

XDMF = (1, 2, 3, 6, 9)
"""Numbers of the values of XDMF that have a name; others are matrices."""

NETGEN = "netgen:index"
"""Labels of cells of Netgen's files, which have the names of materials."""

BARRED = {"avsucd": ",\r\n", "dolfin-xml": "/", "h5m": "/", "hmf": "/", "med": "/",
          **dict.fromkeys(("gmsh", "gmsh22", "tecplot"), '"\r\n')}
"""Letters that names of arrays cannot have in a format, where these are not ends of lines."""

SIMPLICES = ("tetra", "triangle")
"""What formats hold that know no cells with nodes on edges."""

POLYGONS = ("triangle", "quad", "polygon")
"""What formats of surfaces hold."""

HELD = {
    "flac3d": ("tetra",), "tetgen": ("tetra", "tetra10"),
    **dict.fromkeys(("avsucd", "dolfin-xml", "h5m", "medit", "su2", "tecplot", "ugrid"), SIMPLICES),
    **dict.fromkeys(("obj", "off", "ply", "stl"), POLYGONS),
    "vtp": (*POLYGONS, "line", "vertex"), "wkt": ("triangle",),
}
"""Formats without some cells of this package, and which of the greatest dimension they hold."""


def fitted(mesh: Any, name: str) -> tuple[Any, list[str]]:
    """Make a mesh that a format holds: one block a type, groups as labels, no more than it takes.

    Parameters
    ----------
    mesh : meshio.Mesh    not changed
    name : str            of the format

    Returns
    -------
    mesh : meshio.Mesh
    lost : list of str    cells that the format does not hold

    Raises
    ------
    UnsupportedMeshError    the format holds none of the cells of the greatest dimension
    """
    form = FORMS.get(name)
    if form is None:
        return mesh.copy(), []
    out = mesh.copy()
    lost = []
    if out.points.dtype not in (np.float32, np.float64):
        out.points = out.points.astype(np.float64)
    barred = "" if form is EVERYTHING else BARRED.get(name, "\r\n")
    out.point_data = {_title(key, barred): array for key, values in out.point_data.items()
                      if (array := _held(values, name, form)) is not None}
    parts = {_title(key, barred): [_held(part, name, form) for part in values]
             for key, values in out.cell_data.items()}
    out.cell_data = {key: arrays for key, arrays in parts.items()
                     if all(array is not None for array in arrays)}
    if form is EVERYTHING:
        out.point_sets, out.cell_sets = (
            {_title(key, barred): members for key, members in sets.items()}
            for sets in (out.point_sets, out.cell_sets))
        out.field_data = {_title(key, barred): array for key, values in out.field_data.items()
                          if (array := _held(np.atleast_1d(values), name, form)) is not None}
    dim, kinds = max((block.dim for block in out.cells), default=0), unheld(out, name)
    if kinds:
        msg = f"it holds no cells of type {kinds}"
        raise UnsupportedMeshError(msg)
    if not form.beside:
        main = next((kind for kind in MAIN if any(b.type == kind for b in out.cells)), None)
        others = {b.type for b in out.cells if main is not None and len(b.data)} - {main}
        lost = [f"{counted(sum(len(b.data) for b in out.cells if b.type == kind), 'cell')} of type "
                f"{kind}" for kind in sorted(others)]
        _choose(out, [i for i, b in enumerate(out.cells) if main in (None, b.type)])
    lines = form.lines and (name, dim) != ("su2", 3)
    for kind, held in (("vertex", form.vertices), ("line", lines), ("line3", form.bent)):
        count = sum(len(b.data) for b in out.cells if b.type == kind)
        if count and not held:
            if kind == "vertex" and form.sets:
                out.point_sets = _points_of(out) | out.point_sets
            lost.append(f"{counted(count, 'cell')} of type {kind}")
            _choose(out, [i for i, b in enumerate(out.cells) if b.type != kind])
    if name in ARRAYS:
        _sets_as_arrays(out, barred)
    _reorder(out, form)
    if name in ("gmsh", "gmsh22"):
        return _with_tags(out, name), lost
    if name in ("netgen", "su2"):
        number_turned(out)
    named = named_groups(out)
    join_sets(out, named)
    out.gmsh_periodic = None
    for own in BOOKKEEPING if form is not EVERYTHING else BOOKKEEPING[1:]:
        out.point_data.pop(own, None)
        out.cell_sets.pop(own, None)
    if named and not form.sets:
        out.cell_sets = {}
    elif form.cells and name not in LABELLED:
        out.cell_sets = {key: value for key, value in out.cell_sets.items() if key not in named}
    elif form.sets:
        out.cell_sets = named | out.cell_sets
    if form is not EVERYTHING:
        out.field_data = {key: value for key, value in out.field_data.items() if is_group(value)}
    if not form.blocks:
        _merge(out)
    labels = _labels(out, form.label, some=name == "exodus")
    if form.label and not form.sets:
        labels = of_sets(out, labels, families=labels is out.cell_data.get(FORMS["med"].label))
    if name in RANGES:
        labels = within(out, labels, name)
    if name == "exodus" and SIDES in out.cell_data:
        out.cell_data[SIDES] = within(out, out.cell_data[SIDES], name)
    if not form.cells or (form.label and name not in LABELLED):
        out.cell_data = {}
    if form.label and labels is not None:
        if PHYSICAL in out.cell_data:
            out.cell_data.pop(PHYSICAL)
            out.cell_data.pop(ENTITY, None)
        out.cell_data[form.label] = labels
    if not form.points:
        dim = out.points.shape[1]
        out.point_data = {key: value for key, value in out.point_data.items()
                          if (key in POINT_LABELS and key == form.label)
                          or (name == "medit" and is_solution(key, value, dim))}
    if name == "med":
        out.cell_data = {key: value for key, value in out.cell_data.items()
                         if key == form.label or value[0].dtype.kind == "f"}
        with_families(out)
        out.field_data = {}
    if name == "hmf" and len(out.cells) > 1:
        out.cell_data = {}
    if name == "su2":
        _one_marker(out)
    if name in ("obj", "off", "ugrid", "wkt") and out.points.shape[1] == 2:
        out.points = np.pad(out.points, ((0, 0), (0, 1)))
    return out, lost


def unheld(mesh: Any, name: str) -> str:
    """Types of the cells of the greatest dimension of a mesh if a format holds none of these."""
    dim = max((block.dim for block in mesh.cells), default=0)
    kinds = {block.type for block in mesh.cells if block.dim == dim and len(block.data)}
    return ", ".join(sorted(kinds)) * (name in HELD and not kinds & {*HELD[name]})


def _title(name: str, barred: str) -> str:
    """A name without barred letters and those that XML bars, and not empty."""
    return "".join("_" if letter in barred else letter
                   for letter in NOT_XML.sub("_", name)) or "unnamed"


def _held(values: Any, name: str, form: Form) -> NDArray[Any] | None:
    """Values in a type and a shape that a format holds, (n,) of (n, 1); None where it has none."""
    array = np.asarray(values)
    if form is EVERYTHING and array.dtype.kind == "c":
        array = np.stack([array.real, array.imag], axis=-1)
    kind, size = array.dtype.kind, array.dtype.itemsize
    if kind == "f" and size not in (4, 8):
        array = array.astype(np.float32 if size < 4 else np.float64)
    if kind == "b" and "b" not in form.kinds:
        array, kind = array.astype(np.uint8), "u"
    width = _width(array)
    if kind not in form.kinds or not width or (width > 1 and not form.vectors):
        return None
    if name == "xdmf" and width not in XDMF:
        return array.reshape(len(array), width, 1)
    whole = width > 1 and (array.ndim == 2 or name in ("hmf", "xdmf"))
    return array if whole else array.reshape((len(array), width) if width > 1 else -1)


def _choose(mesh: Any, chosen: list[int]) -> None:
    """Keep some of the blocks."""
    mesh.cells = [mesh.cells[i] for i in chosen]
    mesh.cell_data = {name: [values[i] for i in chosen] for name, values in mesh.cell_data.items()}
    mesh.cell_sets = {name: [members[i] for i in chosen]
                      for name, members in mesh.cell_sets.items()}


def _sets_as_arrays(mesh: Any, barred: str) -> None:
    """Give a mesh an array of 0 and 1 for each set with members."""
    sizes = [len(block.data) for block in mesh.cells]
    for title, rows in mesh.point_sets.items():
        if len(rows):
            mesh.point_data.setdefault(
                _title(title, barred), mask_of(rows, len(mesh.points)).astype(np.uint8))
    for title, members in mesh.cell_sets.items():
        masks = [mask_of(rows, size).astype(np.uint8)
                 for rows, size in zip(members, sizes, strict=True)
                 ] if title not in BOOKKEEPING else []
        if any(part.any() for part in masks):
            mesh.cell_data.setdefault(_title(title, barred), masks)


def _reorder(mesh: Any, form: Form) -> None:
    """Give cubic and higher simplices the names and the order of nodes that the format has."""
    from meshio import CellBlock

    gmsh = {(dim, order): name for name, (dim, order) in HIGHER.items() if order > 2}
    vtk = {dim: name for name, dim in LAGRANGE.items()}
    for i, block in enumerate(mesh.cells):
        if form is EVERYTHING and HIGHER.get(block.type, (0, 0)) in gmsh:
            dim, order = HIGHER[block.type]
            kind, hosts = vtk[dim], ("gmsh", "vtk")
        elif form is not EVERYTHING and block.type in LAGRANGE:
            dim = LAGRANGE[block.type]
            order = order_of(dim, block.data.shape[1])
            kind, hosts = gmsh.get((dim, order), block.type), ("vtk", "gmsh")
        else:
            continue
        if kind != block.type:
            was, now = ([tuple(node) for node in lattice(dim, order, host).tolist()]
                        for host in hosts)
            mesh.cells[i] = CellBlock(kind, block.data[:, [was.index(node) for node in now]])


def _merge(mesh: Any) -> None:
    """Join the blocks of each type, in the order in which the types first appear."""
    from meshio import CellBlock

    groups: dict[Any, list[int]] = {}
    for i, block in enumerate(mesh.cells):
        if len(block.data):
            groups.setdefault((block.type, np.shape(block.data)[1:]), []).append(i)
    if all(len(group) == 1 for group in groups.values()) and len(groups) == len(mesh.cells):
        return
    sizes = [len(block.data) for block in mesh.cells]
    mesh.cell_sets = {
        name: [np.concatenate([indices(members[i]) + sum(sizes[j] for j in group if j < i)
                               for i in group]) for group in groups.values()]
        for name, members in mesh.cell_sets.items()}
    mesh.cell_data = {name: [np.concatenate([np.asarray(values[i]) for i in group])
                             for group in groups.values()]
                      for name, values in mesh.cell_data.items()}
    mesh.cells = [CellBlock(kind, np.concatenate([mesh.cells[i].data for i in group]))
                  for (kind, _), group in groups.items()]


def _points_of(mesh: Any) -> dict[str, NDArray[np.int64]]:
    """Point sets of the named groups and the sets that have vertices as cells."""
    found = {}
    for name, members in (named_groups(mesh) | mesh.cell_sets).items():
        nodes = [np.asarray(block.data)[indices(rows), 0] for block, rows in
                 zip(mesh.cells, members, strict=True) if block.type == "vertex"]
        if sum(map(len, nodes)):
            found[name] = np.unique(np.concatenate(nodes))
    return found


def named_groups(mesh: Any) -> dict[str, list[Any]]:
    """Cell sets of the named groups of Gmsh and Netgen, as their labels tell them.

    Groups of one dimension that have the same name in their file are one set. A number below 0
    tells of a group whose entity is turned there.
    """
    groups = mesh.cell_data.get(PHYSICAL, mesh.cell_data.get(NETGEN))
    if groups is None:
        return {}
    there = [set(np.unique(np.abs(group)).tolist()) for group in groups]
    out = {}
    for tags in same_names(mesh.field_data):
        title = next(iter(tags))
        dim = mesh.field_data[title][1]
        out[title] = [np.flatnonzero(np.isin(np.abs(group), [*tags.values()]))
                      if block.dim == dim and not own.isdisjoint(tags.values())
                      else np.zeros(0, dtype=np.int64)
                      for block, group, own in zip(mesh.cells, groups, there, strict=True)]
    return out


def _labels(mesh: Any, label: str | None, *, some: bool) -> list[NDArray[Any]] | None:
    """Whole cell data to write as labels: the format's own array, else a known one, else others.

    Of others those whose names tell that they are labels come first, one number for all cells
    later, and ids last: or not at all, if `some` alone are asked for.
    """
    arrays = {name: numbers for name, values in mesh.cell_data.items()
              if (numbers := numbers_of(name, values)) is not None}

    def doubt(name: str) -> float:
        found = 2 - is_known(name) - (are_few(arrays[name]) and not are_ids(name))
        return max(found, 1.5) if are_one(arrays[name]) else found

    known = (label, *REGION_ARRAYS)
    there = [name for name in known if name in arrays]
    there += [name for name in sorted(arrays, key=doubt)
              if name not in known and not (some and doubt(name) == 2)]
    differ = [name for name in there if any(np.any(part) for part in arrays[name])]
    return arrays[(differ or there)[0]] if there else None


def _one_marker(mesh: Any) -> None:
    """Give cells at the boundary whose groups have the same name the number of the first."""
    labels = mesh.cell_data.get(FORMS["su2"].label)
    dim = max((block.dim for block in mesh.cells), default=0) - 1
    for tags in same_names(mesh.field_data) if labels else ():
        title, *others = tags
        if others and mesh.field_data[title][1] == dim:
            mesh.cell_data[FORMS["su2"].label] = labels = [
                np.where(np.isin(part, [*tags.values()]), tags[title], part)
                if block.dim == dim else part
                for block, part in zip(mesh.cells, labels, strict=True)]
            for other in others:
                del mesh.field_data[other]


def group_names(mesh: Any) -> set[str]:
    """Names of the physical groups of Gmsh that have cells."""
    return {name for name, members in named_groups(mesh).items() if any(map(len, members))}


def _group(mesh: Any) -> None:
    """Let cell sets be physical groups, a set with cells of several dimensions one in each.

    Cells of other choices of sets are of other entities, so that groups may overlap.
    """
    sets = {name: [indices(rows) for rows in members] for name, members in mesh.cell_sets.items()
            if name != BOOKKEEPING[1]}
    tags = [np.zeros(len(block.data), dtype=np.int64) for block in mesh.cells]
    entities = [np.ones(len(block.data), dtype=np.int64) for block in mesh.cells]
    names: dict[str, Any] = {}
    for dim in sorted({block.dim for block in mesh.cells}):
        own = [i for i, block in enumerate(mesh.cells) if block.dim == dim]
        there = [name for name, rows in sets.items() if any(len(rows[i]) for i in own)]
        size = [len(mesh.cells[i].data) for i in own]
        inside = np.zeros((sum(size), len(there)), dtype=np.bool_)
        for j, name in enumerate(there):
            start = 0
            for i, count in zip(own, size, strict=True):
                inside[start + sets[name][i], j] = True
                start += count
            title = name if name not in names else f"{name} ({dim}D)"
            names[title] = np.array([len(names) + 1, dim])
            if title != name:
                mesh.cell_sets[title] = mesh.cell_sets[name]
        if not there:
            continue
        numbers = np.array([names[n][0] for n in names if names[n][1] == dim])
        first = np.where(inside.any(axis=1), numbers[inside.argmax(axis=1)], 0)
        choice = alike([np.repeat(own, size), *inside.T])[1]
        ends = np.cumsum(size)[:-1]
        for i, tag, entity in zip(own, np.split(first, ends), np.split(choice + 1, ends),
                                  strict=True):
            tags[i], entities[i] = tag, entity
    mesh.field_data = names
    mesh.cell_data[PHYSICAL] = tags
    mesh.cell_data.setdefault(ENTITY, entities)
    for name in ("cell_tags", "point_tags"):
        mesh.cell_data.pop(name, None)
        mesh.point_data.pop(name, None)


def _with_tags(mesh: Any, name: str) -> Any:
    """Give a mesh for Gmsh the tags of groups and entities that it lacks; sets become groups."""
    if PHYSICAL not in mesh.cell_data and mesh.cell_sets:
        _group(mesh)
    if PHYSICAL not in mesh.cell_data and NETGEN in mesh.cell_data and any(
            map(is_group, mesh.field_data.values())):
        mesh.cell_data[PHYSICAL] = mesh.cell_data.pop(NETGEN)
    found = {key: numbers for key, values in mesh.cell_data.items()
             if (numbers := numbers_of(key, values)) and are_tags(numbers)}
    own = [key for key in TAGS if key in found]
    own += sorted((key for key in found if is_known(key) and are_groups(mesh, found[key])),
                  key=lambda key: are_one(found[key]))
    if PHYSICAL not in mesh.cell_data and own:
        mesh.cell_data[PHYSICAL] = found[own[0]]
    if PHYSICAL not in mesh.cell_data:
        mesh.cell_data[PHYSICAL] = [np.zeros(len(block.data), dtype=np.int32)
                                    for block in mesh.cells]
    mesh.cell_data[PHYSICAL] = within(mesh, mesh.cell_data[PHYSICAL], name)
    if ENTITY in mesh.cell_data and not are_within(mesh.cell_data[ENTITY], name):
        names = mesh.field_data
        mesh.cell_data[ENTITY] = within(mesh, mesh.cell_data[ENTITY], name)
        mesh.field_data = names
        mesh.point_data.pop(BOOKKEEPING[0], None)
        mesh.cell_sets.pop(BOOKKEEPING[1], None)
    if ENTITY not in mesh.cell_data:
        mesh.cell_data[ENTITY] = _entities(mesh)
    mesh.point_data = {key: values for key, values in mesh.point_data.items()
                       if key in BOOKKEEPING or _width(values) in WIDTHS}
    mesh.cell_data = {key: values for key, values in mesh.cell_data.items()
                      if {*map(_width, values)} <= {*WIDTHS}}
    if name == "gmsh22":
        mesh.point_data.pop(BOOKKEEPING[0], None)
    mesh.field_data = {key: value for key, value in mesh.field_data.items() if is_group(value)}
    return mesh


def _width(values: Any) -> int:
    """Numbers of each point or cell."""
    return int(np.prod(np.shape(values)[1:]))


def _entities(mesh: Any) -> list[NDArray[np.int32]]:
    """An entity for each group of cells of each dimension, since Gmsh groups whole entities."""
    groups = [np.asarray(values).ravel() for values in mesh.cell_data[PHYSICAL]]
    out = [np.ones(len(values), dtype=np.int32) for values in groups]
    for dim in {block.dim for block in mesh.cells}:
        own = [i for i, block in enumerate(mesh.cells) if block.dim == dim]
        known = np.unique(np.concatenate([groups[i] for i in own]))
        for i in own:
            out[i] = np.searchsorted(known, groups[i]).astype(np.int32) + 1
    return out
