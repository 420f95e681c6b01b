"""How far the surfaces of a resized mesh are from those of its input, and what they break."""

from __future__ import annotations

from enum import Enum
from typing import Any, NamedTuple

import numpy as np

from odt_plugins.engine.cells.geometry import boundary_facets, signed_volumes
from odt_plugins.engine.ground.crossings import count_crossings
from odt_plugins.engine.ground.envelope import distances, uncovered, within
from odt_plugins.engine.ground.reference import Reference, make_reference
from odt_plugins.engine.remesh.lay_out import surface_of
from odt_plugins.engine.run.judge import TOLERANCE, Slid
from odt_plugins.engine.run.outcome import Outcome
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.mesh.simplex import SimplexMesh


class Kind(Enum):
    """Kinds of what is broken: the envelope, that surfaces do not cross, or something else."""

    BEYOND = "beyond"
    CUT = "cut"
    OTHER = "other"


class Broken(NamedTuple):
    """What of the promise a mesh breaks, in a sentence, of which kind it is, and whether sizes that
    give way to the surface would change nothing.
    """

    why: str
    kind: Kind = Kind.OTHER
    firm: bool = False


def too_far(what: str, envelope: float) -> Broken:
    """What is broken where something, as it is said, is beyond the envelope."""
    return Broken(f"{what} from the input's, beyond the envelope of {envelope:.3g}", Kind.BEYOND)


Grounds = dict[tuple[int, ...], Reference]
"""Pieces of surface and lines that distances are measured from, by what they lie between."""


def grounds_of(mesh: SimplexMesh) -> Grounds:
    """All pieces of surface of a mesh, and its lines with labels."""
    return {pair: make_reference(mesh.points, rows) for pair, rows in _surfaces(mesh).items()}


def furthest(old: Grounds, outcome: Outcome, envelope: float) -> tuple[float, float]:
    """How far surfaces and lines with labels are apart at most, both ways: the furthest pair."""
    forward = backward = 0.0
    for pair, rows in _surfaces(outcome).items():
        if pair not in old:
            return np.inf, np.inf
        both = distances((outcome.points, rows), old[pair], TOLERANCE * envelope)
        forward, backward = max(forward, both.forward_upper), max(backward, both.backward_upper)
    return forward, backward


def astray(mesh: SimplexMesh, outcome: Outcome, envelope: float) -> FloatArray:
    """Corners (k, 3) of triangles and lines of either mesh that may be further apart, both ways."""
    old, places = _surfaces(mesh), [outcome.points[:0, :3]]
    for pair, rows in _surfaces(outcome).items():
        if pair in old:
            was = make_reference(mesh.points, old[pair])
            far = rows[~within(was, outcome.points, rows, envelope)]
            left = uncovered(was, outcome.points, rows, envelope).triangles
            places += [outcome.points[np.unique(far)], mesh.points[np.unique(old[pair][left])]]
    return np.concatenate(places)


def _surfaces(mesh: SimplexMesh | Outcome) -> dict[tuple[int, ...], IntArray]:
    """Triangles of every piece of surface by the regions on its sides and its label, and lines as
    triangles without area by theirs.
    """
    triangles, patch, names = surface_of(mesh.cells, mesh.regions, mesh.faces[1])
    rows, labels = mesh.faces[0]
    return {tuple(name): triangles[patch == i] for i, name in enumerate(names.tolist())} | {
        (label,): rows[labels == label][:, [0, 1, 1]] for label in np.unique(labels).tolist()}


def beyond(
    mesh: SimplexMesh, old: Grounds, outcome: Outcome, envelope: float
) -> tuple[Broken | None, Slid]:
    """What surfaces that were resized break, and how they slid; ``old`` are those of the mesh."""
    forward, backward = furthest(old, outcome, envelope)
    origin: Any = outcome.origin
    kept = origin >= 0
    moved = (outcome.points[kept] != mesh.points[origin[kept]]).any(axis=1)
    moved &= np.isin(origin[kept], boundary_facets(mesh.cells))
    was, now = (float(signed_volumes(x.points, x.cells).sum()) for x in (mesh, outcome))
    slid = Slid(envelope, forward, backward, now / was - 1.0, int(moved.sum()))
    if not max(forward, backward) <= envelope:
        return too_far(f"the boundary is up to {max(forward, backward):.3g}", envelope), slid
    crossings = count_crossings(outcome.points, boundary_facets(outcome.cells))
    if crossings and crossings > count_crossings(mesh.points, boundary_facets(mesh.cells)):
        return Broken("the boundary cuts through itself", Kind.CUT), slid
    return None, slid
