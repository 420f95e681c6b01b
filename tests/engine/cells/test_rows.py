"""Several tetrahedra in rows against the kernels for one, which say what they are to give."""

from __future__ import annotations

import numpy as np
import pytest

from odt_plugins.engine.cells import rows as r
from odt_plugins.engine.cells.corner import corner_edges
from odt_plugins.engine.cells.cost import Cost
from odt_plugins.engine.cells.dihedral import tet_dihedral
from odt_plugins.engine.cells.measures import QUALITY, make_room, star_terms
from odt_plugins.engine.cells.step import tet_altitude
from odt_plugins.engine.cells.tetrahedron import tet_cosines, tet_quality


def some_cells(count=r.CHUNK):
    """Random tetrahedra, inverted ones and a flat one among them, and a free slot."""
    rng = np.random.default_rng(3)
    points = rng.random((4 * count, 3))
    points[:4] = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]
    cells = rng.permutation(4 * count).astype(np.int32).reshape(count, 4)
    cells[7] = [0, 1, 2, 3]
    cells[9, 0] = -1
    return points, cells


@pytest.mark.usefixtures("nothing_compiled")
def test_shapes_in_rows_are_those_of_the_single_cells_bit_for_bit():
    points, cells = some_cells()
    room = np.empty(r.ROWS)
    r.gather_edges(points, cells, np.arange(len(cells)), 0, len(cells), room)
    r.dihedral_rows(len(cells), room)
    found = [room[r.Q : r.Q + r.CHUNK].copy()]
    r.quality_rows(0.0, 0.0, 0.0, len(cells), room)
    r.shape_rows(len(cells), room)
    found += [room[k : k + r.CHUNK] for k in (r.Q, r.LARGE, r.SMALL, r.ALTITUDE)]
    signs = set()
    for c, cell in enumerate(cells):
        if cell[0] < 0:
            continue
        edges = corner_edges(points, *cell)
        own = (tet_dihedral(edges), tet_quality(points, *cell), *tet_cosines(edges),
               tet_altitude(edges))
        signs.add(np.sign(own[1]))
        assert [row[c] for row in found] == list(own)
    assert {-1.0, 1.0} <= signs <= {-1.0, 0.0, 1.0}


@pytest.mark.usefixtures("nothing_compiled")
@pytest.mark.parametrize("count", [20, 2 * r.CHUNK + 3])
@pytest.mark.parametrize("power", [0.5, 2.0, 3.0])
def test_a_star_has_the_cost_and_derivatives_of_its_cells(power, count):
    rng = np.random.default_rng(5)
    points = np.concatenate([[[0.1, 0.2, 0.1]], rng.standard_normal((3 * count, 3))])
    cells = rng.permutation(np.arange(1, 3 * count + 1)).reshape(count, 3).astype(np.int32)
    cells = np.column_stack([np.zeros(count, dtype=np.int32), cells])
    negative = np.linalg.det(points[cells[:, 1:]] - points[0]) < 0
    cells[negative, 2:] = cells[negative, :1:-1]
    for turn in range(4):
        cells[turn::4] = cells[turn::4][:, [[0, 1, 2, 3], [1, 0, 3, 2], [2, 3, 0, 1],
                                            [3, 2, 1, 0]][turn]]
    room, indices, alone = make_room(), np.arange(count, dtype=np.int32), np.zeros(10)
    for s in range(count):
        assert star_terms(points, cells, indices, s, s + 1, 0, Cost(QUALITY, power), room)
        alone += room.star
    assert star_terms(points, cells, indices, 0, count, 0, Cost(QUALITY, power), room)
    assert room.star == pytest.approx(alone, rel=1e-11)
    cells[-1, [1, 2]] = cells[-1, [2, 1]]
    assert not star_terms(points, cells, indices, 0, count, 0, Cost(QUALITY, power), room)
