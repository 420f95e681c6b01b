"""What an adapter reads from a caller's object and what it is given to write back."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import combinations
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.colours import in_kind, varies
from odt_plugins.adapters.regions import are_whole
from odt_plugins.errors import InvalidOptionError, ODTError, reworded
from odt_plugins.mesh.arrays import FloatArray
from odt_plugins.mesh.facets import row_keys
from odt_plugins.mesh.plane import PlaneFrame, places_in_space, plane_frame
from odt_plugins.mesh.simplex import diagonal, mesh_arrays

SET_VERTEX, NAMED_VERTEX = "vertex of point set", "vertex named by its file"
"""Kind of kept cells of a vertex each, with the name of the set behind it."""

CELL_VERTEX = "vertex alone in a cell"
"""Kind of kept cells of a vertex each: those that make up no cells or facets are places."""

CREASE, OUTSIDE, INTERFACE, INSIDE = -1, 0, 1, 2
"""How far inside vertices are: on creases of the boundary, on its rest, on interfaces, inside."""

NEAR = 1e-6
"""Largest barycentric coordinate of a vertex on the face opposite to a corner."""

POINT_LABELS = ("medit:ref", "tetgen:ref", "point_tags")
"""Labels of points that formats hold beside their labels of cells; 0 is none."""

SPLINE_VERTEX = "vertex on a spline"
"""Kind of kept cells of a vertex each, of a mesh of Netgen in the plane."""


class KeptCells(NamedTuple):
    """Cells beside the optimised ones that come back as they are.

    Attributes
    ----------
    kind : str             name of their cell type, for messages
    rows : (q, r) int      r = 1: vertices that must not move; r = 2, 3: lines or triangles
                           that must stay faces of the mesh
    classes : (q,) int or None    class of each row where the adapter writes ``NewFaces``: rows of
                                  one class may become each other
    labels : (q,) int or None     rows of different ones keep the border between them, where each
                                  row stays itself; None where the classes tell that
    ids : (q,) int or None        place of each row among all cells of the object, of those with
                                  classes where the host has such `ids`
    walls : (q,) int or None      of which cell every row is, where rows are vertices, r = 1, of
                                  cells of another shape, so that facets and edges stay too
    """

    kind: str
    rows: NDArray[Any]
    classes: NDArray[Any] | None = None
    labels: NDArray[Any] | None = None
    ids: NDArray[Any] | None = None
    walls: NDArray[Any] | None = None


def of_other_shape(kind: str, vertices: NDArray[Any], size: NDArray[Any]) -> KeptCells:
    """Keep cells of so many vertices each (m,), which are given one after another."""
    return KeptCells(kind, vertices.reshape(-1, 1), walls=np.repeat(np.arange(len(size)), size))


def middles(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Barycentres of lines or triangles (q, r, D), then the middles of the edges of these."""
    pairs = list(combinations(range(corners.shape[1]), 2))
    return np.concatenate([corners.mean(axis=1),
                           *(0.5 * (corners[:, a] + corners[:, b]) for a, b in pairs)])


def each_once(kept: KeptCells) -> list[tuple[KeptCells, NDArray[np.int64]]]:
    """Part kept cells into such without repeated rows; with each the indices of its rows."""
    rows, known = kept.rows, kept.labels if kept.classes is None else kept.classes
    order = np.arange(len(rows)) if known is None else np.argsort(known, kind="stable")
    key = row_keys(np.sort(rows, axis=1), int(rows.max(initial=0)) + 1)[order]
    again = np.argsort(key, kind="stable")
    first = np.searchsorted(key[again], key[again])
    turn = np.empty(len(rows), dtype=np.int64)
    turn[order[again]] = np.arange(len(rows)) - first
    own = [np.flatnonzero(turn == i) for i in range(int(turn.max(initial=-1)) + 1)]
    there = [name for name, values in kept._asdict().items() if isinstance(values, np.ndarray)]
    return [(kept._replace(**{name: getattr(kept, name)[chosen] for name in there}), chosen)
            for chosen in own]


def classes_of(
    columns: Sequence[NDArray[Any]], count: int
) -> tuple[NDArray[np.int64] | None, NDArray[np.int64]]:
    """Classes and labels (count,) of rows that are alike in all columns of whole numbers and texts.

    Most values of a column may be there once: they are no labels, and there are no classes.
    Floating-point numbers are labels where few whole ones are there.
    """
    own = False
    out = np.zeros(count, dtype=np.int64)
    for values in columns:
        if values.shape not in ((count,), (count, 1)) or not are_whole(values):
            continue
        texts = values.astype(str) if values.dtype.kind == "O" else values
        distinct, label = np.unique(texts, return_inverse=True)
        if 2 * len(distinct) > max(count, 2):
            own |= values.dtype.kind != "f"
            continue
        out = np.unique(out * len(distinct) + label.ravel(), return_inverse=True)[1].ravel()
    return None if own else out, out


def as_indices(values: NDArray[np.integer], like: NDArray[Any]) -> NDArray[Any]:
    """Indices in the type of others, or in a wider one that holds all of them.

    An empty list has no type of its own.
    """
    own = like.dtype.kind in "iu" or (like.dtype.kind == "f" and like.size > 0)
    kind = like.dtype if own else np.dtype(np.int64)
    most = int(values.max(initial=0))
    if kind.kind != "f" and most > np.iinfo(kind).max:
        kind = np.promote_types(kind, np.min_scalar_type(most))
    return values.astype(kind)


class Geometry(NamedTuple):
    """The geometry that a mesh was made of, on which the vertices of its surface slide.

    Faces and curves have numbers, which are the classes of the kept cells on them.

    Attributes
    ----------
    closest : callable       places (k, D) nearest to given ones (k, D) on the faces and curves of
                             given numbers (k,); for those of other numbers the given ones
    sag : callable           how far the surface of the mesh is from it
    on : (n,) int            face or curve on which every vertex is, -1 of none
    on_curves : (c,) int     vertices on curves, which stay unless the boundary slides
    cells : (m,) int         face on which every cell of a surface is
    """

    closest: Callable[[NDArray[Any], NDArray[np.float64]], NDArray[np.float64]]
    sag: Callable[[], float]
    on: NDArray[Any]
    on_curves: NDArray[Any]
    cells: NDArray[Any]


@dataclass(frozen=True)
class HostMesh:
    """A caller's mesh as raw arrays, not yet checked.

    Attributes
    ----------
    points : (n, D) array             in the caller's dtype
    cells : (m, k) array              triangles or tetrahedra in the caller's dtype and order
    regions : (m,) int or None        labels found in the object
    regions_from : tuple of str       names of the arrays or sets that they come from
    blocks : (m,) int or None         groups of cells that must not mix, such as meshio's blocks
    kept : tuple of KeptCells         cells that are not optimised
    source : object                   the caller's object, never changed
    layout : object                   what else the writer of this adapter needs
    words : callable                  puts an error message into the words of this toolkit
    anchors : (k,) int or None        vertices that may move but must not be removed
    coupled : (k,) int or None        vertices of faces that correspond to each other, as those of
                                      a periodic mesh, which stay when the boundary slides
    linked : bool                     whether the writer refuses results that have these elsewhere
    higher_order : bool               whether there are nodes between the corners of the cells
    ids : (m,) int or None            place of every cell among all cells of the object, ascending,
                                      where there may be others; they stay in that order
    total : int                       number of all cells of the object, with `ids`
    fields : dict of (n, ...)         point arrays that sample a field, colours of bytes among them
    densities : dict of (m, ...)      cell arrays of floating-point numbers, by their names
    follows : bool                    whether fields are interpolated unless the caller says so
    geometry : Geometry or None       that the vertices of the surface are on, and stay on
    nodes : (m, k) int or None        all nodes of the cells of higher order
    shape : (k, d + 1) int or None    whole barycentric weights of these nodes
    whole : bool                      whether the writer takes cells with all their nodes where
                                      vertices came and went
    settle : callable or None         puts nodes between the corners where the writer puts them:
                                      takes this, a HigherOrder and the source of its cells
    texture : array or None           texture coordinates: (m, 3, c) of the corners of triangles, or
                                      (n, c) of the vertices
    """

    points: NDArray[Any]
    cells: NDArray[Any]
    regions: NDArray[Any] | None = None
    regions_from: tuple[str, ...] = ()
    blocks: NDArray[Any] | None = None
    kept: tuple[KeptCells, ...] = ()
    source: Any = None
    layout: Any = None
    words: Callable[[str], str] = str
    anchors: NDArray[Any] | None = None
    coupled: NDArray[Any] | None = None
    linked: bool = False
    higher_order: bool = False
    ids: NDArray[Any] | None = None
    total: int = 0
    fields: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    densities: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    follows: bool = True
    texture: NDArray[Any] | None = None
    geometry: Geometry | None = None
    nodes: NDArray[Any] | None = None
    shape: NDArray[np.int64] | None = None
    whole: bool = False
    settle: Callable[[Any, Any, NDArray[Any]], Any] | None = None

    def densities_of(self, cells: NDArray[Any] | None) -> dict[str, NDArray[Any]]:
        """Values of the densities in some of the cells, or in all."""
        return {name: values if cells is None else values[cells]
                for name, values in self.densities.items()}

    @property
    def textured(self) -> bool:
        """Whether there are texture coordinates."""
        return self.texture is not None


class NewVertices(NamedTuple):
    """Where the point data of the result come from, if some vertices have others than before.

    Attributes
    ----------
    origin : (n',) int64        input vertex of every vertex, -1 for those added, at the end
    number : (n,) int64         vertex of the result for every input vertex, -1 if it was removed
    placed : (k,) int64         vertices of the result that were added, or moved to places where
                                fields have other values
    corners : (k, d + 1) int32  input vertices around each of them
    weights : (k, d + 1)        with these barycentric coordinates, of sum 1
    conserved : dict of (n', ...)   fields whose integrals stay, by their names
    depths : callable or None       gives how far inside (n,) input vertices are, and (k,) vertices
                                    `placed`
    """

    origin: NDArray[np.int64]
    number: NDArray[np.int64]
    placed: NDArray[np.int64]
    corners: NDArray[np.int32]
    weights: NDArray[np.float64]
    conserved: Mapping[str, NDArray[Any]] = MappingProxyType({})
    depths: Callable[[], tuple[NDArray[np.int8], NDArray[np.int8]]] | None = None

    @property
    def renumbered(self) -> bool:
        """Whether vertices came or went."""
        return not np.array_equal(self.origin, np.arange(len(self.number)))

    def carried(self, values: NDArray[Any], name: str = "", *, field: bool = True) -> NDArray[Any]:
        """Point data (n, ...) of the input for the vertices of the result, (n', ...).

        A vertex that is still there keeps its value, unless it moved and the values are those of a
        `field`. For one that was added, floating-point numbers and colours are interpolated
        linearly, of anything else the value of the nearest corner is taken. Where all vertices
        inside had one value, as markers of the boundary have, those that come inside have it too,
        and others that of a corner as far inside as they are, if there is one; where two are as
        near, that of one without a marker, 0, and so where all corners are less far inside, or the
        vertex is on a crease. Those whose integrals stay are there already.
        """
        if name in self.conserved:
            return self.conserved[name].reshape(-1, *values.shape[1:])
        out = values[self.origin]
        added = self.origin[self.placed] < 0
        at_corners = values[self.corners]
        if varies(name, values):
            new = added | field
            out[self.placed[new]] = interpolated(at_corners[new], self.weights[new])
            return out
        near, depths = self.weights, self.depths and self.depths()
        if depths is not None and not _alike(values[depths[0] == INSIDE]):
            depths = None
        if depths is not None:
            near = self._deepest(*depths)
            if values.ndim == 1 and values.dtype.kind in "biu":
                tied = near == near.max(axis=1, keepdims=True)
                level = depths[1][:, None]
                beside = (near > -np.inf) & ((depths[0][self.corners] < level) | (level == CREASE))
                near = np.where((tied | beside) & (at_corners == 0), np.inf, near)
        out[self.placed[added]] = at_corners[np.arange(len(near)), near.argmax(axis=1)][added]
        was, now = depths or (np.zeros(0), np.zeros(0))
        for depth in (INTERFACE, INSIDE) if depths is not None else ():
            own, here = values[was == depth], self.placed[added & (now == depth)]
            if len(own) and _alike(own):
                out[here] = own[:1]
            elif not len(own) and depth == INSIDE and name in POINT_LABELS:
                out[here] = 0
        return out

    def _deepest(self, was: NDArray[np.int8], now: NDArray[np.int8]) -> NDArray[np.float64]:
        """Weights of those corners alone that lie the deepest, but no deeper than the vertex."""
        deep = np.where(self.weights > NEAR, was[self.corners], -2)
        deep = np.where(deep > now[:, None], -2, deep)
        return np.where(deep == deep.max(axis=1, keepdims=True), self.weights, -np.inf)


def _alike(values: NDArray[Any]) -> bool:
    """Whether all values (n, ...) are the same."""
    if values.dtype == object:
        return all(np.array_equal(one, values[0]) for one in values)
    return bool((values == values[:1]).all())


def interpolated(at_corners: NDArray[Any], weights: NDArray[np.float64]) -> NDArray[Any]:
    """Values (k, ...) of linear functions with values (k, c, ...) at corners, weights (k, c).

    Equal values at all corners are taken as they are; bytes are interpolated to the nearest ones.
    """
    wide = at_corners.astype(np.result_type(at_corners, np.float64))
    first = wide[:, :1]
    with np.errstate(all="ignore"):
        found = first[:, 0] + np.einsum("kc,kc...->k...", weights, wide - first)
    return in_kind(found, at_corners)


class Feet(NamedTuple):
    """Where a surface whose vertices moved along it lies on the caller's triangles.

    Attributes
    ----------
    vertex : (k,) int             vertices that moved, ascending
    face : (k,) int               input triangle on which each lies
    weights : (k, 3) float64      barycentric coordinates there, in the order of its corners
    under : (m',) int             input triangle under the barycentre of every new one
    corners : (m', 3, 3) float64  barycentric coordinates of the corners of the new triangles
                                  with respect to the one under them, negative outside of it
    origin : (n',) int or None    input vertex of every vertex where some came or went, -1 for those
                                  that came, which moved
    """

    vertex: NDArray[Any]
    face: NDArray[Any]
    weights: NDArray[np.float64]
    under: NDArray[Any]
    corners: NDArray[np.float64]
    origin: NDArray[np.int64] | None = None


class NewFaces(NamedTuple):
    """What kept lines or triangles have become where vertices of the boundary came and went.

    Attributes
    ----------
    rows : (q', r) int      vertices of the result, turned as those they come from; -1 in the
                            place of nodes that are those of before
    source : (q',) int      the kept cell from which the data of each come, ascending
    """

    rows: NDArray[np.int64]
    source: NDArray[np.int64]


class Result(NamedTuple):
    """An optimised mesh in the caller's terms.

    Attributes
    ----------
    points : (n, D)            caller's dtype; vertices keep their index
    cells : (m', k)            caller's dtype and orientation, sorted by `source`
    source : (m',) int32       input cell from which the data of each cell come
    curved : bool              whether these are triangles of a curved surface: its vertices moved
                               along it, and its normals are others
    feet : Feet or None        of the vertices that moved along one with texture coordinates
    vertices : NewVertices     when some were removed or added, or fields are interpolated
    split : callable or None   when the mesh was refined: the parts (c q, r) of other cells (q, r),
                               r = 1, 2 or 3 vertices, those of row i from c i on
    locate : callable or None  of cells of higher order when fields are interpolated: the input
                               cells (k,) around places (k, D) near some input cells (k,), and
                               their barycentric coordinates there
    same : (n,) int or None    of a soup, the first vertex at the place of every vertex
    of_cells : dict of (m', ...)   densities whose integrals stay, by their names
    faces : tuple              what each of the kept cells of the host have become, if they are no
                               longer themselves; as long as these, or empty
    """

    points: NDArray[Any]
    cells: NDArray[Any]
    source: NDArray[np.int32]
    curved: bool = False
    feet: Feet | None = None
    vertices: NewVertices | None = None
    split: Callable[[NDArray[Any]], NDArray[np.int64]] | None = None
    locate: Callable[[NDArray[Any], NDArray[Any]], tuple[NDArray[Any], NDArray[Any]]] | None = None
    same: NDArray[np.int64] | None = None
    of_cells: Mapping[str, NDArray[Any]] = MappingProxyType({})
    faces: tuple[NewFaces | None, ...] = ()

    def faces_of(self, kept: int, rows: NDArray[Any]) -> NewFaces:
        """What these rows (q, r) of the kept cells of a number have become."""
        new = self.faces[kept] if self.faces else None
        number = np.arange(len(self.points)) if self.vertices is None else self.vertices.number
        if new is None:
            return NewFaces(number[rows], np.arange(len(rows)))
        if (new.rows < 0).any():
            new = new._replace(rows=np.where(new.rows < 0, number[rows[new.source]], new.rows))
        return new

    def carried(self, values: NDArray[Any], name: str) -> NDArray[Any]:
        """Cell data (m', ...) of the result from those (m, ...) of the input."""
        if name in self.of_cells:
            return self.of_cells[name].reshape(-1, *values.shape[1:])
        return values[self.source]


def faces_now(
    result: Result, host: HostMesh, ids: NDArray[np.int64], rows: NDArray[Any]
) -> NewFaces:
    """What some cells (q, r) at ascending places (q,) among all have become, in any kept cells."""
    parts = [(k, np.searchsorted(ids, kept.ids)) for k, kept in enumerate(host.kept)
             if kept.ids is not None and np.isin(kept.ids[:1], ids).any()]
    now = [(result.faces_of(k, rows[own]), own) for k, own in parts] or [
        (result._replace(faces=()).faces_of(0, rows), np.arange(len(rows)))]
    source = np.concatenate([own[faces.source] for faces, own in now])
    order = np.argsort(source, kind="stable")
    return NewFaces(np.concatenate([faces.rows for faces, _ in now])[order], source[order])


def any_became_others(result: Result, host: HostMesh, ids: NDArray[np.int64]) -> bool:
    """Whether some of the kept cells at these places (q,) among all are others now."""
    return any(now is not None and kept.ids is not None and np.isin(kept.ids, ids).any()
               for kept, now in zip(host.kept, result.faces, strict=False))


class Adapter(Protocol):
    """The three functions of an adapter module."""

    def matches(self, mesh: object) -> bool:
        """Say whether this adapter reads the object, without importing its toolkit."""
        ...

    def read(self, mesh: Any, regions: str | Sequence[str] | None = None) -> HostMesh:
        """Take the arrays out; `regions` is what `region_labels` takes: names, "auto" or None."""
        ...

    def write(self, result: Result, host: HostMesh) -> Any:
        """Build a new object of the class that was read, with all its data."""
        ...


def is_instance(mesh: object, module: str, name: str) -> bool:
    """Say whether an object is of a toolkit's class or a subclass, by the names alone."""
    return any(
        base.__name__ == name and base.__module__.partition(".")[0] == module
        for base in type(mesh).__mro__
    )


@contextmanager
def words_of(host: HostMesh) -> Iterator[None]:
    """Put the errors of what is done here into the words of the caller's toolkit."""
    try:
        yield
    except ODTError as exc:
        text = host.words(str(exc))
        if text == str(exc):
            raise
        raise reworded(exc, text, type(exc)) from exc


def flat_points(host: HostMesh) -> tuple[FloatArray, PlaneFrame | None]:
    """Points as the engine takes them: planar triangles in space get coordinates in their plane."""
    points, cells = mesh_arrays(host.points, host.cells)
    if points.shape[1] == cells.shape[1] - 1:
        return points, None
    frame = plane_frame(points, cells)
    return (points, None) if frame is None else (frame.to_plane(points), frame)


def with_places(host: HostMesh, points: FloatArray, frame: PlaneFrame | None) -> HostMesh:
    """The mesh in whose words places in its plane are places in space."""
    if frame is None:
        return host
    extent = diagonal(points)
    return replace(host, words=lambda text: places_in_space(host.words(text), frame, extent))


def expect_tetrahedra(host: HostMesh, insert: bool | float) -> None:
    """Refuse meshes into which no vertices can be inserted."""
    if host.cells.shape[1:] == (3,):
        msg = f"got insert={insert} for a mesh of triangles; expected one of tetrahedra"
        raise InvalidOptionError(msg)
