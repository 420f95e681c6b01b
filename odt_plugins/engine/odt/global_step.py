"""The global step, Section 4.3: one M-matrix in place of the Hessian for all d components."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Literal

import numpy as np

from odt_plugins.engine.cells.geometry import signed_volumes
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.odt.cholesky import solve_direct
from odt_plugins.engine.odt.density import cell_density, inverse_volume_density
from odt_plugins.engine.odt.multigrid import solve_amg
from odt_plugins.engine.odt.sweeps import HALVINGS, StepStats, guarded_move, move_stats
from odt_plugins.engine.odt.total_energy import frozen_energy
from odt_plugins.engine.topology.star import OffsetArray
from odt_plugins.engine.topology.stencil import Topology
from odt_plugins.errors import InvalidOptionError
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray


@kernel
def _add_pulls(
    points: FloatArray,
    cells: IntArray,
    rho: FloatArray,
    barycentric: BoolArray,
    out: FloatArray,
) -> None:
    """Add rho_tau |tau| (x_i - c_tau) of every cell to its vertices.

    Offsets are taken from x_0. With the other corners a, b, e and det = d! |tau|,
    c - x_0 = moment / (2 det): |tau| cancels the division, so flat cells do no harm.
    """
    m, k = cells.shape
    d = k - 1
    for t in range(m):
        o = cells[t, 0]
        j = cells[t, 1]
        n = cells[t, 2]
        central = barycentric[o] or barycentric[j] or barycentric[n]
        ax, ay = points[j, 0] - points[o, 0], points[j, 1] - points[o, 1]
        bx, by = points[n, 0] - points[o, 0], points[n, 1] - points[o, 1]
        aa = ax * ax + ay * ay
        bb = bx * bx + by * by
        if d == 2:
            scale = 0.5 * rho[t]
            det = ax * by - ay * bx
            if central:
                cx, cy = det * (ax + bx) / 3.0, det * (ay + by) / 3.0
            else:
                cx, cy = 0.5 * (aa * by - bb * ay), 0.5 * (bb * ax - aa * bx)
            cz = 0.0
        else:
            last = cells[t, 3]
            central = central or barycentric[last]
            az, bz = points[j, 2] - points[o, 2], points[n, 2] - points[o, 2]
            ex, ey = points[last, 0] - points[o, 0], points[last, 1] - points[o, 1]
            ez = points[last, 2] - points[o, 2]
            aa += az * az
            bb += bz * bz
            ee = ex * ex + ey * ey + ez * ez
            px, py, pz = by * ez - bz * ey, bz * ex - bx * ez, bx * ey - by * ex
            qx, qy, qz = ey * az - ez * ay, ez * ax - ex * az, ex * ay - ey * ax
            rx, ry, rz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
            scale = rho[t] / 6.0
            det = ax * px + ay * py + az * pz
            if central:
                cx = 0.25 * det * (ax + bx + ex)
                cy = 0.25 * det * (ay + by + ey)
                cz = 0.25 * det * (az + bz + ez)
            else:
                cx = 0.5 * (aa * px + bb * qx + ee * rx)
                cy = 0.5 * (aa * py + bb * qy + ee * ry)
                cz = 0.5 * (aa * pz + bb * qz + ee * rz)
        for corner in range(k):
            v = cells[t, corner]
            out[v, 0] += scale * (det * (points[v, 0] - points[o, 0]) - cx)
            out[v, 1] += scale * (det * (points[v, 1] - points[o, 1]) - cy)
            if d == 3:
                out[v, 2] += scale * (det * (points[v, 2] - points[o, 2]) - cz)


def step_gradient(
    points: FloatArray,
    topology: Topology,
    rho_tau: FloatArray,
    method: Literal["odt", "cpt"],
    boundary_rule: bool,
) -> FloatArray:
    """Gradient that drives a step: (4.11) for "odt", (4.19) for "cpt".

    With the boundary rule of Section 4.2.1 boundary elements use barycenters in "odt" too.

    Parameters
    ----------
    points : (n, d) float64
    topology : Topology
    rho_tau : (m,) float64          density of every cell
    method : {"odt", "cpt"}
    boundary_rule : bool

    Returns
    -------
    (n, d) float64                  2/(d + 1) sum_tau (x_i - c_tau) rho_tau |tau|
    """
    if method == "odt" and boundary_rule:
        barycentric = topology.is_boundary
    else:
        barycentric = np.full(len(points), method == "cpt")
    out = np.zeros_like(points)
    rho_tau = np.ascontiguousarray(rho_tau, dtype=np.float64)
    _add_pulls(points, topology.cells, rho_tau, barycentric, out)
    out *= 2.0 / topology.cells.shape[1]
    return out


LONGEST = 2.0
"""Most that alpha is lengthened to where the energy is least along a step."""

LinearSolve = Callable[[Any, FloatArray], FloatArray]
Objective = Callable[[FloatArray], float]

DIRECT_LIMIT = 2000
"""Unknowns up to which "auto" factorises. Fill-in grows like n^(4/3) in space: multigrid is faster
from 600 unknowns on, and from 4000 in the plane; below the limit that is milliseconds."""


@kernel
def _fill_rows(
    cells: IntArray,
    star_indptr: OffsetArray,
    star_indices: IntArray,
    weights: FloatArray,
    slot: OffsetArray,
    indptr: IntArray,
    indices: IntArray,
    data: FloatArray,
) -> None:
    """Rows of the matrix (4.25), (4.26), diagonal first; slot[j] is where j stands in the row."""
    k = cells.shape[1]
    scale = 2.0 / ((k - 1) * k)
    end = 0
    for i in range(star_indptr.shape[0] - 1):
        begin = end
        indices[end] = i
        data[end] = 0.0
        end += 1
        for s in range(star_indptr[i], star_indptr[i + 1]):
            c = star_indices[s]
            value = scale * weights[c]
            for a in range(k):
                j = cells[c, a]
                if j == i:
                    continue
                if slot[j] < begin:
                    slot[j] = end
                    indices[end] = j
                    data[end] = 0.0
                    end += 1
                data[slot[j]] -= value
        for t in range(begin + 1, end):
            data[begin] -= data[t]
        indptr[i + 1] = end


def graph_laplacian(topology: Topology, weights: FloatArray) -> Any:
    """Assemble the matrix A_bar of all vertices.

    Parameters
    ----------
    topology : Topology
    weights : (m,) float64     |tau|_rho = rho_tau |tau|

    Returns
    -------
    (n, n) scipy CSR           a_ij = -2/(d(d + 1)) sum of |tau|_rho over the cells of edge ij
                               (4.25), a_ii = -sum_j a_ij (4.26); symmetric, row sums 0

    References
    ----------
    CMAME 200 (2011) 967-984, (4.24)-(4.26).
    """
    from scipy.sparse import csr_matrix

    n = topology.movable.size
    size = n + topology.neighbors.indices.size
    indptr = np.zeros(n + 1, dtype=np.int32)
    indices = np.empty(size, dtype=np.int32)
    data = np.empty(size)
    stars = topology.stars
    slot = np.full(n, -1, dtype=np.int64)
    weights = np.ascontiguousarray(weights, dtype=np.float64)
    _fill_rows(
        topology.cells, stars.indptr, stars.indices, weights, slot, indptr, indices, data
    )
    matrix = csr_matrix((data, indices, indptr), shape=(n, n))
    matrix.sort_indices()
    return matrix


def interior_matrix(matrix: Any, movable: BoolArray) -> tuple[Any, Any]:
    """Split A_bar into A among the movable vertices p and A_pb from them to the fixed ones b.

    d/(d + 1) (A p + A_pb b) is the gradient by barycenters (4.29), and A p = -A_pb b the diffusion
    equation (4.30) that :func:`global_step` with method "cpt" iterates.
    """
    rows = matrix[np.flatnonzero(movable)]
    return rows[:, np.flatnonzero(movable)], rows[:, np.flatnonzero(~movable)]


def choose_solve(name: Literal["auto", "direct", "amg"], unknowns: int) -> LinearSolve:
    """Return the solver of ``Options.linear_solver`` for a system of this size.

    Raises
    ------
    InvalidOptionError    unknown name
    """
    table: dict[str, LinearSolve] = {"direct": solve_direct, "amg": solve_amg}
    if name == "auto":
        return solve_direct if unknowns <= DIRECT_LIMIT else solve_amg
    if name not in table:
        msg = f"got linear_solver {name!r}, expected 'auto', 'direct' or 'amg', try 'auto'"
        raise InvalidOptionError(msg)
    return table[name]


def frozen_density(
    points: FloatArray, cells: IntArray, rho: FloatArray | None, inverse_volume: bool
) -> FloatArray:
    """Density rho_tau of the present cells, held while one step is taken, shape (m,)."""
    if inverse_volume:
        return inverse_volume_density(points, cells)
    return np.ones(len(cells)) if rho is None else cell_density(cells, rho)


def global_direction(
    points: FloatArray,
    topology: Topology,
    rho_tau: FloatArray,
    solve: LinearSolve,
    *,
    method: Literal["odt", "cpt"] = "odt",
    boundary_rule: bool = True,
) -> FloatArray:
    """Full step -A^-1 grad E of (1.3) and (4.27), or -A^-1 grad~ E~ of (4.28).

    Parameters
    ----------
    points : (n, d) float64
    topology : Topology
    rho_tau : (m,) float64          density of every cell
    solve : callable                (A, B) -> X with A X = B
    method : {"odt", "cpt"}         (4.27) or (4.28)
    boundary_rule : bool            barycenters for cells that touch the boundary (Section 4.2.1)

    Returns
    -------
    (n, d) float64                  0 at vertices that may not move

    Notes
    -----
    Section 5.2 prints p = p + alpha A^-1 grad E; the sign is minus, as in (4.27). With
    barycenters alpha times this step is the damped fixed point iteration (4.31).
    """
    direction = np.zeros_like(points)
    movable = topology.movable
    if not movable.any():
        return direction
    weights = rho_tau * signed_volumes(points, topology.cells)
    matrix, _ = interior_matrix(graph_laplacian(topology, weights), movable)
    slope = step_gradient(points, topology, rho_tau, method, boundary_rule)[movable]
    scale = float(matrix.diagonal().mean())
    direction[movable] = -solve(matrix / scale, slope / scale)
    return direction


def least_alpha(points: FloatArray, direction: FloatArray, objective: Objective) -> float:
    """Where the parabola through the energies at alpha = 0, 1/2 and 1 is least.

    Parameters
    ----------
    points, direction : (n, d) float64
    objective : callable      energy of points; (2.2) is a polynomial in alpha, folded cells or not

    Returns
    -------
    float                     at most LONGEST; 1 when the energy rises along the direction
    """
    start = objective(points)
    half, full = (objective(points + t * direction) - start for t in (0.5, 1.0))
    slope, curvature = 4.0 * half - full, 2.0 * full - 4.0 * half
    if not slope < 0.0:
        return 1.0
    return -slope / (2.0 * curvature) if -slope < 2.0 * LONGEST * curvature else LONGEST


def line_search(
    points: FloatArray,
    topology: Topology,
    direction: FloatArray,
    objective: Objective | None,
    alpha: float = 1.0,
    *,
    least: bool = False,
    halvings: int = HALVINGS,
) -> tuple[FloatArray, StepStats]:
    """Try alpha, alpha/2, alpha/4, ...: no cell folds, and the energy falls.

    Parameters
    ----------
    points : (n, d) float64
    topology : Topology
    direction : (n, d) float64
    objective : callable         energy of points; None asks for the first alpha only
    alpha : float                first step length
    least : bool                 alpha is about the best for vertices that all may go that far:
                                 shorter ones are tried only when some may not
    halvings : int               steps tried after the first

    Returns
    -------
    points : (n, d) float64      of the first step that lowers the energy, or of shorter ones as
                                 long as these lower it further; the old points when none does
    stats : StepStats            reduced counts vertices shortened by :func:`guarded_move`
    """
    best, best_reduced, best_alpha = np.array(points), 0, 0.0
    lowest = np.inf if objective is None else objective(points)
    for _ in range(halvings + 1):
        new, reduced = guarded_move(points, topology, alpha * direction)
        value = -np.inf if objective is None else objective(new)
        if value < lowest:
            best, lowest, best_reduced, best_alpha = new, value, reduced, alpha
            if objective is None or (least and reduced == 0):
                break
        elif best_alpha > 0.0:
            break
        alpha *= 0.5
    return best, move_stats(points, best, topology, best_reduced, best_alpha)


def global_step(
    points: FloatArray,
    topology: Topology,
    rho: FloatArray | None = None,
    *,
    method: Literal["odt", "cpt"] = "odt",
    inverse_volume: bool = False,
    alpha: float | None = None,
    boundary_rule: bool = True,
    linear_solver: Literal["auto", "direct", "amg"] = "auto",
    objective: Objective | None = None,
) -> tuple[FloatArray, StepStats]:
    """One step (4.27) or (4.28) with line search; its parameters are the choices of Section 4.3.

    Parameters
    ----------
    points : (n, d) float64         not changed
    topology : Topology             cells of positive volume, movable vertices, boundary
    rho : (n,) float64, optional    density at the vertices; its mean over a cell is rho_tau
    method : {"odt", "cpt"}         circumcenters (4.27) or barycenters (4.28)
    inverse_volume : bool           rho_tau = 1/|tau| (4.22), frozen for the step
    alpha : float                   first step length; None means where the energy is about least
                                    along the step, without an energy 1
    boundary_rule : bool            barycenters for cells that touch the boundary (Section 4.2.1)
    linear_solver : {"auto", "direct", "amg"}
    objective : callable            energy that must fall; by default (2.2) with the present rho_tau
                                    of every cell, and none for "inverse-volume", a fixed point
                                    iteration without an energy

    Returns
    -------
    points : (n, d) float64
    stats : StepStats               alpha = 0 when no step lowers the energy

    References
    ----------
    CMAME 200 (2011) 967-984, Section 4.3.
    """
    rho_tau = frozen_density(points, topology.cells, rho, inverse_volume)
    solve = choose_solve(linear_solver, int(topology.movable.sum()))
    direction = global_direction(
        points, topology, rho_tau, solve, method=method, boundary_rule=boundary_rule
    )
    if objective is None and not inverse_volume:
        objective = partial(frozen_energy, cells=topology.cells, rho_tau=rho_tau)
    least = alpha is None and objective is not None
    if alpha is None:
        alpha = 1.0 if objective is None else least_alpha(points, direction, objective)
    return line_search(points, topology, direction, objective, alpha, least=least)
