"""What a name that nobody knows may have been meant for."""

from __future__ import annotations

import difflib
from collections.abc import Collection, Iterable

MEANT = {
    "iterations": "rounds", "iters": "rounds", "niter": "rounds", "passes": "rounds",
    "edge_length": "size", "hsiz": "size", "targetlen": "size", "target_edge_length": "size",
    "hausd": "envelope", "maxsurfdist": "envelope", "tolerance": "envelope",
    "ar": "feature_angle", "featuredeg": "feature_angle", "hgrad": "growth",
    "jobs": "threads", "verbose": "progress",
    "measure": "quality", "info": "quality", "check": "quality", "smooth": "optimize",
    "improve": "optimize", "refine": "remesh", "coarsen": "remesh", "decimate": "remesh",
    "repair": "untangle",
}
"""Words of mmg, MeshLab and others, and the names that things of this kind have here."""

PART = 4
"""Letters of a word from which on a name that has it is meant."""

CLOSE = 0.8
"""Likeness from which on a name that stands elsewhere is meant."""


def meant(unknown: str, known: Iterable[str], elsewhere: Collection[str] = ()) -> str:
    """Name that is nearest to an unknown one, or nothing.

    Parameters
    ----------
    unknown : str
    known : names        that may take its place
    elsewhere : names    that mean something, but stand at another place
    """
    if unknown in elsewhere:
        return unknown
    names = sorted(known)
    whole = [name for name in names if len(unknown) >= PART and unknown in name]
    if whole:
        return min(whole, key=len)
    other = MEANT.get(unknown, "")
    if other in names or other in elsewhere:
        return other
    near = difflib.get_close_matches(unknown, [*names, *elsewhere], n=1)
    if near and near[0] not in names and (
            difflib.SequenceMatcher(None, unknown, near[0]).ratio() < CLOSE):
        near = difflib.get_close_matches(unknown, names, n=1)
    return near[0] if near else ""
