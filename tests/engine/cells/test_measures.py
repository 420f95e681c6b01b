"""Cell measures of the objectives: closed forms, invariances, derivatives."""

from __future__ import annotations

import ast
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from tet_meshes import TWINS

from odt_plugins import engine
from odt_plugins.engine.cells import rows
from odt_plugins.engine.cells.cost import Cost
from odt_plugins.engine.cells.extremes import Extremes
from odt_plugins.engine.cells.measures import (
    DIHEDRAL,
    MEAN_RATIO,
    MEASURES,
    STEP,
    make_room,
    star_terms,
    tet_cost,
    tet_measure,
)
from odt_plugins.engine.record.figures import amips_energies, tet_extremes
from odt_plugins.figures import angles, radius_ratio
from odt_plugins.objectives import AIMS

REGULAR = np.array([[1, -1, -1], [1, 1, 1], [-1, 1, -1], [-1, -1, 1.0]])
CORNER = np.vstack([np.zeros(3), np.eye(3)])
EVEN = [p for p in permutations(range(4)) if np.linalg.det(np.eye(4)[list(p)]) > 0]

ALL = pytest.mark.parametrize("objective", TWINS, ids=["radius ratio", "mean ratio", "dihedral",
                                                            "step"])
IN_PYTHON = pytest.mark.usefixtures("nothing_compiled")
SHAPES = pytest.mark.parametrize("objective", [name for name in TWINS if name != STEP])


def terms(points, cells, cost):
    """Cost, gradient and Hessian in vertex 0 of its star, None where a cell is not positive."""
    room, cells = make_room(), np.array(cells, np.int32)
    indices = np.arange(len(cells), dtype=np.int32)
    good = star_terms(points, cells, indices, 0, len(cells), 0, cost, room)
    return room.star.copy() if good else None


def positive(seed, spread=0.4):
    """A tetrahedron of positive volume, not flat."""
    rng = np.random.default_rng(seed)
    while True:
        points = REGULAR + spread * rng.normal(size=(4, 3))
        if np.linalg.det(points[1:] - points[0]) > 1.0:
            return points


def test_extremes_of_slots_are_those_of_the_cells_in_them_alone():
    points = np.concatenate([positive(seed) for seed in range(200)])
    cells = np.arange(800, dtype=np.int32).reshape(-1, 4)
    live = np.arange(200) % 7 > 0
    slots = np.where(live[:, None], cells, -1).astype(np.int32)
    for start, stop in ((0, 200), (3, 150), (8, 9)):
        chosen = cells[start:stop][live[start:stop]]
        degrees = angles(points, chosen)
        found = Extremes(*tet_extremes(points, slots, start, stop))
        assert found.quality == pytest.approx(radius_ratio(points, chosen).min(), rel=1e-12)
        ends = np.degrees(np.arccos([found.large, found.small]))
        assert ends == pytest.approx([degrees.min(), degrees.max()], rel=1e-9)
    assert tet_extremes(points, slots, 0, 1)[0] > 1.0


@IN_PYTHON
@SHAPES
def test_regular_cell_is_one_and_no_cell_is_more(objective):
    assert tet_measure(REGULAR, 0, 1, 2, 3, objective) == pytest.approx(1.0, abs=1e-14)
    for seed in range(300):
        points = positive(seed, spread=0.02 if seed % 2 else 1.0)
        assert tet_measure(points, 0, 1, 2, 3, objective) < 1.0


@IN_PYTHON
@ALL
def test_cells_that_are_not_positive_are_told(objective, monkeypatch):
    # The square roots of NumPy may be divided by where they are zero, as those of kernels.
    monkeypatch.setattr(rows, "math", np)
    assert tet_measure(REGULAR, 1, 0, 2, 3, objective) < 0
    flat = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.0]])
    assert tet_measure(flat, 0, 1, 2, 3, objective) <= 0
    assert tet_measure(np.zeros((4, 3)), 0, 1, 2, 3, objective) <= 0
    assert tet_cost(REGULAR, 1, 0, 2, 3, Cost(objective, 2.0)) == np.inf
    for points, order in ((REGULAR, (1, 0, 2, 3)), (flat, (0, 1, 2, 3)),
                          (np.zeros((4, 3)), (0, 1, 2, 3))):
        assert terms(points, [order], Cost(objective, 2.0)) is None


@IN_PYTHON
def test_right_angled_corner():
    # dihedral angles: three of 90 degrees, three with the tangent sqrt(2)
    m = 1.125 * ((3 + 3 * 1.5**4) / 6) ** -0.25
    assert tet_measure(CORNER, 0, 1, 2, 3, DIHEDRAL) == pytest.approx(m, rel=1e-14)
    # E = half the sum of squared edges over (sqrt(2) det)^(2/3)
    e = 4.5 / 2 ** (1 / 3)
    assert tet_measure(CORNER, 0, 1, 2, 3, MEAN_RATIO) == pytest.approx((3 / e) ** 3, rel=1e-14)
    # altitudes: three of 1, one of 1 / sqrt(3)
    assert tet_measure(CORNER, 0, 1, 2, 3, STEP) == pytest.approx(6**-0.125, rel=1e-14)
    both = np.vstack([REGULAR, CORNER]), np.arange(8, dtype=np.int32).reshape(2, 4)
    assert amips_energies(*both) == pytest.approx([3.0, e], rel=1e-14)


@IN_PYTHON
@ALL
@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 10**6), scale=st.floats(1e-3, 1e3))
def test_measure_agrees_with_its_twin_and_is_invariant(objective, seed, scale):
    points = positive(seed)
    m = tet_measure(points, 0, 1, 2, 3, objective)
    assert m == pytest.approx(TWINS[objective](points, np.arange(4)[None])[0], rel=1e-9)
    for order in EVEN:
        assert tet_measure(points, *order, objective) == pytest.approx(m, rel=1e-10)
    turn = Rotation.random(random_state=seed).as_matrix()
    moved = scale * (points @ turn.T + [1.0, -2.0, 3.0])
    m *= scale**0.25 if objective == STEP else 1.0
    assert tet_measure(moved, 0, 1, 2, 3, objective) == pytest.approx(m, rel=1e-9)


@IN_PYTHON
@ALL
@pytest.mark.parametrize("power", [1 / 3, 2.0, 8.0])
@pytest.mark.parametrize("seed", range(6))
def test_gradient_and_hessian_of_the_cost_agree_with_differences(objective, power, seed):
    points = positive(seed)
    cell = np.arange(4)[None]

    def f(x):
        m = TWINS[objective](np.vstack([x, points[1:]]), cell)[0]
        return (1.005 / (m + 0.005)) ** power

    out = terms(points, [[0, 1, 2, 3]], Cost(objective, power))
    x = points[0]
    h = 2e-4
    unit = np.eye(3) * h
    gradient = [(f(x + e) - f(x - e)) / (2 * h) for e in unit]
    hessian = [[(f(x + a + b) - f(x + a - b) - f(x - a + b) + f(x - a - b)) / (4 * h * h)
                for a in unit] for b in unit]
    assert out[0] == pytest.approx(f(x), rel=1e-10)
    assert out[1:4] == pytest.approx(gradient, abs=1e-5 * np.abs(gradient).max())
    packed = np.array(hessian)[np.triu_indices(3)]
    assert out[4:] == pytest.approx(packed, abs=1e-4 * np.abs(packed).max())


@IN_PYTHON
@ALL
def test_costs_of_a_star_add_up(objective):
    points, other = positive(1), positive(2)
    other[0] = points[0]
    both, cost = np.vstack([points, other[1:]]), Cost(objective, 2.0)
    alone = [terms(x, [[0, 1, 2, 3]], cost) for x in (points, other)]
    together = terms(both, [[0, 1, 2, 3], [0, 4, 5, 6]], cost)
    assert together == pytest.approx(sum(alone), rel=1e-12)


def compared(path):
    """Lines of a file that compare something with the number of a measure."""
    numbers = {"ENERGY", "QUALITY", "MEAN_RATIO", "DIHEDRAL", "STEP"}
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Compare):
            names = {n.id for n in ast.walk(node) if isinstance(n, ast.Name)}
            if names & numbers:
                yield node.lineno


def test_nobody_but_the_table_asks_which_measure_it_is():
    table = {"cost.py", "measures.py"}
    asking = {path.name for path in Path(engine.__file__).parent.rglob("*.py") if [*compared(path)]}
    assert asking == table
    assert MEASURES.keys() == AIMS.keys()
    assert set(MEASURES.values()) == set(TWINS)
