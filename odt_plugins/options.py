"""Every option of :func:`odt_plugins.optimize`, with its default: one list for API and CLI."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any, Literal, get_args

from odt_plugins.errors import InvalidOptionError

Method = Literal["odt", "cpt", "laplacian", "cvt"]
Solver = Literal["gauss-seidel", "jacobi", "richardson", "global", "lbfgs"]
Connectivity = Literal["auto", "delaunay", "flips", "none"]
Boundary = Literal["fixed", "slide"]
Objective = Literal["radius_ratio", "min_dihedral", "amips"]
LinearSolver = Literal["auto", "direct", "amg"]

CHOICES: dict[str, tuple[str, ...]] = {
    "method": get_args(Method),
    "solver": get_args(Solver),
    "linear_solver": get_args(LinearSolver),
    "connectivity": get_args(Connectivity),
    "objective": get_args(Objective),
    "boundary": get_args(Boundary),
}
SOLVERS: dict[str, tuple[str, ...]] = {
    "odt": ("gauss-seidel", "jacobi", "richardson", "global", "lbfgs"),
    "cpt": ("gauss-seidel", "jacobi", "global"),
    "laplacian": ("gauss-seidel", "jacobi"),
    "cvt": ("gauss-seidel",),
}
"""Solvers of every method. Lloyd's iteration has one form, which is chosen by the default."""

DENSITIES = ("keep", "uniform", "inverse-volume", "curvature")

FIGURES = ("min_quality", "p1_quality", "mean_quality", "min_angle", "max_angle")

Progress = Callable[[str, float], None]

COMPILING = "compiling the kernels, once after installation: about half a minute ..."
"""Stage of which a progress callback is told while kernels are compiled."""


@dataclass(frozen=True)
class Options:
    """Options of one run; the names are those of the keyword arguments and CLI flags.

    Attributes
    ----------
    method            which centre a vertex moves to: "odt" circumcenters (4.13), "cpt"
                      barycenters (4.20), "laplacian" neighbours (4.21), "cvt" Lloyd
    solver            how the positions are iterated (Section 4.1, 4.3; "lbfgs" through scipy);
                      "cpt" has the local sweeps and "global" (4.28), "laplacian" the sweeps only,
                      and "cvt" Lloyd's iteration only, under the default
    linear_solver     of the global step: "direct", "amg", or "auto" by size
    connectivity      "delaunay" scipy every round, "flips" only local flips, "auto" scipy
                      first and flips later (Section 3.2), "none"
    density           "keep" (size field of the input mesh), "uniform", "inverse-volume" (4.22; not
                      for "laplacian", which weighs no cells),
                      "curvature" (curved surfaces: fine where they bend),
                      (m,) per-cell or (n,) per-vertex rho values, a callable rho(points)
    exponent          r in rho = h^-r for "keep"; None means d + 2
    omega             relaxation of the local sweeps, the first alpha that is tried (4.2.1); None
                      means 1.95 for odt in space by Gauss-Seidel with finishing (over-relaxation
                      reaches lower energies), else 1, and 0.8 for jacobi
    rounds            most rounds of stage 1 (smoothing + connectivity) in one cycle
    cycles            how often stage 1 and stage 2 follow each other; 1 without finishing
    finish            whether stage 2, quality-driven finishing, runs
    objective         what finishing improves: "radius_ratio" (5.1), "min_dihedral" the smallest
                      (dihedral) angles, "amips" the energy that TetWild minimises
    insert            whether finishing of tetrahedra may add and remove vertices inside, where
                      nothing else helps; at most 10 % more than before
    boundary          "fixed": bit for bit; "slide": the surface of a mesh of tetrahedra moves
                      along itself within the envelope, features and interfaces stay. A curved
                      mesh of triangles always does; there "fixed" keeps its rims and feature
                      lines, and "slide" lets them change within half of the envelope
    envelope          how far a surface that moves may be from the input's, both ways, as a part
                      of the diagonal of the bounding box
    feature_angle     degrees by which a surface turns at an edge that is kept; chains of fewer
                      than five such edges with a loose end count as noise and are not
    fixed             (n,) bool mask or vertex indices that must not move
    selection         (m,) bool mask or cell indices: only these cells may change
    regions           (m,) integer labels whose interfaces stay, or name of a cell array; "charts"
                      keeps the seams of the texture of a curved surface
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
    omega: float | None = None
    rounds: int = 40
    cycles: int = 1
    finish: bool = True
    objective: Objective = "radius_ratio"
    insert: bool = False
    boundary: Boundary = "fixed"
    envelope: float = 1e-3
    feature_angle: float = 40.0
    fixed: Any = None
    selection: Any = None
    regions: Any = None
    keep: tuple[str, ...] = FIGURES
    orient: bool = False
    threads: int = 1
    progress: Progress | None = None

    def __post_init__(self) -> None:
        """Refuse values outside their range, and options that would have no effect."""
        for name, choices in CHOICES.items():
            value = getattr(self, name)
            good = isinstance(value, str) and value in choices
            _expect(good, name, value, f"one of {choices}")
        known = SOLVERS[self.method]
        if self.solver not in known:
            msg = (
                f"got method={self.method!r}, solver={self.solver!r}; expected one of {known} as "
                f"the solver of this method, try solver={known[0]!r} or method='odt'"
            )
            raise InvalidOptionError(msg)
        if isinstance(self.density, str):
            what = f"one of {DENSITIES}, an array or a callable"
            _expect(self.density in DENSITIES, "density", self.density, what)
            good = self.density != "inverse-volume" or self.method != "laplacian"
            what = "'uniform' for the method 'laplacian', which weighs no cells"
            _expect(good, "density", self.density, what)
        if self.exponent is not None:
            good = _is_number(self.exponent) and 0 < self.exponent < float("inf")
            _expect(good, "exponent", self.exponent, "a positive number or None")
            good = isinstance(self.density, str) and self.density == "keep"
            _expect(good, "exponent", self.exponent, "None unless density is 'keep'")
        if self.omega is not None:
            good = _is_number(self.omega) and 0 < self.omega < 2
            _expect(good, "omega", self.omega, "a number between 0 and 2, or None")
            good = self.solver in ("gauss-seidel", "jacobi") and self.method != "cvt"
            _expect(good, "omega", self.omega, "None unless the solver is a local sweep")
        if self.linear_solver != "auto":
            good = self.solver == "global"
            _expect(good, "linear_solver", self.linear_solver, "'auto' unless solver is 'global'")
        good = _is_number(self.envelope) and 0 < self.envelope < 1
        _expect(good, "envelope", self.envelope, "a part of the diagonal, between 0 and 1")
        good = _is_number(self.feature_angle) and 0 < self.feature_angle <= 180
        _expect(good, "feature_angle", self.feature_angle, "degrees above 0, at most 180")
        for name, least in (("rounds", 0), ("cycles", 0), ("threads", 1)):
            value = getattr(self, name)
            good = isinstance(value, Integral) and not isinstance(value, bool)
            good = good and int(value) >= least
            _expect(good, name, value, f"an integer of at least {least}")
        for name in ("finish", "insert", "orient"):
            _expect(isinstance(getattr(self, name), bool), name, getattr(self, name), "a bool")
        if not self.finish:
            good = self.objective == "radius_ratio"
            _expect(good, "objective", self.objective, "'radius_ratio' without finishing")
            _expect(self.cycles == 1, "cycles", self.cycles, "1 without finishing")
        _expect(self.finish or not self.insert, "insert", self.insert, "False without finishing")
        good = isinstance(self.keep, tuple | list) and all(k in FIGURES for k in self.keep)
        _expect(good, "keep", self.keep, f"some of {FIGURES}")
        good = self.progress is None or callable(self.progress)
        _expect(good, "progress", self.progress, "None or a callable progress(stage, fraction)")


def _is_number(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)


def _expect(good: bool, name: str, value: object, expected: str) -> None:
    if not good:
        msg = f"got {name}={value!r}; expected {expected}"
        raise InvalidOptionError(msg)
