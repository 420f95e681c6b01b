"""MFEM's TMOP untangling, what stays held: Newton steps on a shifted barrier of shape.

Triangles take metric 4 with a shifted barrier, tetrahedra metric 313 with derivatives by
differences, as in MFEM's own examples of untangling; it has no barrier in space and no derivatives
of that metric.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.compare.baselines.task import Settings, Task, mean_edge
from odt_plugins.compare.hull import held_vertices
from odt_plugins.compare.start import StartMesh
from odt_plugins.mesh.arrays import FloatArray
from odt_plugins.mesh.simplex import determinant

IDEAL = {2: np.sqrt(0.75), 3: np.sqrt(0.5)}
"""Determinants of the edges at a vertex of the regular simplex with edges of length 1."""

BELOW = 0.01
"""How far below the least determinant the barrier begins."""

ORDER = 2
"""Of the quadrature; the Jacobian of a simplex is constant."""


def prepare(start: StartMesh, settings: Settings) -> Task:
    """Give the start to MFEM in units of its mean edge.

    Settings: `newton`, most Newton steps; `linear`, most MINRES steps in each; `gain`, the part of
    the first gradient at which it ends.
    """
    import mfem.ser as mfem

    tmop = mfem.tmop
    n, d = start.points.shape
    unit = mean_edge(start)
    points = start.points / unit
    mesh = _filled(mfem, points, start.cells)
    linears = mfem.H1_FECollection(1, d)
    space = mfem.FiniteElementSpace(mesh, linears, d)
    mesh.SetNodalFESpace(space)
    x = mfem.GridFunction(space)
    mesh.SetNodalGridFunction(x)
    x.SetTrueVector()
    least = mfem.Vector([_barrier(points, start.cells)])

    target = tmop.TargetConstructor(tmop.TargetConstructor.IDEAL_SHAPE_UNIT_SIZE)
    before = mfem.GridFunction(x)
    target.SetNodes(before)
    kind = tmop.TMOP_WorstCaseUntangleOptimizer_Metric
    plain = tmop.TMOP_Metric_004()
    metric = (tmop.TMOP_Metric_313(least.GetData()) if d == 3 else
              kind(plain, 2, 1.5, 0.001, 0.001, kind.BarrierType_Shifted))
    terms = tmop.TMOP_Integrator(metric, target)
    rules = mfem.IntegrationRules(0, mfem.Quadrature1D.GaussLobatto)
    terms.SetIntegrationRules(rules, ORDER)
    if d == 3:
        terms.EnableFiniteDifferences(x)
    else:
        terms.ComputeUntangleMetricQuantiles(x, space)
    form = mfem.NonlinearForm(space)
    form.AddDomainIntegrator(terms)
    held = np.flatnonzero(held_vertices(start))
    form.SetEssentialTrueDofs(mfem.intArray(np.add.outer(n * np.arange(d), held).ravel().tolist()))
    right = mfem.Vector(0)

    linear, scaling = mfem.MINRESSolver(), mfem.DSmoother(1, 1.0, 1)
    _limited(linear, settings["linear"], 1e-12)
    if d == 2:
        linear.SetPreconditioner(scaling)
    solver = tmop.TMOPNewtonSolver(rules.Get(mesh.GetElementBaseGeometry(0), ORDER), 0)
    solver.SetIntegrationRules(rules, ORDER)
    solver.SetPreconditioner(linear)
    solver.SetMinDetPtr(least.GetData())
    _limited(solver, settings["newton"], settings["gain"])
    solver.SetOperator(form)

    # MFEM's objects do not keep alive what they were made of, and cannot be freed in any order
    for part in (mesh, linears, space, x, least, target, before, plain, metric, terms, rules, form,
                 linear, scaling, solver):
        part.thisown = 0

    def call() -> FloatArray:
        solver.Mult(right, x.GetTrueVector())
        x.SetFromTrueVector()
        return np.array(x.GetDataArray()).reshape(d, n).T

    def collect(found: FloatArray) -> tuple[NDArray[Any] | None, ...]:
        out = found * unit
        out[held] = np.where(found[held] == points[held], start.points[held], out[held])
        return out, start.cells, start.regions

    return Task(call, collect)


def _filled(mfem: Any, points: FloatArray, cells: NDArray[np.int32]) -> Any:
    n, d = points.shape
    mesh = mfem.Mesh(d, n, len(cells), 0, d)
    for place in points.tolist():
        mesh.AddVertex(*place)
    add = mesh.AddTriangle if d == 2 else mesh.AddTet
    for cell in cells.tolist():
        add(*cell)
    # with edges, neither refined nor turned
    (mesh.FinalizeTriMesh if d == 2 else mesh.FinalizeTetMesh)(1, 0, False)
    return mesh


def _barrier(points: FloatArray, cells: NDArray[np.int32]) -> float:
    """The determinant of a Jacobian at which the barrier begins."""
    d = points.shape[1]
    edges = points[cells[:, 1:]] - points[cells[:, :1]]
    return float(determinant(np.moveaxis(edges, 0, -1)).min() / IDEAL[d]) - BELOW


def _limited(solver: Any, most: int, gain: float) -> None:
    solver.SetMaxIter(most)
    solver.SetRelTol(gain)
    solver.SetAbsTol(0.0)
    solver.SetPrintLevel(-1)
