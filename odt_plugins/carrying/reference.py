"""The envelope around another mesh than the one that is given: what of it is left.

By the triangle inequality a result within ``left`` of a mesh that is itself within ``used`` of the
reference is within ``used + left`` of the reference. Both are certified upper bounds.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from odt_plugins.adapters.host import HostMesh
from odt_plugins.adapters.regions import AUTO, are_names
from odt_plugins.adapters.registry import find_adapter
from odt_plugins.errors import InvalidOptionError
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.mesh.faces import no_faces
from odt_plugins.mesh.plane import plane_frame
from odt_plugins.mesh.simplex import compact_labels, diagonal, mesh_arrays, vertices_of
from odt_plugins.mesh.soup import same_places
from odt_plugins.options import Options

TOLERANCES = (0.02, 0.0004)
"""Distances are bounded to these parts of the envelope, the second where the first tells little."""


def within_reference(options: Options, host: HostMesh) -> tuple[Options, tuple[str, ...]]:
    """Let the envelope be what another mesh leaves of it.

    Parameters
    ----------
    options : Options      of which `reference` is the other mesh, if there is one
    host : HostMesh        the mesh that is given

    Returns
    -------
    options                without a reference
    notes : tuple of str   what is left

    Raises
    ------
    InvalidOptionError     the mesh is of another kind, further away than the envelope, or has a
                           boundary that stays
    """
    if options.reference is None:
        return options, ()
    kind, size, sheets = _surfaces(host, options)
    if kind != "a curved surface" and options.boundary != "slide":
        msg = (f"got reference= for {kind} whose boundary stays; expected boundary='slide' beside "
               "it")
        raise InvalidOptionError(msg)
    names = options.regions if are_names(options.regions) else AUTO
    other = find_adapter(options.reference).read(options.reference, names)
    other_kind, whole, grounds = _surfaces(other, options)
    if kind != other_kind:
        msg = f"got {other_kind} as reference= of {kind}; expected a mesh of the same kind"
        raise InvalidOptionError(msg)
    length = options.envelope * whole
    used = _distance(sheets, grounds, length)
    if used == 0.0 and size == whole:
        return replace(options, reference=None), ()
    if not used < length:
        msg = (f"got a mesh up to {used:.3g} away from its reference; expected less than the "
               f"envelope, which is {length:.3g} around that; try envelope="
               f"{2.0 * used / whole:.2g}" if np.isfinite(used) else
               "got a reference= without the rims or borders that the mesh has, or with others; "
               "expected an earlier state of the same mesh")
        raise InvalidOptionError(msg)
    note = (f"the mesh is up to {used:.3g} away from its reference, so that {length - used:.3g} of "
            f"the envelope of {length:.3g} is left")
    return replace(options, reference=None, envelope=(length - used) / size), (note,)


def _surfaces(
    host: HostMesh, options: Options
) -> tuple[str, float, list[tuple[FloatArray, IntArray]]]:
    """Kind and diagonal of a mesh, and what moves within an envelope: its surface and interfaces,
    or its rims and borders as triangles without area.
    """
    from odt_plugins.engine.ground.features import label_borders
    from odt_plugins.engine.remesh.lay_out import surface_of
    from odt_plugins.mesh.surface import surface_edges

    points, cells = mesh_arrays(host.points, host.cells)
    labels = np.zeros(len(cells), dtype=np.int32)
    if host.regions is not None and are_names(options.regions):
        labels = compact_labels(host.regions, len(cells))
    size = diagonal(points[vertices_of(cells)])
    space = np.pad(points, [(0, 0), (0, 3 - points.shape[1])])
    if cells.shape[1] == 4:
        return "tetrahedra", size, [(space, surface_of(cells, labels, no_faces()[1])[0])]
    same = same_places(host.points, cells.astype(np.int64))
    cells = cells if same is None else same[cells].astype(np.int32)
    edges = surface_edges(cells, len(points))
    border = (edges.degree != 2) | label_borders(edges, labels)
    lines = space, edges.vertices[border][:, [0, 1, 1]]
    if points.shape[1] == 2 or plane_frame(points, cells) is not None:
        return "triangles in the plane", size, [lines]
    return "a curved surface", size, [(space, cells), lines]


def _distance(mine: Any, others: Any, length: float) -> float:
    """Upper bound of how far surfaces are apart, both ways, as sharp as a length asks for."""
    from odt_plugins.engine.ground.envelope import distances

    furthest = 0.0
    for one, other in zip(mine, others, strict=True):
        if all(map(np.array_equal, one, other)):
            continue
        if not len(one[1]) or not len(other[1]):
            furthest = max(furthest, np.inf if len(one[1]) != len(other[1]) else 0.0)
            continue
        for tolerance in TOLERANCES:
            both = distances(one, other, tolerance * length)
            upper = max(both.forward_upper, both.backward_upper)
            if upper < length or max(both.forward_lower, both.backward_lower) >= length:
                break
        furthest = max(furthest, upper)
    return furthest
