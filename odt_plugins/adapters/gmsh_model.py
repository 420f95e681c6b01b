"""gmsh.model, the current model of Gmsh in memory: its nodes and elements are replaced in place.

This is the one object that changes: there is only one model of that name. It changes when all is
done and checked; if Gmsh refuses something it gets back what it had.

Everything survives: entities and their geometry, which node and element is classified on which,
physical groups, names, attributes, tags of nodes, tags of elements that are still there, parametric
coordinates (computed anew where a node moved on a curve or surface), periodic links, elements of
lower dimension and other linear ones. New elements and mid-nodes take tags that became free, then
those above all others, inserted nodes only such. Elements of different entities never mix.
Vertices of a face or curve that slide or come do so on the geometry itself, not on its triangles;
faces and curves whose vertices came or went get other elements, in the same entities.
Triangles and tetrahedra of higher order are optimised by their corners, see
:mod:`odt_plugins.adapters.higher_order`. Views of
post-processing stay as they are, and so do periodic curves and surfaces. Partitioned meshes and
other elements of higher order are refused by name, and what would break periodic links.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.gmsh_parts import (
    Elements,
    Entity,
    IntArray,
    Kind,
    Part,
    Rows,
    chosen_kind,
    closest_on,
    kinds_of,
    parts_of,
)
from odt_plugins.adapters.higher_order import HigherOrder, check_mid_nodes, lattice, with_mid_nodes
from odt_plugins.adapters.host import (
    Geometry,
    HostMesh,
    KeptCells,
    Result,
    each_once,
    middles,
    of_other_shape,
)
from odt_plugins.adapters.regions import AUTO, region_labels
from odt_plugins.errors import UnsupportedMeshError
from odt_plugins.mesh.faces import Faces, labels_at

WITHOUT_GEOMETRY = ("Discrete curve", "Discrete surface", "Unknown")
"""Types of entities that are nothing but their mesh."""


class Layout(NamedTuple):
    """What :func:`write` needs to know of the model.

    Attributes
    ----------
    parts : dict                   mesh of every entity
    number : int                   of the type of elements that are optimised
    kind : Kind                    that type
    entity : (n,) int              which of the parts every node belongs to
    tags : (n,) int                of all nodes
    cells : Rows                   the optimised elements
    faces : dict                   lines and triangles beside these, by the numbers of their types
    """

    parts: dict[Entity, Part]
    number: int
    kind: Kind
    entity: IntArray
    tags: IntArray
    cells: Rows
    faces: dict[int, Rows]


def matches(mesh: object) -> bool:
    """Say whether this is `gmsh.model`, which is a class."""
    return isinstance(mesh, type) and (mesh.__module__, mesh.__qualname__) == ("gmsh", "model")


def read(mesh: Any, regions: str | Sequence[str] | None = None) -> HostMesh:
    """Take the tetrahedra, or the triangles if there are none, out of all entities.

    Parameters
    ----------
    mesh : gmsh.model
    regions : "auto" or None    elements of different entities never mix in any case

    Raises
    ------
    UnsupportedMeshError       no tetrahedra and no triangles, or elements that cannot be kept
    InvalidMeshError           Gmsh is not initialised, or the model has no elements
    InvalidOptionError         regions are named
    """
    parts = parts_of(mesh)
    kinds = kinds_of(mesh, parts)
    number = chosen_kind(mesh, kinds)
    kind = kinds[number]
    tags = np.concatenate([part.tags for part in parts.values()]).astype(np.int64)
    order = np.argsort(tags)

    def places_of(nodes: NDArray[Any]) -> IntArray:
        return order[np.searchsorted(tags, nodes, sorter=order)]

    ids: dict[int, list[IntArray]] = {}
    kept: list[KeptCells] = []
    found: dict[int, list[Rows]] = {number: []}
    total = 0
    for i, part in enumerate(parts.values()):
        for elements in part.elements:
            rows, other = places_of(elements.nodes), kinds[elements.number]
            own = Rows(elements.tags.astype(np.int64), rows, np.full(len(rows), i))
            ids.setdefault(elements.number, []).append(total + np.arange(len(rows)))
            if elements.number == number:
                found[number].append(own)
            elif other.is_simplex and 0 < other.dim < kind.dim:
                found.setdefault(elements.number, []).append(own)
            elif other.dim == 0:
                kept.append(KeptCells(other.name, rows.reshape(-1, 1)))
            elif not other.is_simplex:
                kept.append(of_other_shape(other.name, rows, np.full(len(rows), rows.shape[1])))
            total += len(rows)
    entity = np.repeat(np.arange(len(parts)), [len(part.tags) for part in parts.values()])
    every = {one: Rows(np.concatenate([rows.tags for rows in several]),
                       np.concatenate([rows.nodes for rows in several]),
                       np.concatenate([rows.part for rows in several]))
             for one, several in found.items()}
    cells = every.pop(number)
    for one, whole in every.items():
        own_ids = np.concatenate(ids[one])
        groups = each_once(KeptCells(
            kinds[one].name, whole.nodes[:, : kinds[one].corners], whole.part, ids=own_ids))
        every[one] = whole._replace(kept=tuple(
            (len(kept) + i, chosen) for i, (_, chosen) in enumerate(groups)))
        kept += [part for part, _ in groups]
    bare = _bare(parts, entity, [*every.values(), cells])
    kept += [KeptCells("edge of a curve", bare)] if len(bare) else []
    nodes, where = cells.nodes, cells.part
    shape = lattice(kind.dim, kind.order, "gmsh")
    if kind.order > 1:
        check_mid_nodes(nodes, len(tags), shape)
    kept.append(KeptCells("node", _apart(parts, entity, kind.dim, kept, nodes)))
    if regions not in (AUTO, None):
        region_labels({}, regions, nodes)
    several = len(np.unique(where)) > 1
    labels = np.array([tag for _, tag in parts])[where]
    coupled = _coupled(mesh, parts, places_of)
    return HostMesh(
        points=np.concatenate([part.places for part in parts.values()]),
        cells=nodes[:, : kind.corners],
        regions=labels if several else None,
        regions_from=("entities",) if several else (),
        blocks=where if several else None,
        kept=tuple(kept),
        source=mesh,
        layout=Layout(parts, number, kind, entity, tags, cells, every),
        coupled=coupled,
        linked=coupled is not None,
        higher_order=kind.order > 1,
        nodes=nodes if kind.order > 1 else None,
        shape=shape if kind.order > 1 else None,
        whole=True,
        settle=partial(_settled, mesh),
        geometry=_geometry(mesh, parts, entity, tags, where),
        ids=np.concatenate(ids[number]),
        total=total,
        words=in_words,
    )


def write(result: Result, host: HostMesh) -> Any:
    """Exchange nodes and elements of the model, all of them or none.

    Raises
    ------
    UnsupportedMeshError    nodes of periodic surfaces moved
    Exception               what Gmsh raises; the model is then as it was before
    """
    model, layout = host.source, host.layout
    if np.array_equal(result.points, host.points) and np.array_equal(result.cells, host.cells):
        return model
    new = _new_parts(model, result, host)
    _expect_links_kept(model, layout.parts, new)
    try:
        _fill(model, layout.kind.dim, layout.parts, new)
    except BaseException:
        _fill(model, layout.kind.dim, new, layout.parts)
        raise
    return model


def in_words(text: str) -> str:
    """Put an error message into Gmsh's words."""
    text = text.replace("merging vertices at the same place",
                        "gmsh.model.mesh.removeDuplicateNodes()")
    return re.sub(r"\bcell(s?)\b", r"element\1", text)


def _apart(
    parts: dict[Entity, Part], entity: IntArray, dim: int, kept: list[KeptCells], nodes: IntArray
) -> IntArray:
    """Nodes (q, 1) of points, curves and surfaces of the elements that no element there holds."""
    low = np.array([d for d, _ in parts])[entity]
    held = np.zeros(len(entity), dtype=np.bool_)
    for part in kept:
        if part.rows.shape[1] > 1:
            held[part.rows] = True
    used = np.zeros(len(entity), dtype=np.bool_)
    used[nodes[:, : dim + 1]] = True
    return np.flatnonzero(used & ((low == 0) | ((low < dim) & ~held)))[:, None]


def _bare(parts: dict[Entity, Part], entity: IntArray, several: list[Rows]) -> IntArray:
    """Edges (q, 2) of triangles on curves whose lines the model does not hold."""
    low = np.array([d for d, _ in parts])[entity]
    ends: list[IntArray] = [np.zeros((0, 2), dtype=np.int64)]
    owner, lines = [np.zeros(0, dtype=np.int64)], [np.zeros((0, 2), dtype=np.int64)]
    dims = np.array([d for d, _ in parts])
    for rows in several:
        dim = int(dims[rows.part].max(initial=0))
        if dim == 1:
            lines.append(rows.nodes[:, :2])
        for pair in ((0, 1), (1, 2), (2, 0)) if dim == 2 else ():
            both = rows.nodes[:, pair]
            on = (low[both] < 2).all(axis=1)
            ends.append(both[on])
            owner.append(rows.part[on])
    edges, first, inverse, count = np.unique(
        np.sort(np.concatenate(ends), axis=1), axis=0, return_index=True, return_inverse=True,
        return_counts=True)
    of = np.concatenate(owner)
    several_parts = np.zeros(len(edges), dtype=np.bool_)
    several_parts[inverse.ravel()[of != of[first][inverse.ravel()]]] = True
    known = Faces(np.concatenate(lines).astype(np.int32),
                  np.zeros(sum(map(len, lines)), dtype=np.int32))
    bare: IntArray = edges[((count != 2) | several_parts) & (labels_at(edges, known) < 0)]
    return bare


def _geometry(
    model: Any, parts: dict[Entity, Part], entity: IntArray, tags: IntArray, where: IntArray
) -> Geometry | None:
    """The faces and curves of the model, by the places of their parts, unless all are discrete."""
    keys = list(parts)
    shaped = _shaped(model, parts)
    if not any(keys[i][0] == 2 for i in shaped):
        return None

    def sag() -> float:
        most = 0.0
        places = np.concatenate([part.places for part in parts.values()])
        order = np.argsort(tags)
        for i in shaped:
            for elements in parts[keys[i]].elements:
                rows = elements.nodes[:, : keys[i][0] + 1]
                middle = middles(places[order[np.searchsorted(tags, rows, sorter=order)]])
                middle = np.unique(middle, axis=0)
                there = _put_on(model, parts, np.full(len(middle), i), middle)
                most = max(most, float(np.linalg.norm(there - middle, axis=1).max()))
        return most

    curves = [i for i in range(len(keys)) if keys[i][0] == 1]
    return Geometry(partial(_put_on, model, parts), sag, entity,
                    np.flatnonzero(np.isin(entity, curves)), where)


def _shaped(model: Any, parts: dict[Entity, Part]) -> list[int]:
    """Which of the entities are curves and faces that are more than their mesh.

    Discrete ones are where Gmsh has found a parametrisation of them (`createGeometry`).
    """
    return [i for i, (key, part) in enumerate(parts.items()) if key[0] in (1, 2) and (
        part.parameters.size or model.getType(*key) not in WITHOUT_GEOMETRY)]


def _put_on(
    model: Any, parts: dict[Entity, Part], of: IntArray, places: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Places (k, 3) nearest to given ones on entities `of` (k,), where these are shaped."""
    out, keys, shaped = places.copy(), list(parts), _shaped(model, parts)
    for i in np.intersect1d(of, shaped).tolist():
        around = set(model.getBoundary([keys[i]], combined=False, oriented=False))
        rim = [keys[k] for k in shaped if keys[k] in around]
        out[of == i] = closest_on(model, keys[i], rim, parts, places[of == i])
    return out


def _new_parts(model: Any, result: Result, host: HostMesh) -> dict[Entity, Part]:
    """The mesh of every entity after optimisation."""
    layout = host.layout
    if host.higher_order and result.cells.shape[1] == host.cells.shape[1]:
        others = [np.concatenate([elements.nodes.ravel() for part in layout.parts.values()
                                  for elements in part.elements
                                  if elements.number != layout.number] or [np.zeros(0, int)])]
        order = np.argsort(layout.tags)
        kept = order[np.searchsorted(layout.tags, np.unique(others[0]), sorter=order)]
        shape = lattice(layout.kind.dim, layout.kind.order, "gmsh")
        q = with_mid_nodes(result, host.points, layout.cells.nodes, kept, shape)
        q = _settled(model, host, q, result.source)
        points, cells, origin = q.points, q.cells.astype(np.int64), q.origin
    else:
        points, cells = result.points, result.cells.astype(np.int64)
        origin = np.arange(len(points)) if result.vertices is None else result.vertices.origin
    now = {layout.number: Rows(layout.cells.tags[result.source], cells,
                               layout.cells.part[result.source])}
    if result.faces:
        now |= {one: _followed(result, old) for one, old in layout.faces.items()}
    entity = _entities(host, origin, now)
    fresh = origin < 0
    tags = layout.tags[origin]
    free = np.setdiff1d(layout.tags, tags[~fresh]) if host.higher_order else np.zeros(0, np.int64)
    tags[fresh] = _tags(free, int(model.mesh.getMaxNodeTag()), int(fresh.sum()))
    last = int(model.mesh.getMaxElementTag())
    for number, rows in now.items():
        old = layout.faces.get(number, layout.cells)
        corners = layout.kind.corners if number == layout.number else rows.nodes.shape[1]
        now[number] = rows._replace(tags=_element_tags(old, rows, origin, corners, last))
        last = max(last, int(now[number].tags.max(initial=0)))
    out, shaped = {}, _shaped(model, layout.parts)
    for i, (key, part) in enumerate(layout.parts.items()):
        mine = np.flatnonzero(entity == i)
        elements = [_on_entity(i, e, now.get(e.number), tags) for e in part.elements]
        moved = fresh[mine] | (points[mine] != host.points[origin[mine]]).any(axis=1)
        first = int(np.flatnonzero(layout.entity == i)[0]) if len(part.tags) else 0
        parameters = _parameters(model, key, part, points[mine],
                                 np.where(moved, -1, origin[mine] - first), shaped=i in shaped)
        out[key] = Part(tags[mine], points[mine], parameters, elements)
    return out


def _followed(result: Result, old: Rows) -> Rows:
    """What lines or triangles have become, with the tags of those they come from."""
    new = [result.faces_of(number, old.nodes[chosen]) for number, chosen in old.kept]
    source = np.concatenate([chosen[faces.source] for faces, (_, chosen)
                             in zip(new, old.kept, strict=True)])
    order = np.argsort(source, kind="stable")
    nodes = np.concatenate([faces.rows for faces in new])[order]
    return Rows(old.tags[source[order]], nodes, old.part[source[order]])


def _entities(host: HostMesh, origin: IntArray, now: dict[int, Rows]) -> IntArray:
    """Entity of every node (n',); a new node is on the entity of lowest dimension around it."""
    entity: IntArray = host.layout.entity[origin]
    for rows in sorted(now.values(), key=lambda rows: -rows.nodes.shape[1]):
        inside = (origin < 0)[rows.nodes]
        entity[rows.nodes[inside]] = np.broadcast_to(rows.part[:, None], inside.shape)[inside]
    return entity


def _on_entity(i: int, old: Elements, now: Rows | None, tags: IntArray) -> Elements:
    """Elements of one type on an entity after the run; the old ones where none changed."""
    if now is None:
        return old
    own = now.part == i
    return Elements(old.number, now.tags[own], tags[now.nodes[own]])


def _settled(model: Any, host: HostMesh, q: HigherOrder, source: NDArray[Any]) -> HigherOrder:
    """The same with nodes between the corners on the geometry, where they moved or are new."""
    layout, points, cells = host.layout, q.points.copy(), q.cells.astype(np.int64)
    rows = Rows(layout.cells.tags[source], cells, layout.cells.part[source])
    entity = _entities(host, q.origin, {layout.number: rows})
    between = (q.origin < 0) | (points != host.points[q.origin]).any(axis=1)
    between[cells[:, : layout.kind.corners]] = False
    points[between] = _put_on(model, layout.parts, entity[between], points[between])
    return replace(q, points=points)


def _tags(free: IntArray, last: int, count: int) -> IntArray:
    """Tags for `count` new nodes or elements: first the free ones, then those after the last."""
    more = last + 1 + np.arange(max(count - len(free), 0))
    return np.concatenate([np.sort(free)[:count], more])


def _element_tags(old: Rows, now: Rows, origin: IntArray, corners: int, last: int) -> IntArray:
    """Tags (m',) of elements of one type; elements with the corners of their source keep its."""
    order = np.argsort(old.tags)
    source = order[np.searchsorted(old.tags, now.tags, sorter=order)]
    same = (np.sort(origin[now.nodes[:, :corners]], axis=1)
            == np.sort(old.nodes[source, :corners], axis=1)).all(axis=1)
    tags = now.tags.copy()
    tags[~same] = _tags(np.setdiff1d(old.tags, tags[same]), last, int((~same).sum()))
    return tags


def _parameters(
    model: Any, entity: Entity, part: Part, places: NDArray[Any], origin: IntArray, *, shaped: bool
) -> NDArray[np.float64]:
    """Parametric coordinates (n', d) of nodes on an entity, anew where `origin` is negative."""
    width = part.parameters.shape[1] if len(part.tags) else entity[0] * shaped
    if not (width and len(places)):
        return np.zeros((len(places), width))
    out = np.full((len(places), width), np.nan)
    if len(part.tags):
        out[origin >= 0] = part.parameters[origin[origin >= 0]]
    anew = np.isnan(out).any(axis=1)
    if anew.any():
        # The parameters that getClosestPoint gives on curves are no numbers of theirs.
        found = (model.getParametrization(*entity, places[anew].ravel()) if entity[0] == 1 else
                 model.getClosestPoint(*entity, places[anew].ravel())[1])
        out[anew] = np.asarray(found).reshape(-1, width)
    return out


def _links(model: Any, parts: dict[Entity, Part]) -> Iterator[tuple[int, int, int]]:
    """Dimension, tag and tag of the master of periodic curves and surfaces."""
    for dim in (1, 2):
        tags = [tag for d, tag in parts if d == dim]
        masters = model.mesh.getPeriodic(dim, tags) if tags else []
        yield from ((dim, tag, int(master)) for tag, master in zip(tags, masters, strict=True)
                    if tag != master)


def _coupled(
    model: Any, parts: dict[Entity, Part], places_of: Callable[[NDArray[Any]], IntArray]
) -> IntArray | None:
    """Nodes on periodic curves and surfaces, if there are any."""
    nodes = [places_of(elements.nodes).ravel() for dim, tag, master in _links(model, parts)
             for one in (tag, master) for elements in parts[dim, one].elements]
    return np.unique(np.concatenate(nodes)) if nodes else None


def _expect_links_kept(model: Any, old: dict[Entity, Part], new: dict[Entity, Part]) -> None:
    """Refuse a result in which nodes of periodic curves or surfaces are elsewhere."""
    for dim, tag, master in _links(model, old):
        for one in (tag, master):
            before, after = old[dim, one], new[dim, one]
            if not (np.array_equal(before.tags, after.tags)
                    and np.array_equal(before.places, after.places)):
                kind = ("curve", "surface")[dim - 1]
                msg = (f"got periodic {kind}s ({kind} {tag} and its master {master}) whose "
                       f"nodes would no longer correspond; expected none that move, try "
                       f"leaving 'periodic' out of free")
                raise UnsupportedMeshError(msg)


def _fill(model: Any, dim: int, old: dict[Entity, Part], new: dict[Entity, Part]) -> None:
    """Give entities of a dimension, and others whose elements changed, their new mesh.

    Nodes of all other entities get their new places.
    """
    anew = _anew(dim, old, new)
    for key in anew:
        model.mesh.clear([key])
    for key, part in new.items():
        if key in anew:
            model.mesh.addNodes(*key, part.tags, part.places.ravel(), part.parameters.ravel())
            continue
        moved = (part.places != old[key].places).any(axis=1)
        for i in np.flatnonzero(moved):
            model.mesh.setNode(part.tags[i], part.places[i], part.parameters[i])
    for key, part in new.items():
        for elements in part.elements if key in anew else ():
            model.mesh.addElementsByType(key[1], elements.number, elements.tags,
                                         elements.nodes.ravel())


def _anew(dim: int, old: dict[Entity, Part], new: dict[Entity, Part]) -> list[Entity]:
    """Entities to clear: those of a dimension, changed ones, and whose elements have their nodes.

    Gmsh deletes the nodes of an entity that is cleared, of whichever elements they are.
    """
    owner = np.repeat(np.arange(len(old)), [len(part.tags) for part in old.values()])
    tags = np.concatenate([part.tags for part in old.values()])
    order = np.argsort(tags)
    keys = list(old)
    tags, owner = tags[order], owner[order]
    under = {key: {keys[i] for elements in part.elements for i in np.unique(
        owner.take(np.searchsorted(tags, elements.nodes.ravel()), mode="clip"))}
        for key, part in old.items()}
    anew = {key for key in old if key[0] == dim or not _alike(old[key], new[key])}
    count = 0
    while count < len(anew):
        count = len(anew)
        anew |= {key for key in old if under[key] & anew}
    return sorted(anew, reverse=True)


def _alike(one: Part, other: Part) -> bool:
    """Whether two meshes of an entity have the same nodes and elements."""
    return np.array_equal(one.tags, other.tags) and all(
        np.array_equal(a.tags, b.tags) and np.array_equal(a.nodes, b.nodes)
        for a, b in zip(one.elements, other.elements, strict=True))
