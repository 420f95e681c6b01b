"""The same bits for any number of threads and columns, whatever BLAS and numpy do inside."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import SEEDS

import odt_plugins
from odt_plugins.engine.cells import elementary
from odt_plugins.mesh.simplex import barycentric, determinant, diagonal

PACKAGE = Path(odt_plugins.__file__).parent

APART = ("compare/", "generate/clouds.py", "report/plotting.py", "report/worth.py")
"""Tables, charts, pictures, what a solver gains, and start meshes: no result is made there."""

ALLOWED = {
    "mesh/bernstein.py": {"@", "np.linalg.inv"},
    "mesh/cell_geometry.py": {"arctan2", "cbrt"},
    "engine/odt/multigrid.py": {"@"},
    "engine/untangle/harmonic.py": {"@"},
    "engine/odt/descent.py": {"scipy.optimize"},
    "engine/untangle/vertices.py": {"scipy.optimize"},
    "generate/stages.py": {"find_simplex"},
}
"""Bounds of Jacobians, which are certified; angles and energies that are reported; products of
sparse matrices, which do not go through BLAS; the L-BFGS of scipy, which does; linear programs of
HiGHS, which do not; and a search whose answer rounding hardly ever changes."""

PRODUCTS = {"dot", "matmul", "vdot", "vecdot", "inner", "tensordot", "multi_dot", "kron", "cov",
            "corrcoef", "correlate", "convolve", "polyfit", "find_simplex"}
WIDE = {"exp", "exp2", "expm1", "log", "log2", "log10", "log1p", "sin", "cos", "tan", "arcsin",
        "arccos", "arctan", "arctan2", "cbrt", "sinh", "cosh", "tanh", "power", "float_power"}
"""Functions of numpy that take other instructions on other processors."""

LIBRARIES = ("scipy.linalg", "scipy.sparse.linalg", "scipy.optimize")


def names_in(node: ast.AST) -> Iterator[str]:
    """Give the names of ``a.b.c`` from the last one to the second."""
    while isinstance(node, ast.Attribute):
        yield node.attr
        node = node.value


def uses(node: ast.AST) -> str:
    """What a node does that another processor may do with another last bit, or nothing."""
    if isinstance(node, ast.BinOp | ast.AugAssign) and isinstance(node.op, ast.MatMult):
        return "@"
    if isinstance(node, ast.ImportFrom) and node.module in LIBRARIES:
        return node.module
    if isinstance(node, ast.Attribute):
        text = ast.unparse(node) if {*names_in(node)} & {*PRODUCTS, *WIDE, "linalg"} else ""
        if node.attr in PRODUCTS or (text.startswith("np.") and node.attr in WIDE):
            return node.attr
        if text == f"np.linalg.{node.attr}" and node.attr != "norm":
            return text
    if isinstance(node, ast.Call) and {*names_in(node.func)} & {"norm", "einsum"}:
        given = {keyword.arg for keyword in node.keywords}
        called = ast.unparse(node.func)
        if called == "np.linalg.norm" and "axis" not in given:
            return "norm without axis"
        if called == "np.einsum" and "optimize" in given:
            return "einsum with optimize"
    return ""


def test_nothing_that_becomes_part_of_a_mesh_goes_through_blas():
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        name = path.relative_to(PACKAGE).as_posix()
        if name.startswith(APART):
            continue
        tree = ast.parse(path.read_text(encoding="utf-8"))
        used = {uses(node) for node in ast.walk(tree)} - {""}
        if used:
            found[name] = used
    assert found == ALLOWED


@pytest.mark.parametrize("text", [
    "a @ b", "a @= b", "a.dot(b)", "np.linalg.det(a)", "np.linalg.norm(a)", "np.exp(a)",
    "np.einsum('ij,ij->', a, b, optimize=True)", "from scipy.sparse.linalg import splu",
])
def test_what_goes_through_blas_is_seen(text):
    assert any(uses(node) for node in ast.walk(ast.parse(text)))


RUNS = """
import hashlib
import odt_plugins
from measure.hard import shaken
import numpy as np
digest = hashlib.sha256()
rng = np.random.default_rng(5)
for d, n in ((2, 600), (3, 500)):
    mesh = shaken(rng, d, n)
    for options in ({}, {"smoothing": {"solver": "global", "linear_solver": "amg", "rounds": 3}},
                    {"smoothing": {"solver": "global", "linear_solver": "direct", "rounds": 3}},
                    {"objective": "min_dihedral"}):
        for part in odt_plugins.optimize(mesh, **options):
            digest.update(part.tobytes())
print(digest.hexdigest())
"""


def wide_instructions() -> str:
    """What numpy may use on this machine beyond the least that it is built for."""
    umath = (np._core if hasattr(np, "_core") else np.core)._multiarray_umath
    return " ".join(name for name in umath.__cpu_dispatch__ if umath.__cpu_features__[name])


def test_bits_depend_neither_on_blas_nor_on_the_instructions_of_numpy():
    hashes = set()
    for setting in ({}, {"OPENBLAS_CORETYPE": "Prescott", "OPENBLAS_NUM_THREADS": "1"},
                    {"OPENBLAS_CORETYPE": "Nehalem", "OPENBLAS_NUM_THREADS": "2",
                     "NPY_DISABLE_CPU_FEATURES": wide_instructions()}):
        done = subprocess.run([sys.executable, "-c", RUNS], env=os.environ | setting, check=True,
                              capture_output=True, text=True, timeout=200,
                              cwd=Path(__file__).parents[2])
        hashes.add(done.stdout)
    assert len(hashes) == 1


NUMBERS = st.lists(st.floats(1e-30, 1e30), min_size=1, max_size=8)


@given(NUMBERS, st.floats(-3.0, 3.0))
def test_elementary_functions_are_those_of_numpy_to_rounding(values, exponent):
    x = np.array(values)
    before = x.copy()
    for mine, wide in ((elementary.log(x), np.log(x)),
                       (elementary.exp(-np.log(x)), np.exp(-np.log(x))),
                       (elementary.power(x, exponent), x**exponent),
                       (elementary.arccos(1.0 / (1.0 + x)), np.arccos(1.0 / (1.0 + x)))):
        assert mine == pytest.approx(wide, rel=1e-14, abs=1e-14)
    assert np.array_equal(x, before)


def test_elementary_functions_keep_the_shape_and_take_zero():
    x = np.arange(6.0).reshape(3, 2).T
    assert elementary.power(x, 2.0).tolist() == (x * x).tolist()
    assert elementary.log(np.zeros(1)).tolist() == [-np.inf]


@given(st.sampled_from([2, 3]), SEEDS)
def test_determinants_and_barycentric_coordinates(d, seed):
    rng = np.random.default_rng(seed)
    corners = rng.normal(size=(20, 5, d + 1, d))
    weights = rng.dirichlet(np.ones(d + 1), size=(20, 5))
    x = (weights[..., None] * corners).sum(axis=-2)
    matrices = rng.normal(size=(7, d, d))
    assert determinant(np.moveaxis(matrices, 0, 2)) == pytest.approx(np.linalg.det(matrices))
    assert barycentric(corners, x) == pytest.approx(weights, abs=1e-6)
    corners[3, 2, -1] = corners[3, 2, 0]
    found = barycentric(corners, x)
    assert (found[3, 2] == -np.inf).all()
    assert np.isfinite(found).sum() == found.size - (d + 1)
    # Cramer's rule gives infinities of both signs there.
    flat = np.array([[0.0, 0], [1, 0], [2, 0]]) if d == 2 else np.eye(4, 3)[[3, 0, 1, 1]]
    assert (barycentric(flat, np.full(d, 0.7)) == -np.inf).all()


def test_diagonal_of_a_box(d):
    points = np.array([[0.0] * d, [3.0, 4.0, 12.0][:d], [1.0] * d])
    assert diagonal(points) == {2: 5.0, 3: 13.0}[d]
