"""Distribution factors of side sets of Exodus files whose sides became others."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.formats.change import Change
from odt_plugins.adapters.formats.exodus_tables import side_of


def continued(
    given: NDArray[Any], count: int, sides: list[tuple[int, Any, Any]], change: Change, space: bool
) -> Any:
    """Factors at the nodes of sides, linear on the sides from which they come.

    They stay within the least and the largest factor of the set, and are bit for bit those of
    before at corners that did not move.

    Parameters
    ----------
    given : (count p,)           factors before, p for each side
    count : int                  how many sides there were
    sides : list of tuple        for each side now its place in the set before, the nodes of that
                                 side, and its nodes, those of its cell, type and number of side
    change : Change
    space : bool                 whether points have three coordinates

    Returns
    -------
    (len(sides) p,)      None where they differ and are not those of corners
    """
    if len(given) % count:
        return None
    table = given.reshape(count, -1)
    width = table.shape[1]
    out = table[[place for place, *_ in sides]]
    if not np.ptp(given) or width == 1:
        return out.ravel()
    if width > 3 or any(old is None or now is None or len(old) != width for _, old, now in sides):
        return None
    before = np.array([old for _, old, _ in sides])
    places = [side_of(kind, side, shell=space) for _, _, (_, _, kind, side) in sides]
    after = np.array([np.asarray(cell)[known[1]] for (_, _, (_, cell, *_)), known in zip(
        sides, places, strict=True) if known is not None])
    old, new = np.asarray(change.before.points)[before], np.asarray(change.after.points)[after]
    along = old[:, 1:] - old[:, :1]
    gram = np.einsum("eid,ejd->eij", along, along)
    right = np.einsum("end,ejd->enj", new - old[:, :1], along)
    slope = out[:, 1:] - out[:, :1]
    if width == 2:
        found = right[:, :, 0] * (slope / gram[:, 0])
    else:
        size = (gram[:, 0, 0] * gram[:, 1, 1] - gram[:, 0, 1] ** 2)[:, None]
        one = right[:, :, 0] * gram[:, 1, 1, None] - right[:, :, 1] * gram[:, 0, 1, None]
        two = right[:, :, 1] * gram[:, 0, 0, None] - right[:, :, 0] * gram[:, 0, 1, None]
        found = (one * slope[:, :1] + two * slope[:, 1:]) / size
    found = np.clip(out[:, :1] + found, given.min(), given.max())
    same = change.points[after][:, :, None] == before[:, None, :]
    known = same.any(axis=2) & ~change.moved[after]
    found[known] = np.take_along_axis(out, same.argmax(axis=2), axis=1)[known]
    return found.astype(given.dtype).ravel()
