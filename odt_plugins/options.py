"""Every option of :func:`odt_plugins.optimize`, with its default: one list for API and CLI."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

Method = Literal["odt", "cpt", "laplacian", "cvt"]
Solver = Literal["gauss-seidel", "jacobi", "richardson", "global", "lbfgs"]
Connectivity = Literal["auto", "delaunay", "flips", "none"]
Boundary = Literal["fixed"]
LinearSolver = Literal["auto", "direct", "amg"]

FIGURES = ("min_quality", "p1_quality", "mean_quality", "min_angle", "max_angle")

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Options:
    """Options of one run; the names are those of the keyword arguments and CLI flags.

    Attributes
    ----------
    method            which centre a vertex moves to: "odt" circumcenters (4.13), "cpt"
                      barycenters (4.20), "laplacian" neighbours (4.21), "cvt" Lloyd
    solver            how the positions are iterated (Section 4.1, 4.3; "lbfgs" through scipy)
    linear_solver     of the global step: "direct", "amg", or "auto" by size
    connectivity      "delaunay" scipy every round, "flips" only local flips, "auto" scipy
                      first and flips later (Section 3.2), "none"
    density           "keep" (size field of the input mesh), "uniform", "inverse-volume" (4.22),
                      (m,) per-cell or (n,) per-vertex rho values, a callable rho(points)
    exponent          r in rho = h^-r for "keep"; None means d + 2
    rounds            most rounds of stage 1 (smoothing + connectivity) in one cycle
    cycles            how often stage 1 and stage 2 follow each other
    finish            whether stage 2, quality-driven finishing, runs
    boundary          "fixed": bit for bit
    fixed             (n,) bool mask or vertex indices that must not move
    selection         (m,) bool mask or cell indices: only these cells may change
    regions           (m,) integer labels whose interfaces stay, or name of a cell array
    keep              figures that must not get worse (names in FIGURES)
    orient            turn cells of mixed orientation instead of refusing them
    threads           worker threads; the result does not depend on it
    progress          callback progress(stage, fraction)
    """

    method: Method = "odt"
    solver: Solver = "gauss-seidel"
    linear_solver: LinearSolver = "auto"
    connectivity: Connectivity = "auto"
    density: Any = "keep"
    exponent: float | None = None
    rounds: int = 20
    cycles: int = 3
    finish: bool = True
    boundary: Boundary = "fixed"
    fixed: Any = None
    selection: Any = None
    regions: Any = None
    keep: tuple[str, ...] = FIGURES
    orient: bool = False
    threads: int = 1
    progress: Progress | None = None
