"""What a solver gains by a better mesh: condition, steps of CG, stable time step; by scikit-fem."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np

from odt_plugins.errors import UnsupportedMeshError, require
from odt_plugins.figures import cell_figures
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.table import text_html

TOLERANCE = 1e-8
"""Relative residual at which CG stops."""

MOST_STEPS = 5000
"""Of CG; a mesh that needs more has no condition worth a figure."""

Operator = Callable[[FloatArray], FloatArray]

HEADINGS = {"unknowns": "unknowns", "condition": "condition number", "cg_steps": "steps of CG",
            "time_step": "time step", "critical_step": "critical step"}


@dataclass(frozen=True)
class Solved:
    """Linear elements on one mesh, u = 0 on its boundary; all but the unknowns are NaN where cells
    are inverted or flat.

    Attributes
    ----------
    unknowns : int            vertices inside
    condition : float         of the Laplacian's stiffness matrix, estimated from the coefficients
                              of CG (Lanczos); 1 without unknowns
    cg_steps : int or NaN     plain conjugate gradients for -div grad u = 1, from zero to a relative
                              residual of 1e-8
    time_step : float         of explicit dynamics with wave speed 1, as its codes choose it: the
                              least altitude of a cell
    critical_step : float     largest step for which central differences with lumped masses are
                              stable without boundary conditions: 2 / sqrt(lambda), lambda the
                              greatest eigenvalue of K u = lambda M u
    """

    unknowns: int
    condition: float
    cg_steps: float
    time_step: float
    critical_step: float


@dataclass(frozen=True)
class Worth:
    """What a solver needs before and after; printed, a table."""

    before: Solved
    after: Solved

    @property
    def faster(self) -> float:
        """How many times as long the time step is as before."""
        return self.after.time_step / self.before.time_step

    def __str__(self) -> str:
        """A table, one row per figure."""
        rows = [f"{'':<20}{'before':>12}{'after':>12}"]
        for field in fields(Solved):
            old, new = (getattr(mesh, field.name) for mesh in (self.before, self.after))
            rows.append(f"{HEADINGS[field.name]:<20}{old:>12.4g}{new:>12.4g}"
                        if isinstance(old, float) else
                        f"{HEADINGS[field.name]:<20}{old:>12}{new:>12}")
        return "\n".join(rows)

    def _repr_html_(self) -> str:
        """The same for a notebook."""
        return text_html(str(self))

    def to_dict(self) -> dict[str, Any]:
        """Give both as plain numbers; None if not finite."""
        return {mesh: {name: value if np.isfinite(value) else None for name, value in told.items()}
                for mesh, told in asdict(self).items()}


def solved(points: FloatArray, cells: IntArray) -> Solved:
    """Assemble and solve on a mesh of tetrahedra, or of triangles in the plane.

    Parameters
    ----------
    points : (n, d) float64, cells : (m, d + 1) int

    Raises
    ------
    UnsupportedMeshError      triangles of a curved surface
    MissingDependencyError    scikit-fem is not installed

    References
    ----------
    T. J. R. Hughes, The Finite Element Method (1987), Sections 9.2 and 9.3, for the steps.
    """
    if cells.shape[1] == points.shape[1]:
        msg = ("got triangles of a curved surface, on which there is no such problem; expected "
               "tetrahedra or triangles in the plane, try report.after for its figures")
        raise UnsupportedMeshError(msg)
    require("worth()", "compare", "skfem")
    figures = cell_figures(points, cells)
    with np.errstate(all="ignore"):
        stiffness, masses, load, rim = _assembled(points, cells)
    inner = np.setdiff1d(np.arange(len(masses)), rim)
    if not (figures.volume > 0.0).all():
        return Solved(len(inner), *4 * [float("nan")])
    steps, condition = 0, 1.0
    if len(inner):
        matrix = stiffness[inner][:, inner].tocsr()
        _, steps, condition = conjugate_gradients(matrix, load[inner])
    least = float(figures.altitude.min())
    return Solved(len(inner), condition, steps, least, _critical_step(stiffness, masses))


def _assembled(points: FloatArray, cells: IntArray) -> tuple[Any, FloatArray, FloatArray, Any]:
    """Stiffness matrix, lumped masses and load of the vertices in use, and those on the rim."""
    import skfem
    from skfem.helpers import dot, grad

    flat = cells.shape[1] == 3
    used, rows = np.unique(cells, return_inverse=True)
    rows = rows.reshape(cells.shape)
    shape = skfem.MeshTri if flat else skfem.MeshTet
    grid = shape(np.ascontiguousarray(points[used].T), np.ascontiguousarray(rows.T))
    basis = skfem.Basis(grid, skfem.ElementTriP1() if flat else skfem.ElementTetP1())
    stiffness = skfem.BilinearForm(lambda u, v, w: dot(grad(u), grad(v))).assemble(basis).tocsr()
    load = np.asarray(skfem.LinearForm(lambda v, w: 1.0 * v).assemble(basis))
    # The row sums of the mass matrix, since the hat functions add up to 1.
    return stiffness, load, load, np.asarray(grid.boundary_nodes())


def _critical_step(stiffness: Any, masses: FloatArray) -> float:
    from scipy.sparse import dia_array
    from scipy.sparse.linalg import eigsh

    scale: Any = dia_array((1.0 / np.sqrt(masses)[None], [0]), shape=(len(masses), len(masses)))
    start = np.random.default_rng(0).normal(size=len(masses))
    matrix = scale @ stiffness @ scale
    greatest = (np.linalg.eigvalsh(matrix.toarray()).max() if len(masses) < 20 else
                eigsh(matrix, k=1, which="LA", v0=start, tol=1e-6, return_eigenvectors=False)[0])
    return float(2.0 / np.sqrt(greatest))


def conjugate_gradients(
    matrix: Any, right: FloatArray, precondition: Operator | None = None
) -> tuple[FloatArray, int, float]:
    """Preconditioned conjugate gradients from zero.

    Parameters
    ----------
    matrix : (n, n) sparse, symmetric positive definite
    right : (n,) float64
    precondition : callable    r -> approximate solution

    Returns
    -------
    x : (n,) float64
    steps : int                to a relative residual of TOLERANCE; MOST_STEPS if it is not reached
    condition : float          ratio of the extreme eigenvalues of the Lanczos matrix

    References
    ----------
    Y. Saad, Iterative Methods for Sparse Linear Systems, 2nd ed., Sections 6.7.1 and 6.7.3.
    """
    from scipy.linalg import eigvalsh_tridiagonal

    x, r = np.zeros_like(right), right.copy()
    target = TOLERANCE * float(np.linalg.norm(right))
    z = r if precondition is None else precondition(r)
    p, rz = z.copy(), float(r @ z)
    alphas: list[float] = []
    betas: list[float] = []
    while float(np.linalg.norm(r)) > target and len(alphas) < MOST_STEPS:
        q = matrix @ p
        alpha = rz / float(p @ q)
        x += alpha * p
        r -= alpha * q
        z = r if precondition is None else precondition(r)
        old, rz = rz, float(r @ z)
        alphas.append(alpha)
        betas.append(rz / old)
        p = z + betas[-1] * p
    if not alphas:
        return x, 0, 1.0
    a, b = np.array(alphas), np.array(betas)
    diagonal = 1.0 / a
    diagonal[1:] += b[:-1] / a[:-1]
    values = eigvalsh_tridiagonal(diagonal, np.sqrt(b[:-1]) / a[:-1])
    return x, len(alphas), float(values[-1] / values[0])
