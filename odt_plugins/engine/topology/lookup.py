"""Where a number stands in a short list of numbers."""

from __future__ import annotations

from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.mesh.arrays import IntArray


@kernel
def is_in(value: int, values: IntArray, n: int) -> bool:
    """Whether the value is one of the first n; a literal n would have it compiled once more."""
    for m in range(n):
        if values[m] == value:
            return True
    return False


@kernel
def place_in(rows: IntArray, row: int, value: int) -> int:
    """Place of a value in a row that holds it, such as the local number of a cell's vertex."""
    last = rows.shape[1] - 1
    for place in range(last):
        if rows[row, place] == value:
            return place
    return last
