"""What a mesh is worth to a finite element computation: the Poisson problem on it."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np

from odt_plugins.compare.start import StartMesh
from odt_plugins.report.worth import Operator, conjugate_gradients


@dataclass(frozen=True)
class PoissonFigures:
    """Linear elements for -div grad u = f with u given on the boundary.

    Attributes
    ----------
    unknowns : int
    condition : float         of the stiffness matrix of the inner vertices, estimated from the
                              coefficients of CG (Lanczos)
    cg_steps : int            plain CG from zero to a relative residual of 1e-8
    amg_steps : int           CG preconditioned with smoothed aggregation of pyamg
    l2_error, h1_error : float    distance to the known solution, relative to its own norm;
                              H1 the seminorm
    """

    unknowns: int
    condition: float
    cg_steps: int
    amg_steps: int
    l2_error: float
    h1_error: float


def solve_poisson(mesh: StartMesh, frame: StartMesh) -> PoissonFigures | None:
    """Solve the problem on a mesh; None on a surface or without inner vertices.

    Parameters
    ----------
    mesh : StartMesh     every cell positive
    frame : StartMesh    mesh whose bounding box scales the known solution, the start of all

    Raises
    ------
    ImportError          scikit-fem is not installed

    Notes
    -----
    The solution is a product of sin(2 y), cos(y) and exp(y) in the coordinates y = (x - low) /
    longest side * pi / 2, so that f = 4 u in space and 5 u in the plane.
    """
    if mesh.kind == "surface":
        return None
    import skfem
    from skfem.helpers import dot, grad

    flat = mesh.kind == "planar"
    shape = skfem.MeshTri if flat else skfem.MeshTet
    element = skfem.ElementTriP1() if flat else skfem.ElementTetP1()
    used, cells = np.unique(mesh.cells, return_inverse=True)
    cells = cells.reshape(mesh.cells.shape)
    low, side = frame.points.min(axis=0), np.ptp(frame.points, axis=0).max()
    points = (mesh.points[used] - low) / side * (np.pi / 2)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        grid = shape(np.ascontiguousarray(points.T), np.ascontiguousarray(cells.T))
        basis = skfem.Basis(grid, element, intorder=4)
    factor = 5.0 if flat else 4.0
    stiffness = skfem.BilinearForm(lambda u, v, w: dot(grad(u), grad(v))).assemble(basis).tocsr()
    load = skfem.LinearForm(lambda v, w: factor * _exact(w.x) * v).assemble(basis)
    rim = np.asarray(grid.boundary_nodes())
    inner = np.setdiff1d(np.arange(len(points)), rim)
    if not len(inner):
        return None
    solution = _exact(points.T)
    matrix = stiffness[inner][:, inner].tocsr()
    right = load[inner] - stiffness[inner][:, rim] @ solution[rim]
    x, steps, condition = conjugate_gradients(matrix, right)
    amg_steps = conjugate_gradients(matrix, right, _multigrid(matrix))[1]
    solution[inner] = x
    at = basis.interpolate(solution)
    l2 = skfem.Functional(lambda w: (w["u"] - _exact(w.x)) ** 2).assemble(basis, u=at)
    h1 = skfem.Functional(lambda w: sum((w["u"].grad[i] - g) ** 2 for i, g
                                        in enumerate(_gradient(w.x)))).assemble(basis, u=at)
    norm2 = skfem.Functional(lambda w: _exact(w.x) ** 2).assemble(basis)
    norm1 = skfem.Functional(lambda w: sum(g**2 for g in _gradient(w.x))).assemble(basis)
    return PoissonFigures(len(inner), condition, steps, amg_steps, float(np.sqrt(l2 / norm2)),
                          float(np.sqrt(h1 / norm1)))


def _exact(y: Any) -> Any:
    u = np.sin(2.0 * y[0]) * np.cos(y[1])
    return u * np.exp(y[2]) if len(y) == 3 else u


def _gradient(y: Any) -> list[Any]:
    rest = np.exp(y[2]) if len(y) == 3 else 1.0
    parts = [2.0 * np.cos(2.0 * y[0]) * np.cos(y[1]) * rest,
             -np.sin(2.0 * y[0]) * np.sin(y[1]) * rest]
    return [*parts, _exact(y)] if len(y) == 3 else parts


def _multigrid(matrix: Any) -> Operator:
    import pyamg

    setup: Any = pyamg.smoothed_aggregation_solver
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        # The eigenvalues that pyamg estimates start from numpy's global generator.
        state = np.random.get_state()  # noqa: NPY002
        np.random.seed(0)  # noqa: NPY002
        try:
            hierarchy = setup(matrix)
        finally:
            np.random.set_state(state)  # noqa: NPY002
    operator = hierarchy.aspreconditioner(cycle="V")
    return lambda r: np.asarray(operator @ r)
