"""gmsh.model, the current model of Gmsh in memory: its nodes and elements are replaced in place.

This is the one object that changes: there is only one model of that name. It changes when all is
done and checked; if Gmsh refuses something it gets back what it had.

Everything survives: entities and their geometry, which node and element is classified on which,
physical groups, names, attributes, tags of nodes, tags of elements that are still there, parametric
coordinates (computed anew where a node moved on a curve or surface), periodic links, elements of
lower dimension and other linear ones. New elements and mid-nodes take tags that became free, then
those above all others, inserted nodes only such. Elements of different entities never mix.
Vertices of a face or curve that slide do so on the geometry itself, not on its triangles.
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

from odt_plugins.adapters.higher_order import (
    HigherOrder,
    check_mid_nodes,
    lattice,
    with_mid_nodes,
)
from odt_plugins.adapters.host import Geometry, HostMesh, KeptCells, Result
from odt_plugins.adapters.regions import AUTO, region_labels
from odt_plugins.errors import InvalidMeshError, UnsupportedMeshError, counted

Entity = tuple[int, int]
"""Dimension and tag."""

IntArray = NDArray[np.int64]

WITHOUT_GEOMETRY = ("Discrete curve", "Discrete surface", "Unknown")
"""Types of entities that are nothing but their mesh."""


class Kind(NamedTuple):
    """A type of elements: its name, dimension, order, number of nodes, and that of corners."""

    name: str
    dim: int
    order: int
    nodes: int
    corners: int

    @property
    def is_simplex(self) -> bool:
        """Whether these are points, lines, triangles or tetrahedra with all their nodes."""
        full = self.corners == self.dim + 1
        return full and (self.dim == 0
                         or self.nodes == len(lattice(self.dim, self.order, "gmsh")))


class Elements(NamedTuple):
    """The elements of one type on one entity: number of the type, tags (m,), nodes (m, k)."""

    number: int
    tags: NDArray[Any]
    nodes: NDArray[Any]


class Part(NamedTuple):
    """The mesh of one entity: tags (n,), places (n, 3) and parameters (n, d) of its own nodes.

    Where it has no parametrisation d is 0; a node without parameters on one that has has NaN.
    """

    tags: NDArray[Any]
    places: NDArray[np.float64]
    parameters: NDArray[np.float64]
    elements: list[Elements]


class Layout(NamedTuple):
    """What :func:`write` needs to know of the model.

    Attributes
    ----------
    parts : dict                   mesh of every entity
    number : int                   of the type of elements that are optimised
    kind : Kind                    that type
    entity : (n,) int              which of the parts every node belongs to
    tags : (n,) int                of all nodes
    nodes : (m, k) int             nodes of the optimised elements, places among all nodes
    """

    parts: dict[Entity, Part]
    number: int
    kind: Kind
    entity: IntArray
    tags: IntArray
    nodes: IntArray


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
    parts = _parts(mesh)
    kinds = _kinds(mesh, parts)
    number = _chosen(mesh, kinds)
    kind = kinds[number]
    tags = np.concatenate([part.tags for part in parts.values()]).astype(np.int64)
    order = np.argsort(tags)

    def places_of(nodes: NDArray[Any]) -> IntArray:
        return order[np.searchsorted(tags, nodes, sorter=order)]

    cells: list[IntArray] = []
    blocks: list[IntArray] = []
    ids: list[IntArray] = []
    kept: list[KeptCells] = []
    total = 0
    for i, part in enumerate(parts.values()):
        for elements in part.elements:
            rows, other = places_of(elements.nodes), kinds[elements.number]
            if elements.number == number:
                cells.append(rows)
                blocks.append(np.full(len(rows), i))
                ids.append(total + np.arange(len(rows)))
            elif other.is_simplex and 0 < other.dim < kind.dim:
                kept.append(KeptCells(other.name, rows[:, : other.corners]))
            elif other.dim == 0 or not other.is_simplex:
                kept.append(KeptCells(other.name, rows.reshape(-1, 1)))
            total += len(rows)
    entity = np.repeat(np.arange(len(parts)), [len(part.tags) for part in parts.values()])
    nodes, where = np.concatenate(cells), np.concatenate(blocks)
    shape = lattice(kind.dim, kind.order, "gmsh")
    if kind.order > 1:
        check_mid_nodes(nodes, len(tags), shape)
    kept.append(KeptCells("node", _apart(parts, entity, kind.dim, kept, nodes)))
    if regions not in (AUTO, None):
        region_labels({}, regions, nodes)
    several = len(np.unique(where)) > 1
    own = np.array([tag for _, tag in parts])[where]
    return HostMesh(
        points=np.concatenate([part.places for part in parts.values()]),
        cells=nodes[:, : kind.corners],
        regions=own if several else None,
        regions_from=("entities",) if several else (),
        blocks=where if several else None,
        kept=tuple(kept),
        source=mesh,
        layout=Layout(parts, number, kind, entity, tags, nodes),
        coupled=_coupled(mesh, parts, places_of),
        higher_order=kind.order > 1,
        nodes=nodes if kind.order > 1 else None,
        shape=shape if kind.order > 1 else None,
        settle=partial(_settled, mesh),
        geometry=_geometry(mesh, parts, entity, tags),
        ids=np.concatenate(ids),
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


def _parts(model: Any) -> dict[Entity, Part]:
    """The mesh of every entity.

    Raises
    ------
    InvalidMeshError        Gmsh is not initialised
    UnsupportedMeshError    the mesh is partitioned
    """
    import gmsh

    if not gmsh.isInitialized():
        msg = "Gmsh has no elements, since it is not initialised; try gmsh.initialize() first"
        raise InvalidMeshError(msg)
    count = model.getNumberOfPartitions()
    if count:
        msg = (f"got a model of {counted(count, 'partition')}; expected one that is not "
               f"partitioned, try gmsh.model.mesh.unpartition()")
        raise UnsupportedMeshError(msg)
    parts = {}
    for entity in model.getEntities():
        tags, flat, parameters = model.mesh.getNodes(*entity)
        elements = [Elements(int(number), own, nodes.reshape(len(own), -1)) for number, own, nodes
                    in zip(*model.mesh.getElements(*entity), strict=True)]
        width = entity[0] if len(parameters) else 0
        if len(parameters) == width * len(tags):
            own = parameters.reshape(len(tags), width)
        else:
            # Gmsh tells those of the nodes that have some, as if there were no others.
            each = [model.mesh.getNode(tag)[1] for tag in tags]
            own = np.array([found if len(found) else np.full(width, np.nan) for found in each])
        parts[entity] = Part(tags, flat.reshape(-1, 3), own, elements)
    return parts


def _kinds(model: Any, parts: dict[Entity, Part]) -> dict[int, Kind]:
    numbers = {elements.number for part in parts.values() for elements in part.elements}
    out = {}
    for number in sorted(numbers):
        name, dim, order, nodes, _, corners = model.mesh.getElementProperties(number)
        out[number] = Kind(name, dim, order, nodes, corners)
    return out


def _chosen(model: Any, kinds: dict[int, Kind]) -> int:
    """Number of the type of the elements to optimise.

    Raises
    ------
    InvalidMeshError        there are no elements
    UnsupportedMeshError    there are none of that kind, or others that cannot be kept
    """
    most = max((kind.dim for kind in kinds.values()), default=0)
    if most < 2:
        msg = (f"the model {model.getCurrent()!r} has no elements of surfaces or volumes; expected "
               f"tetrahedra or triangles, try gmsh.model.mesh.generate()")
        raise InvalidMeshError(msg)
    found = [number for number, kind in kinds.items() if kind.dim == most and kind.is_simplex]
    if not found:
        names = ", ".join(kind.name for kind in kinds.values() if kind.dim == most)
        msg = f"got elements of type {names}; expected tetrahedra, or triangles without volumes"
        raise UnsupportedMeshError(msg)
    order = kinds[found[0]].order
    for kind in kinds.values():
        fits = kind.order == order if kind.is_simplex and kind.dim else kind.order <= 1
        if not fits:
            msg = (f"got elements of type {kind.name} beside {kinds[found[0]].name}; expected "
                   f"others to be linear, try gmsh.model.mesh.setOrder(1)")
            raise UnsupportedMeshError(msg)
    return found[0]


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


def _geometry(
    model: Any, parts: dict[Entity, Part], entity: IntArray, tags: IntArray
) -> Geometry | None:
    """The faces and curves of the model, unless all are discrete."""
    keys = list(parts)
    shaped = _shaped(model, parts)
    if not any(keys[i][0] == 2 for i in shaped):
        return None

    def closest(vertices: NDArray[Any], places: NDArray[np.float64]) -> NDArray[np.float64]:
        return _put_on(model, parts, np.where(vertices < 0, -1, entity[vertices]), places)

    def sag() -> float:
        most = 0.0
        where = np.concatenate([part.places for part in parts.values()])
        order = np.argsort(tags)
        for i in shaped:
            for elements in parts[keys[i]].elements if keys[i][0] == 2 else ():
                corners = order[np.searchsorted(tags, elements.nodes[:, :3], sorter=order)]
                x = where[corners]
                middle = np.concatenate([x.mean(axis=1), *(
                    0.5 * (x[:, a] + x[:, b]) for a, b in ((0, 1), (1, 2), (2, 0)))])
                there = _put_on(model, parts, np.full(len(middle), i), middle)
                most = max(most, float(np.linalg.norm(there - middle, axis=1).max()))
        return most

    curves = [i for i in range(len(keys)) if keys[i][0] == 1]
    return Geometry(closest, sag, np.flatnonzero(np.isin(entity, curves)))


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
    out, keys = places.copy(), list(parts)
    for i in np.intersect1d(of, _shaped(model, parts)).tolist():
        found = model.getClosestPoint(*keys[i], places[of == i].ravel())[0]
        out[of == i] = np.asarray(found).reshape(-1, 3)
    return out


def _new_parts(model: Any, result: Result, host: HostMesh) -> dict[Entity, Part]:
    """The mesh of every entity after optimisation."""
    layout = host.layout
    if host.higher_order:
        others = [np.concatenate([elements.nodes.ravel() for part in layout.parts.values()
                                  for elements in part.elements
                                  if elements.number != layout.number] or [np.zeros(0, int)])]
        order = np.argsort(layout.tags)
        kept = order[np.searchsorted(layout.tags, np.unique(others[0]), sorter=order)]
        shape = lattice(layout.kind.dim, layout.kind.order, "gmsh")
        q = with_mid_nodes(result, host.points, layout.nodes, kept, shape)
        q = _settled(model, host, q, result.source)
        points, cells, origin = q.points, q.cells.astype(np.int64), q.origin
    else:
        points, cells = result.points, result.cells.astype(np.int64)
        origin = np.arange(len(points)) if result.vertices is None else result.vertices.origin
    entity, block = _entities(host, cells, origin, result.source)
    fresh = origin < 0
    tags = layout.tags[origin]
    free = np.setdiff1d(layout.tags, tags[~fresh]) if host.higher_order else np.zeros(0, np.int64)
    tags[fresh] = _tags(free, int(model.mesh.getMaxNodeTag()), int(fresh.sum()))
    own = _element_tags(model, result.source, cells, origin, layout)
    out = {}
    for i, (key, part) in enumerate(layout.parts.items()):
        mine = np.flatnonzero(entity == i)
        elements = [Elements(e.number, own[block == i], tags[cells[block == i]])
                    if e.number == layout.number else e for e in part.elements]
        moved = fresh[mine] | (points[mine] != host.points[origin[mine]]).any(axis=1)
        first = int(np.flatnonzero(layout.entity == i)[0]) if len(part.tags) else 0
        parameters = _parameters(model, key, part, points[mine],
                                 np.where(moved, -1, origin[mine] - first))
        out[key] = Part(tags[mine], points[mine], parameters, elements)
    return out


def _entities(
    host: HostMesh, cells: IntArray, origin: IntArray, source: NDArray[Any]
) -> tuple[IntArray, IntArray]:
    """Entity of every node (n',) and of every cell (m',)."""
    layout = host.layout
    block = host.blocks[source] if host.blocks is not None else np.full(
        len(cells), next(i for i, part in enumerate(layout.parts.values())
                         if any(e.number == layout.number for e in part.elements)))
    entity = layout.entity[origin]
    inside = (origin < 0)[cells]
    entity[cells[inside]] = np.broadcast_to(block[:, None], cells.shape)[inside]
    return entity, block


def _settled(model: Any, host: HostMesh, q: HigherOrder, source: NDArray[Any]) -> HigherOrder:
    """The same with nodes between the corners on the geometry, where they moved or are new."""
    layout, points, cells = host.layout, q.points.copy(), q.cells.astype(np.int64)
    entity, _ = _entities(host, cells, q.origin, source)
    between = (q.origin < 0) | (points != host.points[q.origin]).any(axis=1)
    between[cells[:, : layout.kind.corners]] = False
    points[between] = _put_on(model, layout.parts, entity[between], points[between])
    return replace(q, points=points)


def _tags(free: IntArray, last: int, count: int) -> IntArray:
    """Tags for new nodes or elements: those that became free, then those above all others."""
    more = last + 1 + np.arange(max(count - len(free), 0))
    return np.concatenate([np.sort(free)[:count], more])


def _element_tags(
    model: Any, source: NDArray[Any], cells: IntArray, origin: IntArray, layout: Layout
) -> IntArray:
    """Tags (m',) of the optimised elements; those with the corners of their source keep its own."""
    old = np.concatenate([e.tags for part in layout.parts.values() for e in part.elements
                          if e.number == layout.number]).astype(np.int64)
    corners = layout.kind.corners
    same = (np.sort(origin[cells[:, :corners]], axis=1)
            == np.sort(layout.nodes[source, :corners], axis=1)).all(axis=1)
    tags: IntArray = old[source]
    free = np.setdiff1d(old, tags[same])
    tags[~same] = _tags(free, int(model.mesh.getMaxElementTag()), int((~same).sum()))
    return tags


def _parameters(
    model: Any, entity: Entity, part: Part, places: NDArray[Any], origin: IntArray
) -> NDArray[np.float64]:
    """Parametric coordinates (n', d) of nodes on an entity, anew where `origin` is negative."""
    width = part.parameters.shape[1] if len(part.tags) else 0
    if not width:
        return np.zeros((len(places), 0))
    out: NDArray[np.float64] = part.parameters[origin].copy()
    anew = (origin < 0) | np.isnan(out).any(axis=1)
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


def _expect_links_kept(
    model: Any, old: dict[Entity, Part], new: dict[Entity, Part]
) -> None:
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
    """Give the entities of a dimension their new mesh, and nodes of others their new places."""
    model.mesh.clear([key for key in old if key[0] == dim])
    for key, part in new.items():
        if key[0] == dim:
            model.mesh.addNodes(*key, part.tags, part.places.ravel(), part.parameters.ravel())
            continue
        moved = (part.places != old[key].places).any(axis=1)
        for i in np.flatnonzero(moved):
            model.mesh.setNode(part.tags[i], part.places[i], part.parameters[i])
    for key, part in new.items():
        for elements in part.elements if key[0] == dim else ():
            model.mesh.addElementsByType(key[1], elements.number, elements.tags,
                                         elements.nodes.ravel())
