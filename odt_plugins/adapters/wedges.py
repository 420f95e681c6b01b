"""Texture coordinates of wedges, the corners of triangles: which faces share a chart, and carrying.

In the plane faces of different charts never mix, so seams of the texture stay where they are. The
vertices of a curved surface move across seams, and the coordinates of its wedges are interpolated.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.host import Feet, HostMesh, KeptCells, Result
from odt_plugins.adapters.regions import CHARTS
from odt_plugins.errors import DataNotKeptWarning, counted, warn
from odt_plugins.mesh.components import components
from odt_plugins.mesh.facets import row_keys

ON_SEAM = 1e-6
"""Largest barycentric coordinate of a vertex with respect to the corner opposite to its edge."""

SEAM = "texture seam"
"""Kind of the edges within a chart across which texture coordinates jump."""

TEXTURE = "texcoord"
"""Cell data of the texture coordinates of the corners of triangles."""

NAMES = re.compile(r"(?i)(off:)?texture([ _]?coordinates)?|tcoords")
"""Names of arrays of the texture coordinates of vertices."""

PAIRS = (("s", "t"), ("texture_u", "texture_v"), ("u", "v"))
"""Names of two arrays of them, as PLY files have; u and v may be components of a vector instead."""

TILE = 1.001
"""How wide the values of u and v are around 0.5 where these are texture coordinates."""


def charts(
    uv: NDArray[np.floating], cells: NDArray[np.integer]
) -> tuple[NDArray[np.int64], KeptCells]:
    """Find the charts of a texture.

    Parameters
    ----------
    uv : (m, 3, c)      texture coordinates of the wedges
    cells : (m, 3)      triangles

    Returns
    -------
    chart : (m,) int64  number of the chart of every triangle: triangles are joined over edges at
                        both ends of which their texture coordinates agree
    seams : KeptCells   edges within one chart across which they do not
    """
    m = len(cells)
    n = int(cells.max()) + 1
    start = cells[:, [0, 1, 2]].T.ravel()
    end = cells[:, [1, 2, 0]].T.ravel()
    face = np.tile(np.arange(m), 3)
    place = np.stack([uv[:, [0, 1, 2]], uv[:, [1, 2, 0]]], axis=2)
    place = place.transpose(1, 0, 2, 3).reshape(3 * m, 2, -1)
    turned = start > end
    place[turned] = place[turned, ::-1]
    edge = np.sort(np.stack([start, end], axis=1), axis=1)
    key = row_keys(edge, n)
    order = np.argsort(key, kind="stable")
    twin = np.flatnonzero(key[order][1:] == key[order][:-1])
    a, b = order[twin], order[twin + 1]
    same = (place[a] == place[b]).all(axis=(1, 2))
    chart = components(face[a[same]], face[b[same]], m).astype(np.int64)
    inner = ~same & (chart[face[a]] == chart[face[b]])
    return chart, KeptCells(SEAM, edge[a[inner]])


def carried(
    uv: NDArray[np.floating], cells: NDArray[np.integer], result: Result
) -> NDArray[np.floating]:
    """Texture coordinates (m', 3, 2) of the wedges of the new triangles.

    Parameters
    ----------
    uv : (m, 3, 2)     of the old wedges
    cells : (m, 3)     old triangles
    result : Result    new triangles and the old one from which each takes its data

    Returns
    -------
    (m', 3, 2)         a wedge takes the coordinates that its vertex has in the source triangle;
                       where that does not have the vertex, those of the old wedge of the vertex
                       that lies nearest to the source triangle in the texture. On a surface
                       along which vertices moved, see :func:`_on_surface`
    """
    if result.same is not None:
        cells = result.same[cells]
        if result.feet is None or result.feet.origin is None:
            result = result._replace(cells=result.same[result.cells])
    if result.feet is not None:
        return _on_surface(uv, cells, result.cells, result.feet)
    return _of_sources(uv, cells, result)


def _on_surface(
    uv: NDArray[np.floating], cells: NDArray[np.integer], new: NDArray[np.integer], feet: Feet
) -> NDArray[np.floating]:
    """Texture coordinates (m', 3, 2) of triangles whose vertices moved along a surface.

    A new triangle belongs to the chart under its barycentre. A wedge takes the coordinates that
    this chart has at the vertex: those of the old wedge where the vertex did not move, else
    interpolated, on a seam between those at the ends of its edge, of several at one vertex those
    nearest to the triangle under it. Where a triangle lies across a seam, that one is continued.

    Warns
    -----
    DataNotKeptWarning    triangles lie across seams
    """
    chart, _ = charts(uv, cells)
    own = chart[feet.under]
    count, flat = int(chart.max()) + 1, uv.reshape(-1, 2)
    key = cells.ravel().astype(np.int64) * count + np.repeat(chart, 3)
    known = new if feet.origin is None else feet.origin[new]
    row = np.full(int(max(new.max(), feet.vertex.max(initial=0))) + 1, -1)
    row[feet.vertex] = np.arange(len(feet.vertex))
    place = row[new]

    ahead = np.einsum("mcw,mwk->mck", feet.corners, uv[feet.under]).astype(uv.dtype)
    out: NDArray[np.floating] = ahead.copy()
    order = np.argsort(key, kind="stable")
    wanted = known.astype(np.int64) * count + own[:, None]
    wedge = _nearest(
        key, order, wanted.ravel(), flat, ahead.reshape(-1, 2)).reshape(wanted.shape)
    most = 2.0 * (np.ptp(ahead, axis=1) + np.ptp(uv[feet.under], axis=1))
    most[~_cut(key, order, chart, flat)[own]] = np.inf
    stays = (place < 0) & (wedge >= 0) & _near(flat[wedge], ahead, most[:, None])
    out[stays] = flat[wedge[stays]]
    there = _interpolated(uv[feet.face], feet)[place] if len(feet.face) else ahead
    inside = (place >= 0) & _near(there, ahead, most[:, None])
    inside[inside] = (chart[feet.face[place]] == own[:, None])[inside]
    out[inside] = there[inside]
    face, corner = np.nonzero((place >= 0) & ~inside)
    foot = place[face, corner]
    weight = np.where(np.abs(feet.weights[foot]) > ON_SEAM, feet.weights[foot], 0.0)
    wanted = cells[feet.face[foot]].astype(np.int64) * count + own[face, None]
    wedge = _nearest(key, order, wanted.ravel(), flat, np.repeat(ahead[face, corner], 3, axis=0))
    wedge = wedge.reshape(wanted.shape)
    shares = weight / weight.sum(axis=1, keepdims=True)
    there = (shares[..., None] * flat[wedge]).sum(axis=1).astype(uv.dtype)
    near = _near(flat[wedge], ahead[face, corner][:, None], most[face][:, None])
    on = ((weight == 0.0) | ((wedge >= 0) & near)).all(axis=1)
    out[face[on], corner[on]] = there[on]
    inside[face[on], corner[on]] = True
    across = int((~(stays | inside)).any(axis=1).sum())
    if across:
        lie = counted(across, "triangle of the result lies", "triangles of the result lie")
        msg = (f"{lie} across seams of the texture, which is continued there beyond its charts; to "
               f"keep the seams try regions={CHARTS!r}")
        warn(msg, DataNotKeptWarning)
    return out


def _cut(
    key: NDArray[np.int64], order: NDArray[np.int64], chart: NDArray[np.int64],
    flat: NDArray[np.floating],
) -> NDArray[np.bool_]:
    """Charts that have several coordinates at one vertex, as one around a cylinder has."""
    other = (key[order][1:] == key[order][:-1]) & (flat[order][1:] != flat[order][:-1]).any(axis=1)
    out = np.zeros(int(chart.max()) + 1, dtype=np.bool_)
    out[np.repeat(chart, 3)[order[1:][other]]] = True
    return out


def _near(
    values: NDArray[np.floating], ahead: NDArray[np.floating], most: NDArray[np.floating]
) -> NDArray[np.bool_]:
    """Whether values lie no farther from those ahead than others on this side of a seam do."""
    return np.asarray((np.abs(values - ahead) <= most).all(axis=-1))


def _nearest(
    key: NDArray[np.integer], order: NDArray[np.int64], wanted: NDArray[np.integer],
    flat: NDArray[np.floating], near: NDArray[np.floating],
) -> NDArray[np.int64]:
    """Of the wedges with the wanted keys (k,) those nearest to places (k, 2) in the texture.

    ``order`` sorts the keys.

    Returns
    -------
    (k,) int64    -1 where no wedge has the key
    """
    low = np.searchsorted(key[order], wanted, side="left")
    size = np.searchsorted(key[order], wanted, side="right") - low
    row = np.repeat(np.arange(len(wanted)), size)
    first = np.cumsum(size) - size
    wedge = order[np.arange(len(row)) - np.repeat(first, size) + low[row]]
    with np.errstate(over="ignore"):
        away = ((flat[wedge] - near[row]) ** 2).sum(axis=1)
    best = np.lexsort((wedge, away, row))
    out = np.full(len(wanted), -1, dtype=np.int64)
    out[size > 0] = wedge[best[first[size > 0]]]
    return out


def of_vertices(data: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    """Point data that are texture coordinates (n, c) by their names, as files have these."""
    pairs = [name for pair in PAIRS if all(name in data for name in pair)
             and not (pair == PAIRS[2] and _are_components(data)) for name in pair]
    names = [name for name in data if name in pairs or NAMES.fullmatch(name)]
    found = {name: np.asarray(data[name]) for name in names}
    return {name: values.reshape(len(values), -1) for name, values in found.items()
            if values.dtype.kind == "f" and values.ndim == 2 - (name in pairs)}


def _are_components(data: Mapping[str, Any]) -> bool:
    """Whether u and v are of a vector: beside w, or not all from 0 to 1."""
    parts = [np.asarray(data[name]) for name in PAIRS[2]]
    return "w" in data or not all(part.dtype.kind == "f" and bool(
        (np.abs(part - 0.5) <= TILE / 2).all()) for part in parts)


def texture_of(
    arrays: dict[str, NDArray[Any]], kind: str, data: Mapping[str, Any]
) -> NDArray[Any] | None:
    """Texture coordinates (m, 3, 2) of the corners of triangles, or those (n, c) of vertices.

    Parameters
    ----------
    arrays, data : dict    cell and point data
    kind : str             type of the cells in meshio
    """
    uv = arrays.get(TEXTURE) if kind == "triangle" else None
    if uv is not None and uv.shape[1:] == (6,):
        return uv.reshape(-1, 3, 2).astype(np.float64)
    there = [*of_vertices(data).values()] if kind == "triangle" else []
    return np.concatenate(there, axis=1) if there else None


def slid(
    values: NDArray[np.floating], cells: NDArray[np.integer], feet: Feet | None
) -> NDArray[np.floating]:
    """Texture coordinates (n, c) of vertices, those that moved along a surface interpolated.

    Parameters
    ----------
    values : (n, c)     of the vertices before
    cells : (m, 3)      triangles before
    feet : Feet or None
    """
    if feet is None:
        return np.array(values)
    out = np.array(values if feet.origin is None else values[feet.origin])
    out[feet.vertex] = _interpolated(values[cells[feet.face]], feet)
    return out


def _interpolated(corners: NDArray[np.floating], feet: Feet) -> NDArray[np.floating]:
    """Values (k, 3, c) at the corners of the triangles of feet, at the feet: (k, c)."""
    found = (feet.weights[:, :, None] * corners).sum(axis=1)
    return np.asarray(found.astype(corners.dtype))


def _of_sources(
    uv: NDArray[np.floating], cells: NDArray[np.integer], result: Result
) -> NDArray[np.floating]:
    """Texture coordinates that the vertices of every new triangle have in its source."""
    out = np.zeros((len(result.cells), 3, 2), dtype=uv.dtype)
    old = cells[result.source]
    todo = np.ones((len(result.cells), 3), dtype=np.bool_)
    for i in range(3):
        for j in range(3):
            same = old[:, j] == result.cells[:, i]
            out[same, i] = uv[result.source[same], j]
            todo[same, i] = False
    face, corner = np.nonzero(todo)
    if not len(face):
        return out
    flat = uv.reshape(-1, 2)
    middle = uv[result.source[face]].mean(axis=1, dtype=np.float64)
    order = np.argsort(cells.ravel(), kind="stable")
    out[face, corner] = flat[
        _nearest(cells.ravel(), order, result.cells[face, corner], flat, middle)]
    return out


def glued(host: HostMesh, same: NDArray[np.int64]) -> HostMesh:
    """The same soup with one vertex at every place; textures part it where they did."""
    def first(rows: NDArray[Any]) -> NDArray[Any]:
        known = (rows >= 0) & (rows < len(same))
        return np.where(known, same[np.where(known, rows, 0).astype(np.int64)], rows)

    cells = first(host.cells).astype(np.int64)
    kept = [KeptCells(part.kind, first(part.rows), walls=part.walls) for part in host.kept
            if part.kind != SEAM]
    blocks = host.blocks
    if host.texture is not None and cells.shape[1] == 3:
        uv = host.texture if host.texture.ndim == 3 else host.texture[host.cells.astype(np.int64)]
        blocks, seams = charts(uv, cells)
        kept.append(seams)
    anchors = None if host.anchors is None else first(host.anchors)
    return replace(host, cells=cells, blocks=blocks, kept=tuple(kept), anchors=anchors)


def with_seams(host: HostMesh) -> HostMesh:
    """The same with what keeps the seams of a texture of wedges, also where it had nothing."""
    uv = host.texture
    if host.blocks is not None or uv is None or uv.ndim != 3 or host.cells.shape[1] != 3:
        return host
    blocks, seams = charts(uv, host.cells)
    return replace(host, blocks=blocks, kept=(*host.kept, seams))


def without_seams(host: HostMesh) -> HostMesh:
    """The same with nothing that keeps the seams of a texture."""
    if not host.textured:
        return host
    kept = tuple(part for part in host.kept if part.kind != SEAM)
    return replace(host, blocks=None, kept=kept)
