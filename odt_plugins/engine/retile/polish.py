"""The last descents on a resized surface: those of stage 2, whose compound moves undo defects."""

from __future__ import annotations

import numpy as np

from odt_plugins.engine.finish.descent import finish_phase
from odt_plugins.engine.finish.phases import bulk
from odt_plugins.engine.ground.build import make_sheet
from odt_plugins.engine.ground.features import Features, pinched_vertices
from odt_plugins.engine.ground.lines import Lines
from odt_plugins.engine.ground.sheet import LOCKED, SMOOTH, Guards, Limits, Sheet
from odt_plugins.engine.retile.net import Net, Rules, link_all
from odt_plugins.engine.surface.driver import COMPOUND, TAIL
from odt_plugins.engine.surface.passes import Surface, SurfaceDescent
from odt_plugins.engine.topology.star import vertex_stars
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray
from odt_plugins.mesh.facets import row_keys
from odt_plugins.mesh.surface import Edges, opposed, surface_edges
from odt_plugins.promise.surface import bad_places

POLISHES = 4
"""Descents, those after the first with vertices that stay around where the surface folded back."""


def polish(net: Net, rules: Rules, metric: FloatArray) -> None:
    """Lower F_p of a net without free slots by flips, Newton steps and compound moves.

    Vertices on tracks stay, and those where the surface would fold back otherwise. Triangles that
    disagree about the outside, as where a third one at their edge stays, are no neighbours.

    Parameters
    ----------
    net : Net                  changed
    rules : Rules
    metric : (k, g) float64    see ``ground.build.resample_metric``
    """
    n, m = int(net.count[0]), int(net.count[1])
    edges = surface_edges(net.triangles[:m], n)
    known = edges.vertices[bad_places(net.points[:n, :3], net.triangles[:m], edges)[1]]
    edges.neighbors[np.isin(edges.of_cell, opposed(edges))] = -1
    folded = np.zeros(n, dtype=np.bool_)
    for _ in range(POLISHES):
        sheet, mark = _polished(net, rules, metric, edges, folded)
        after = surface_edges(sheet.triangles, n)
        key = row_keys(np.concatenate([after.vertices, known]), n)
        folds = bad_places(sheet.points[:, :3], sheet.triangles, after)[1]
        folds &= ~np.isin(key[: len(folds)], key[len(folds):])
        if not folds.any():
            break
        near = np.isin(sheet.triangles, sheet.triangles[folds[after.of_cell].any(axis=1)])
        folded[sheet.triangles[near.any(axis=1)]] = True
    else:
        return
    net.points[:n], net.foot[:n] = sheet.points, sheet.foot
    net.triangles[:m], net.marks[:m] = sheet.triangles, mark[sheet.edges.of_cell]
    net.first[:m], net.following[:] = sheet.first, sheet.following
    link_all(net)


def _polished(
    net: Net, rules: Rules, metric: FloatArray, edges: Edges, folded: BoolArray
) -> tuple[Sheet, IntArray]:
    """Triangles on the ground after the descents, and the track that each edge is on.

    Parameters
    ----------
    edges : Edges          of the net
    folded : (n,) bool     vertices that stay, as edges between them do
    """
    n, m = int(net.count[0]), int(net.count[1])
    points, triangles = net.points[:n], net.triangles[:m]
    mark = np.full(len(edges.degree), -1, dtype=np.int32)
    mark[edges.of_cell] = net.marks[:m]
    pinched = pinched_vertices(triangles, edges, vertex_stars(triangles, n), n)
    stays = folded | (net.kind[:n] != SMOOTH) | _narrowed(net, rules)
    kind = np.where(stays, LOCKED, SMOOTH)
    none = np.zeros(0, dtype=np.int32)
    lines = Lines(none, np.zeros(0), np.zeros(0), none, np.full(n, -1, dtype=np.int32))
    held = (mark >= 0) | folded[edges.vertices].all(axis=1)
    features = Features(held, kind.astype(np.uint8), pinched, lines, 0)
    sheet = make_sheet(points[:, :3], triangles, edges, features)
    reach = float(rules.reach.max())
    sheet = sheet._replace(points=points.copy(), foot=net.foot[:n].copy())
    first = net.first[:m].copy() if reach < np.inf else np.full(m, -1, dtype=np.int32)
    sheet = sheet._replace(first=first, following=net.following.copy())
    guards = Guards(rules.ground, lines, Limits(reach * reach, 0.0, rules.cosine))
    surface = Surface(sheet, guards, net.labels[:m].copy(), metric)
    for phase in (*bulk(2), COMPOUND, *TAIL):
        descent = SurfaceDescent(surface, phase, rules.bounds)
        descent.compound()
        finish_phase(descent, phase)
        surface.resample()
    return sheet, mark


def _narrowed(net: Net, rules: Rules) -> BoolArray:
    """Mark the vertices (n,) of triangles at which the envelope is narrower than elsewhere."""
    n, m = int(net.count[0]), int(net.count[1])
    narrow = rules.reach[net.foot[:n]] < rules.reach.max()
    out = np.zeros(n, dtype=np.bool_)
    out[net.triangles[:m][narrow[net.triangles[:m]].any(axis=1)]] = True
    return out
