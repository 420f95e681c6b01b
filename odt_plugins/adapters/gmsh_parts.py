"""The mesh of every entity of a model of Gmsh, as Gmsh gives it."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.higher_order import lattice
from odt_plugins.errors import InvalidMeshError, UnsupportedMeshError, counted

Entity = tuple[int, int]
"""Dimension and tag."""

IntArray = NDArray[np.int64]

FAR = 1e-9
"""Distance, as a part of a face, by which what is further than a node is not the nearest place."""


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
        return full and (self.dim == 0 or self.nodes == len(lattice(self.dim, self.order, "gmsh")))


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


class Rows(NamedTuple):
    """The elements of one type on all entities.

    Attributes
    ----------
    tags : (q,) int      of all, one entity after the other
    nodes : (q, k) int   places among all nodes
    part : (q,) int      which of the parts each belongs to
    kept : tuple         numbers of parts of the kept cells, and which of these rows they are
    """

    tags: IntArray
    nodes: IntArray
    part: IntArray
    kept: tuple[tuple[int, IntArray], ...] = ()


def parts_of(model: Any) -> dict[Entity, Part]:
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


def kinds_of(model: Any, parts: dict[Entity, Part]) -> dict[int, Kind]:
    """The types of elements of a model by their numbers."""
    numbers = {elements.number for part in parts.values() for elements in part.elements}
    out = {}
    for number in sorted(numbers):
        name, dim, order, nodes, _, corners = model.mesh.getElementProperties(number)
        out[number] = Kind(name, dim, order, nodes, corners)
    return out


def chosen_kind(model: Any, kinds: dict[int, Kind]) -> int:
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


def closest_on(
    model: Any, entity: Entity, rim: list[Entity], parts: dict[Entity, Part],
    places: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Places (k, 3) on an entity, or on the curves of its rim, that are nearest to given ones.

    Where a foot is beyond the rim of a face, as near that of a cut sphere, Gmsh finds another one,
    which may be on the far side: further away than a node.
    """
    from scipy.spatial import cKDTree

    def found_on(one: Entity, x: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(model.getClosestPoint(*one, x.ravel())[0]).reshape(-1, 3)

    out = found_on(entity, places)
    nodes = np.concatenate([parts[one].places for one in (entity, *rim)])
    if not (rim and len(nodes)):
        return out
    near = cKDTree(nodes).query(places)[0] + FAR * float(np.ptp(nodes, axis=0).max())
    off = np.flatnonzero(np.sqrt(((out - places) ** 2).sum(axis=1)) > near)
    if len(off):
        ways = np.stack([found_on(one, places[off]) for one in (entity, *rim)])
        best = ((ways - places[off]) ** 2).sum(axis=2).argmin(axis=0)
        out[off] = ways[best, np.arange(len(off))]
    return out
