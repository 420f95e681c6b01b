"""Descent with whole-mesh steps: Richardson (Section 4.1.1) and L-BFGS."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from odt_plugins.engine.cells.geometry import signed_volumes
from odt_plugins.engine.odt.energy import energy
from odt_plugins.engine.odt.global_step import Objective, frozen_density, line_search
from odt_plugins.engine.odt.gradient import energy_gradient, gradient, hessian_diagonal
from odt_plugins.engine.odt.sweeps import StepStats, guarded_move, move_stats
from odt_plugins.engine.topology.stencil import Topology
from odt_plugins.mesh.arrays import FloatArray


def richardson_step(
    points: FloatArray,
    topology: Topology,
    rho: FloatArray | None = None,
    *,
    inverse_volume: bool = False,
    objective: Objective | None = None,
) -> tuple[FloatArray, StepStats]:
    """One steepest descent step p - alpha grad E with line search (Section 4.1.1).

    Parameters
    ----------
    points : (n, d) float64         not changed
    topology : Topology             cells of positive volume, movable vertices
    rho : (n,) float64, optional    density at the vertices; its mean over a cell is rho_tau
    inverse_volume : bool           rho_tau = 1/|tau| (4.22), frozen for the step
    objective : callable            energy that must fall; by default (2.2) with the present rho_tau
                                    of every cell, and none for "inverse-volume", where alpha = 1/2

    Returns
    -------
    points : (n, d) float64
    stats : StepStats               alpha in units of 1 / (mean diagonal entry (4.8)); 0 when no
                                    step lowers the energy
    """
    rho_tau = frozen_density(points, topology.cells, rho, inverse_volume)
    movable = topology.movable
    if not movable.any():
        return np.array(points), StepStats(0, 0.0, 0, 0.0)
    slope = np.where(movable[:, None], gradient(points, topology.cells, rho_tau), 0.0)
    unit = hessian_diagonal(points, topology.cells, rho_tau)[movable].mean()
    if objective is None and inverse_volume:
        return line_search(points, topology, -slope / unit, None, alpha=0.5)
    if objective is None:
        objective = partial(energy, cells=topology.cells, rho=rho_tau)
    return line_search(points, topology, -slope / unit, objective, alpha=2.0)


class _Folded(StopIteration):
    """The iterate has a cell without volume."""


def lbfgs_step(
    points: FloatArray,
    topology: Topology,
    rho: FloatArray | None = None,
    *,
    inverse_volume: bool = False,
    iterations: int = 10,
) -> tuple[FloatArray, StepStats]:
    """Some iterations of L-BFGS on the energy (2.2) with the density frozen on cells.

    Parameters
    ----------
    points : (n, d) float64         not changed
    topology : Topology             cells of positive volume, movable vertices
    rho : (n,) float64, optional    density at the vertices; its mean over a cell is rho_tau
    inverse_volume : bool           rho_tau = 1/|tau| (4.22), frozen for the step
    iterations : int                at most

    Returns
    -------
    points : (n, d) float64         the last iterate, or the last valid one and as much of the way
                                    to the next as folds no cell and lowers the energy
    stats : StepStats               alpha = 0 when no step lowers the energy

    Notes
    -----
    (2.2) is a polynomial in the coordinates, defined for folded cells too, so the search is smooth
    and folded iterates are rejected rather than penalised. scipy sees the mesh in units of its
    mean cell size and of its energy, so its tolerances mean the same for every mesh.
    """
    cells, movable = topology.cells, topology.movable
    if not movable.any():
        return np.array(points), StepStats(0, 0.0, 0, 0.0)
    d = cells.shape[1] - 1
    size = float(np.mean(signed_volumes(points, cells))) ** (1 / d)
    origin = points.mean(axis=0)
    x = (points - origin) / size
    rho_tau = frozen_density(points, cells, rho, inverse_volume)
    rho_tau = rho_tau / energy(x, cells, rho_tau)
    count = int(movable.sum())

    def place(vector: Any) -> FloatArray:
        whole: FloatArray = x.copy()
        whole[movable] = vector.reshape(count, d)
        return whole

    def value_and_slope(vector: Any) -> tuple[float, Any]:
        whole = place(vector)
        slope = energy_gradient(whole, cells, rho_tau)[movable]
        return count * energy(whole, cells, rho_tau), np.ravel(count * slope)

    valid = [np.ravel(x[movable])]
    folded: list[FloatArray] = []

    def watch(vector: Any) -> None:
        if signed_volumes(place(vector), cells).min() > 0.0:
            valid.append(vector.copy())
        else:
            folded.append(vector.copy())
            raise _Folded

    from scipy.optimize import minimize

    options: Any = {"maxiter": iterations, "maxfun": 5 * iterations, "ftol": 0.0, "gtol": 1e-12}
    run: Any = minimize
    run(value_and_slope, valid[0], jac=True, method="L-BFGS-B", callback=watch, options=options)
    accepted = place(valid[-1])
    objective = partial(energy, cells=cells, rho=rho_tau)
    if folded:
        accepted, _ = line_search(accepted, topology, place(folded[0]) - accepted, objective)
    new, reduced = guarded_move(points, topology, (accepted - x) * size)
    if not objective((new - origin) / size) < 1.0:
        return np.array(points), StepStats(0, 0.0, 0, 0.0)
    return new, move_stats(points, new, topology, reduced, 1.0)
