"""The last descents on a resized surface: those of stage 2, whose compound moves undo defects."""

from __future__ import annotations

import numpy as np

from odt_plugins.engine.finish.descent import finish_phase
from odt_plugins.engine.finish.phases import bulk
from odt_plugins.engine.ground.build import make_sheet
from odt_plugins.engine.ground.features import Features, pinched_vertices
from odt_plugins.engine.ground.lines import Lines
from odt_plugins.engine.ground.sheet import LOCKED, SMOOTH, Guards, Limits
from odt_plugins.engine.retile.net import Net, Rules, link_all
from odt_plugins.engine.surface.driver import COMPOUND, TAIL
from odt_plugins.engine.surface.passes import Surface, SurfaceDescent
from odt_plugins.engine.topology.star import vertex_stars
from odt_plugins.mesh.arrays import BoolArray, FloatArray
from odt_plugins.mesh.surface import surface_edges


def polish(net: Net, rules: Rules, metric: FloatArray) -> None:
    """Lower F_p of a net without free slots by flips, Newton steps and compound moves.

    Vertices on tracks stay.

    Parameters
    ----------
    net : Net                  changed
    rules : Rules
    metric : (k, g) float64    see ``ground.build.resample_metric``
    """
    n, m = int(net.count[0]), int(net.count[1])
    points, triangles = net.points[:n], net.triangles[:m]
    edges = surface_edges(triangles, n)
    mark = np.full(len(edges.degree), -1, dtype=np.int32)
    mark[edges.of_cell] = net.marks[:m]
    pinched = pinched_vertices(triangles, edges, vertex_stars(triangles, n), n)
    kind = np.where((net.kind[:n] != SMOOTH) | _narrowed(net, rules), LOCKED, SMOOTH)
    none = np.zeros(0, dtype=np.int32)
    lines = Lines(none, np.zeros(0), np.zeros(0), none, np.full(n, -1, dtype=np.int32))
    features = Features(mark >= 0, kind.astype(np.uint8), pinched, lines, 0)
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
    points[:], net.foot[:n] = sheet.points, sheet.foot
    triangles[:], net.marks[:m] = sheet.triangles, mark[sheet.edges.of_cell]
    net.first[:m], net.following[:] = sheet.first, sheet.following
    link_all(net)


def _narrowed(net: Net, rules: Rules) -> BoolArray:
    """Mark the vertices (n,) of triangles at which the envelope is narrower than elsewhere."""
    n, m = int(net.count[0]), int(net.count[1])
    narrow = rules.reach[net.foot[:n]] < rules.reach.max()
    out = np.zeros(n, dtype=np.bool_)
    out[net.triangles[:m][narrow[net.triangles[:m]].any(axis=1)]] = True
    return out
