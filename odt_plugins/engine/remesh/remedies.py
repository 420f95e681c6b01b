"""What is tried next where a mesh that was given other sizes does not keep the promise."""

from __future__ import annotations

from hashlib import sha256
from typing import NamedTuple

import numpy as np

from odt_plugins.engine.remesh.distance import Broken, Kind
from odt_plugins.engine.remesh.places import (
    allowed_figures,
    gone_astray,
    newly_cut,
    of_small_regions,
    seen_figures,
    spoiled_cells,
)
from odt_plugins.engine.remesh.sizes import Sizes, expected_cells, local_sizes
from odt_plugins.engine.remesh.whole import beside_whole
from odt_plugins.engine.run.judge import envelope_length
from odt_plugins.engine.run.outcome import Outcome
from odt_plugins.mesh.arrays import BoolArray, FloatArray
from odt_plugins.mesh.simplex import SimplexMesh, freeze
from odt_plugins.options import Options

MOST_HELD, NEARLY_ALL = 0.3, 0.9
"""Part of the cells of the input from which on no more are held, and largest part that is held."""

FEW_SPOILED = 0.05
"""Part of the cells of the input up to which they stay, where the worst cells alone are spoiled,
before sizes give way."""

EXTREMES = frozenset({"min_quality", "min_angle", "max_angle", "min_altitude"})
"""Figures of the worst cell."""

ATTEMPTS = 4
"""Most times within one part; each holds the input around what those before spoiled."""

HARDLY_COARSER = 0.7
"""Part of the vertices of the input from which on good cells may become fewer, as poor ones do
not."""

CROWDED = {2: 200, 3: 20}
"""Multiple of the cells that are expected, or of those of the input, from which on none are split,
by dimension: a metric that differs a lot, needles in it along feature lines, and feature lines much
shorter than the sizes take more."""

MOST_GIVEN_WAY = 10
"""Multiple of the cells that are expected, or of those of the input, beyond which sizes do not give
way to those of a surface or of the input."""

NARROWER, NARROW = 0.2, 0.05
"""Part of its envelope that a surface may use where it cut through itself, or where it bounds a
small region whose volume became another, and largest part that becomes no smaller."""

CLOSE = 1.1
"""Multiple of the sizes of the input up to which sizes are no longer than those."""


class Attempt(NamedTuple):
    """What is resized, and how.

    Attributes
    ----------
    mesh : SimplexMesh      the input, with the cells frozen that stay
    sizes : Sizes
    parts : (n,) float64    of what surfaces may use of the envelope
    stuck : float           part of the vertices of the surface up to which it may stay finer
                            without sizes that give way to those it has reached
    share : float           of the envelope within which surfaces are resized, 0 where they stay
    why : str               what the attempt before broke of the promise, "" for the first
    full : int              cells to which they are filled up by good ones where figures are looked
                            at, see ``promise.good.filled_up``
    """

    mesh: SimplexMesh
    sizes: Sizes
    parts: FloatArray
    stuck: float
    share: float = 0.0
    why: str = ""
    full: int = 0


def told_apart(attempt: Attempt) -> bytes:
    """Tells attempts of one call apart that make another mesh: a hash."""
    mesh, sizes, parts, stuck, share, *_ = attempt
    digest = sha256(np.array([len(mesh.points), stuck, share]).tobytes())
    for values in (mesh.frozen, sizes.values, parts):
        digest.update(values.tobytes())
    return digest.digest()


def remedy(
    mesh: SimplexMesh, attempt: Attempt, outcome: Outcome, broken: Broken, options: Options,
) -> tuple[Attempt | None, bool]:
    """What to try next within the same share of the envelope, and whether figures fell.

    Parameters
    ----------
    mesh : SimplexMesh     the input
    attempt : Attempt      of which the outcome breaks the promise
    outcome : Outcome
    broken : Broken
    options : Options

    Returns
    -------
    Attempt or None        the first of these that is another: where figures fell, sizes that give
                           way; less of the envelope where the surface is wrong; cells that stay,
                           and sizes that fall from there
    bool
    """
    slides = attempt.share > 0.0
    far = np.zeros(len(mesh.points), dtype=np.bool_)
    if broken.kind is Kind.BEYOND:
        far = gone_astray(mesh, outcome, attempt.sizes, envelope_length(mesh, options) - mesh.sag)
    spoiled = np.asarray(far[mesh.cells].any(axis=1)) if far.any() else spoiled_cells(
        mesh, outcome, attempt.sizes, options, attempt.full)
    falls = not far.any() and _fallen(
        mesh, outcome, options, attempt.full, few=bool(0.0 < spoiled.mean() <= FEW_SPOILED))
    found = _other_sizes(
        mesh, attempt, spoiled, slides=slides, firm=broken.firm) if falls else None
    if found is None:
        small = of_small_regions(mesh, outcome)
        found = (_less_envelope(mesh, attempt, outcome, broken, far, small)
                 or _more_held(mesh, attempt, spoiled, small, falls=falls, slides=slides))
    return found, falls


def _fallen(
    mesh: SimplexMesh, outcome: Outcome, options: Options, full: int, *, few: bool
) -> bool:
    """Whether figures to be kept are worse than those of the input, and not good enough.

    Those of the worst cells do not count where these are few, near which the input may stay.
    """
    fallen = set(seen_figures(outcome, full).worse_than(
        allowed_figures(mesh, options, full), tuple(options.keep)))
    return bool(fallen - EXTREMES if few else fallen)


def _other_sizes(
    mesh: SimplexMesh, attempt: Attempt, spoiled: BoolArray, *, slides: bool, firm: bool
) -> Attempt | None:
    """Sizes that give way to those that the surface has reached, where that changes something, then
    to those of the input.
    """
    if slides and attempt.stuck and (attempt.sizes.values > CLOSE * local_sizes(mesh)).any():
        attempt = attempt._replace(stuck=0.0)
        if not firm:
            return attempt
    sizes = nearer(mesh, attempt.sizes, spoiled)
    return None if sizes is None else attempt._replace(sizes=sizes)


def _less_envelope(
    mesh: SimplexMesh, attempt: Attempt, outcome: Outcome, broken: Broken, far: BoolArray,
    small: BoolArray,
) -> Attempt | None:
    """Less of the envelope for vertices whose surface came beyond it or cuts through itself, or of
    small regions whose volume became another, unless it is little already.
    """
    near, least = (far, NARROW) if far.any() else (small, NARROWER)
    if broken.kind is Kind.CUT:
        near, least = newly_cut(mesh, outcome, attempt.sizes), NARROW
    if not near.any() or attempt.parts[near].min() <= least:
        return None
    return attempt._replace(parts=np.where(near, NARROWER * attempt.parts, attempt.parts))


def _more_held(
    mesh: SimplexMesh, attempt: Attempt, spoiled: BoolArray, small: BoolArray, *, falls: bool,
    slides: bool,
) -> Attempt | None:
    """Cells of the input that stay, spoiled ones and small regions, and sizes that fall from them.

    Where most would stay, sizes alone, if figures fell.
    """
    held = attempt.mesh
    spoiled = (spoiled | small[mesh.cells].all(axis=1)) & ~held.frozen
    more = spoiled.any() and held.frozen.mean() <= MOST_HELD and (
        spoiled | held.frozen).mean() <= NEARLY_ALL
    if more:
        held = freeze(held, held.frozen | spoiled)
    sizes = beside_whole(held, attempt.sizes, spoiled, slides=slides)
    if not more and not (falls and sizes):
        return None
    return attempt._replace(mesh=held, sizes=sizes or attempt.sizes)


def nearer(mesh: SimplexMesh, sizes: Sizes, spoiled: BoolArray) -> Sizes | None:
    """Sizes nearer to those of the input where cells (m,) are spoiled; None where none are longer.

    Halfway everywhere if none is spoiled. None, too, where too many cells would come.
    """
    own = local_sizes(mesh)
    longer = sizes.values > CLOSE * own
    if spoiled.any():
        there = np.zeros(len(own), dtype=np.bool_)
        there[mesh.cells[spoiled]] = True
        longer &= there
        most = np.where(longer, own, np.inf)
    else:
        most = np.where(longer, np.sqrt(own * sizes.values), np.inf)
    if not longer.any():
        return None
    found = sizes.below(mesh, most)
    return found if expected_cells(mesh, found.values) <= most_given_way(mesh, sizes) else None


def most_given_way(mesh: SimplexMesh, sizes: Sizes) -> float:
    """Cells, about, beyond which sizes do not give way."""
    return MOST_GIVEN_WAY * max(sizes.cells, len(mesh.cells))


def crowded(mesh: SimplexMesh, sizes: Sizes) -> float:
    """Cells from which on none are split."""
    return CROWDED[mesh.dim] * max(sizes.cells, len(mesh.cells))
