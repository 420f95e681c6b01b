"""Every option of :func:`odt_plugins.optimize`: the list of which API, hosts and CLI are made."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from numbers import Integral
from textwrap import wrap
from typing import Any, Literal, get_args

from odt_plugins.errors import InvalidOptionError, expect, is_number, plain_values
from odt_plugins.hints import meant
from odt_plugins.objectives import AIMS, Objective

Method = Literal["odt", "cpt", "laplacian", "cvt"]
Solver = Literal["gauss-seidel", "jacobi", "richardson", "global", "lbfgs"]
Connectivity = Literal["auto", "delaunay", "flips", "none"]
Boundary = Literal["fixed", "slide"]
Fields = Literal["auto", "interpolate", "conserve", "keep"]
Repair = Literal["auto", "orient", "none"]
LinearSolver = Literal["auto", "direct", "amg"]

SOLVERS: dict[str, tuple[str, ...]] = {
    "odt": ("gauss-seidel", "jacobi", "richardson", "global", "lbfgs"),
    "cpt": ("gauss-seidel", "jacobi", "global"),
    "laplacian": ("gauss-seidel", "jacobi"),
    "cvt": ("gauss-seidel",),
}
"""Solvers of every method. Lloyd's iteration has one form, which is chosen by the default."""

DENSITIES = ("keep", "uniform", "inverse-volume", "curvature")

KEPT = ("min_quality", "p1_quality", "mean_quality", "min_angle", "max_angle", "share_below_20")

FIGURES = (*KEPT, "min_altitude")
"""What can be kept; the first of them are by default."""

EDGE_LENGTH = 0.05
"""Part of the diagonal of a surface: edges that TetWild aims at, unless another is given."""

STAYS = ("periodic", "inside", "layers")
"""What stays unless the option `free` names it."""

OF_MESHES = ("reference", "fixed", "selection", "regions", "fields", "free")
"""Options for what a mesh has that is there already, none for a surface that is to be filled."""

SIZES = ("size", "scale", "cells", "vertices")
"""What says how fine a mesh is to be, of which :func:`odt_plugins.remesh` takes one."""

NOT_SIZED = ("insert", "density")
"""Options whose part sizes take in :func:`odt_plugins.remesh`."""

STAYS_SIZED = ("periodic", "layers")
"""What its option `free` may name."""

OF_UNTANGLING = ("insert", "fixed", "selection", "regions", "threads", "progress")
"""Options of :func:`odt_plugins.untangle`."""

MOST = 2**31 - 1
"""Largest integer that an option may be."""

MOST_SHARE = 1000
"""Largest number that a switch may be."""

Progress = Callable[[str, float], None]

COMPILING = "compiling the kernels, once on this machine: up to half a minute ..."
"""Stage of which a progress callback is told while kernels are compiled."""


def _told(
    text: str, *, python: str = "", flag: str | None = "", choices: tuple[str, ...] = (),
    least: int = 0, share: bool = False,
) -> dict[str, Any]:
    """What is told of an option, as metadata of its field.

    Parameters
    ----------
    text : str               what the option means, in every host; under the key "help"
    python : str             what Python users are told besides
    flag : str, optional     what users of the command line are told besides; None: there is no flag
    choices : tuple of str   all values there are, of a word
    least : int              smallest value of an integer
    share : bool             whether a switch may also be a number above 0
    """
    return {"help": text, "python": python, "flag": flag, "choices": choices, "least": least,
            "share": share}


def _check_fields(options: Options | Smoothing) -> None:
    """Refuse what a field may never be."""
    for about in dataclasses.fields(options):
        name, value = about.name, getattr(options, about.name)
        choices, least = about.metadata["choices"], about.metadata["least"]
        if choices:
            good = isinstance(value, str) and value in choices
            expect(good, *worded(name, value), f"one of {choices}")
        if about.metadata["share"] and not isinstance(value, bool):
            good = is_number(value) and 0 < value <= MOST_SHARE
            what = f"a bool, or a number above 0 and at most {MOST_SHARE}"
            expect(good, *worded(name, value), what)
        elif isinstance(about.default, bool):
            expect(isinstance(value, bool), *worded(name, value), "a bool")
        elif isinstance(about.default, int):
            good = isinstance(value, Integral) and not isinstance(value, bool)
            good = good and int(value) >= least
            expect(good, *worded(name, value), f"an integer of at least {least}")
            expect(int(value) <= MOST, *worded(name, value), f"an integer of at most {MOST}")


def worded(name: str, value: Any) -> tuple[str, Any]:
    """Name and value of an option, or of a value of `smoothing`, as a caller gives it."""
    return ("smoothing", {name: value}) if name in SMOOTHING else (name, value)


@dataclass(frozen=True)
class Smoothing:
    """Values of the option `smoothing`; printed are those that are not as usual."""

    solver: Solver = field(default="gauss-seidel", metadata=_told(
        "How the positions are iterated. All solvers go with odt; gauss-seidel, jacobi and global "
        "with cpt; gauss-seidel and jacobi with laplacian; cvt has Lloyd's iteration only, under "
        "the default.",
        python="Sections 4.1 and 4.3, formulas (4.27) and (4.28); lbfgs runs through scipy.",
        choices=get_args(Solver)))
    connectivity: Connectivity = field(default="auto", metadata=_told(
        "How cells are reconnected in stage 1. delaunay: by Qhull each round. flips: by local "
        "flips. none: cells stay, in finishing and untangling, too. auto: flips, after one round "
        "of Qhull for meshes of at most 20,000 cells (tetrahedra: only if their mean q is below "
        "0.6).",
        python="Sections 3.1 and 3.2.",
        choices=get_args(Connectivity)))
    linear_solver: LinearSolver = field(default="auto", metadata=_told(
        "Solver of the global step; auto chooses by size.", choices=get_args(LinearSolver)))
    exponent: float | None = field(default=None, metadata=_told(
        "r in rho = h^-r for the density keep; d + 2 unless given."))
    omega: float | None = field(default=None, metadata=_told(
        "Relaxation of the local sweeps, above 0, at most 3; unless given 2.1, later 2, for odt "
        "in space by gauss-seidel with finishing, which reaches lower energies, 0.8 for jacobi, "
        "else 1.",
        python="The first alpha that is tried (4.2.1)."))
    rounds: int = field(default=40, metadata=_told(
        "Most rounds of smoothing and reconnection in one cycle."))
    cycles: int = field(default=1, metadata=_told(
        "How often the two stages follow each other; 1 without finishing."))

    def __post_init__(self) -> None:
        """Refuse values outside their range."""
        _check_fields(self)
        good = self.exponent is None or (
            is_number(self.exponent) and 0 < self.exponent < float("inf"))
        expect(good, *worded("exponent", self.exponent), "a positive number")
        good = self.omega is None or (is_number(self.omega) and 0 < self.omega <= 3)
        expect(good, *worded("omega", self.omega), "a number above 0 and at most 3")

    def __repr__(self) -> str:
        return repr({name: getattr(self, name) for name, about in SMOOTHING.items()
                     if getattr(self, name) != about.default})


SMOOTHING = {about.name: about for about in dataclasses.fields(Smoothing)}
"""Every value of the option `smoothing` by its name, with its metadata, see :func:`_told`."""


def _of_smoothing(key: str) -> str:
    """What is told of the values of the option `smoothing`, one after the other."""
    words = []
    for name, about in SMOOTHING.items():
        choices = ", ".join(about.metadata["choices"] if key == "help" else ())
        if told := about.metadata[key]:
            words.append(f"{name} ({choices}): {told}" if choices else f"{name}: {told}")
    return " ".join(words)


def listed(words: Sequence[str]) -> str:
    """Words as "a, b, or c"."""
    return ", ".join([*words[:-1], f"or {words[-1]}"])


@dataclass(frozen=True)
class Options:
    """Options of one run."""

    method: Method = field(default="odt", metadata=_told(
        "Centre that a vertex moves to: circumcenters (odt), barycenters (cpt), neighbours "
        "(laplacian), centroids of Voronoi cells (cvt).",
        python="Formulas (4.13), (4.20), (4.21) and Remark 4.8.",
        choices=get_args(Method)))
    density: Any = field(default="keep", metadata=_told(
        "Sizes of the result: those of the input (keep), all alike (uniform), averages that weigh "
        "all cells alike (inverse-volume, not for laplacian), fine where a curved surface bends "
        "(curvature).",
        python="Or values of rho: (m,) for the cells, (n,) for the vertices, or a callable "
        "rho(points). inverse-volume is (4.22).",
        flag="Or the name of a point or cell array of INPUT with the values of rho."))
    metric: Any = field(default=None, metadata=_told(
        "How lengths are measured at every vertex, by a symmetric positive definite tensor: cells "
        "become regular as it sees them, so stretched along the eigenvectors, and figures are "
        "measured in it; input is the metric that the mesh itself has, so that a mesh that was "
        "stretched on purpose is improved and stays so. Unless given, cells become isotropic.",
        python="(n, d, d), or (n, d (d + 1) / 2) in the order m11 m12 m22 m13 m23 m33, a callable "
        "metric(points), or the name of a point array. h^-2 I is the size h.",
        flag="Or the name of a point array of INPUT with 3 or 6 components, m11 m12 m22 m13 m23 "
        "m33."))
    smoothing: Any = field(default=Smoothing(), metadata=_told(
        "Values for the laboratory of stage 1; of several words the first is taken unless another "
        "is given. "
        + _of_smoothing("help"),
        python="A dict of them, such as {'rounds': 80}. " + _of_smoothing("python"),
        flag="NAME=VALUE, such as rounds=80, once for each value."))
    finish: bool = field(default=True, metadata=_told(
        "Whether bad cells are finished by their quality, stage 2.",
        flag="Without it a TetWild mesh usually comes back unchanged, since smoothing alone makes "
        "its worst cells worse and --keep refuses that; to have the smoothed mesh all the "
        "same: --no-finish --keep none."))
    objective: Objective = field(default="radius_ratio", metadata=_told(
        f"What finishing improves: {listed([aim.text for aim in AIMS.values()])}.",
        python="radius_ratio is (5.1).",
        choices=tuple(AIMS)))
    insert: bool | float = field(default=False, metadata=_told(
        "Whether finishing of tetrahedra may add and remove vertices inside: as many as pay, at "
        "most half as many again as there were, or a number, such as 0.2, for at most that part "
        "of them; new ones come last and their data are interpolated.",
        share=True))
    boundary: Boundary = field(default="fixed", metadata=_told(
        "What happens to the boundary: fixed keeps it bit for bit, slide lets the surface of a "
        "mesh of tetrahedra move along itself within the envelope; features and interfaces stay. "
        "In the plane slide lets rims and borders of regions change within half of the envelope. "
        "A curved mesh of triangles always does; there fixed keeps its rims and feature lines, "
        "and slide lets them change within half of the envelope.",
        choices=get_args(Boundary)))
    envelope: float = field(default=1e-3, metadata=_told(
        "How far a surface that moves may be from the input's, both ways, as a part of the "
        "diagonal of the bounding box."))
    reference: Any = field(default=None, metadata=_told(
        "A mesh of the same kind from whose surface, rims and borders the envelope is measured, "
        "and of whose diagonal it is a part: what the mesh is away from it counts, so that "
        "repeated calls do not add up. Unless given, the mesh itself.",
        python="Any single mesh that optimize takes, or the path of one.", flag="A mesh file."))
    feature_angle: float = field(default=40.0, metadata=_told(
        "Degrees by which a surface turns at an edge that is kept. Chains of fewer than five such "
        "edges with a loose end count as noise."))
    fixed: Any = field(default=None, metadata=_told(
        "Vertices that must not move.",
        python="(n,) bool mask or vertex indices.",
        flag="A file of indices (text or .npy), or the name of a point array, non-zero where "
        "fixed."))
    selection: Any = field(default=None, metadata=_told(
        "Cells that may change; all others stay.",
        python="(m,) bool mask or cell indices.",
        flag="A file of indices (text or .npy), or the name of a cell array, non-zero where "
        "selected."))
    regions: Any = field(default="auto", metadata=_told(
        "Labels of the cells; interfaces between labels stay. auto takes the cell arrays of "
        "integers whose names tell it, or which part the mesh into few connected pieces; the "
        "report says which. charts keeps the seams of the texture of a curved surface.",
        python="Also (m,) integers, the names of cell arrays, whose labels are combined, or None.",
        flag="Also names of cell arrays, between commas, whose labels are combined, or none."))
    fields: Fields = field(default="auto", metadata=_told(
        "Point arrays of floating-point numbers, or of colours in bytes: interpolate gives "
        "vertices that moved the value that the field of the input has there, keep lets values "
        "stay with their vertices, auto interpolates for tetrahedra and meshes in the plane unless "
        "they come from pymeshlab or open3d, whose own filters keep. conserve keeps integrals over "
        "regions, of cell arrays too, but not of colours. Other arrays, ids and normals stay in "
        "any case.",
        choices=get_args(Fields)))
    free: tuple[str, ...] = field(default=(), metadata=_told(
        "What is treated as any other, though it stays as it is unless it is named. periodic: "
        "faces that correspond to each other when the boundary slides, which are those that the "
        "mesh calls so, and opposite plane ones of tetrahedra whose triangles match under one "
        "translation (remeshing: those of several labels). inside: "
        "vertices of triangles beside tetrahedra, and of lines beside triangles in the plane, "
        "inside of a region, such as baffles, cracks and membranes; each remains a face of a "
        "cell, and what they make up bends. layers: many tetrahedra, or triangles in the plane, "
        "that are stretched alike with their neighbours, as at walls, in thin plates and along "
        "shocks; the report says how many there are.",
        python="A single one may be given as a word.",
        flag="Separated by commas."))
    keep: tuple[str, ...] = field(default=KEPT, metadata=_told(
        "Figures that must not get worse; share_below_20 is the part of the cells with an angle "
        "below 20 degrees, min_altitude the least altitude of a cell, which the objective "
        "time_step keeps with the others.",
        python="A single one may be given as a word.",
        flag="Separated by commas; none to keep no figure."))
    repair: Repair = field(default="auto", metadata=_told(
        "What happens first to a broken mesh. auto untangles one some of whose cells are inverted "
        "or flat, with the boundary where it is; figures in keep are then compared with its valid "
        "cells only. orient also turns triangles of a curved surface whose neighbours disagree "
        "about the outside. none refuses both. All other cells of mixed orientation always are "
        "turned.", choices=get_args(Repair)))
    threads: int = field(default=1, metadata=_told(
        "Worker threads; the result does not depend on it. The stages of fewer than "
        "40,000 tetrahedra, or triangles in the plane, take one.", least=1))
    progress: Any = field(default=None, metadata=_told(
        "Callback progress(stage, fraction), where the fraction grows from 0 to 1 over all stages; "
        "True shows a bar, in a notebook too. Unless False, there is one while kernels are "
        "compiled, on a terminal and in a notebook.", flag=None))

    def __post_init__(self) -> None:
        """Refuse values outside their range, and options that would have no effect."""
        if isinstance(self.smoothing, Mapping):
            expect_known(self.smoothing, SMOOTHING, "values of smoothing")
            values = {name: plain_values(name, value) for name, value in self.smoothing.items()}
            object.__setattr__(self, "smoothing", Smoothing(**values))
        good = isinstance(self.smoothing, Smoothing)
        expect(good, "smoothing", self.smoothing, f"a dict with some of {list(SMOOTHING)}")
        lab = self.smoothing
        _check_fields(self)
        known = SOLVERS[self.method]
        if lab.solver not in known:
            msg = (f"got method={self.method!r}, smoothing={{'solver': {lab.solver!r}}}; expected "
                   f"one of {known} as the solver of this method, try smoothing={{'solver': "
                   f"{known[0]!r}}} or method='odt'")
            raise InvalidOptionError(msg)
        if isinstance(self.density, str):
            what = f"one of {DENSITIES}, an array or a callable"
            expect(self.density in DENSITIES, "density", self.density, what)
            good = self.density != "inverse-volume" or self.method != "laplacian"
            what = "'uniform' for the method 'laplacian', which weighs no cells"
            expect(good, "density", self.density, what)
        keeps = isinstance(self.density, str) and self.density == "keep"
        good = lab.exponent is None or keeps
        expect(good, *worded("exponent", lab.exponent), "none unless density is 'keep'")
        local = lab.solver in ("gauss-seidel", "jacobi") and self.method != "cvt"
        good = lab.omega is None or local
        expect(good, *worded("omega", lab.omega), "none unless the solver is a local sweep")
        good = lab.linear_solver == "auto" or lab.solver == "global"
        what = "'auto' unless solver is 'global'"
        expect(good, *worded("linear_solver", lab.linear_solver), what)
        good = is_number(self.envelope) and 0 < self.envelope < 1
        expect(good, "envelope", self.envelope, "a part of the diagonal, between 0 and 1")
        good = is_number(self.feature_angle) and 0 < self.feature_angle <= 180
        expect(good, "feature_angle", self.feature_angle, "degrees above 0, at most 180")
        if not self.finish:
            good = AIMS[self.objective].by_ratios
            expect(good, "objective", self.objective, "'radius_ratio' without finishing")
            expect(lab.cycles == 1, *worded("cycles", lab.cycles), "1 without finishing")
        if self.metric is not None:
            self._expect_of_metric()
        good = self.finish or not self.insert
        expect(good, "insert", self.insert, "insert=False without finishing")
        good = lab.connectivity != "none" or not self.insert
        expect(good, "insert", self.insert, "insert=False with smoothing={'connectivity': "
               "'none'}: new vertices change cells; try another connectivity")
        for name, known in (("keep", FIGURES), ("free", STAYS)):
            value = getattr(self, name)
            words = (value,) if isinstance(value, str) else value
            good = isinstance(words, tuple | list) and all(word in known for word in words)
            expect(good, name, value, f"some of {known}")
            object.__setattr__(self, name, tuple(words))
        if AIMS[self.objective].by_altitude and self.keep and "min_altitude" not in self.keep:
            object.__setattr__(self, "keep", (*self.keep, "min_altitude"))
        good = callable(self.progress) or isinstance(self.progress, bool | None)
        what = "None, True or a callable progress(stage, fraction)"
        expect(good, "progress", self.progress, what)

    def _expect_of_metric(self) -> None:
        """Refuse what knows no metric."""
        for name, known in (("density", ("keep", "uniform")), ("method", ("odt", "cpt")),
                            ("solver", ("gauss-seidel", "jacobi")),
                            ("connectivity", ("auto", "flips", "none"))):
            value = getattr(self.smoothing if name in SMOOTHING else self, name)
            good = isinstance(value, str) and value in known
            expect(good, *worded(name, value), f"{' or '.join(known)} with a metric")
        expect(not self.insert, "insert", self.insert, "insert=False with a metric")


OPTIONS = {about.name: about for about in dataclasses.fields(Options)}
"""Every field of :class:`Options` by its name, with its metadata, see :func:`_told`."""


def _documentation() -> str:
    """Docstring of :class:`Options`: meaning, type and default of every field."""
    lines = [
        "Options of one run; the names are those of the keyword arguments and of the flags.",
        "",
        "    Numbers of formulas and sections are those of L. Chen, M. Holst, CMAME 200 (2011)",
        "    967-984, doi:10.1016/j.cma.2010.11.007.",
        "",
        "    Attributes",
        "    ----------",
    ]
    for name, about in OPTIONS.items():
        choices = about.metadata["choices"]
        kind = "{" + ", ".join(map(repr, choices)) + "}" if choices else about.type
        lines.append(f"    {name} : {kind}, default {about.default!r}")
        lines += wrap(meaning(name), 92, initial_indent=8 * " ", subsequent_indent=8 * " ")
    return "\n".join([*lines, "    "])


def meaning(name: str) -> str:
    """What an option means, as Python users are told."""
    about = OPTIONS[name].metadata
    return f"{about['help']} {about['python']}".strip()


Options.__doc__ = _documentation()


def make_options(odt: Mapping[str, Any] | None = None, /, **options: Any) -> Options:
    """Make :class:`Options` of keyword arguments, and of those in a dict.

    Raises
    ------
    InvalidOptionError    a name that is unknown or given twice, or a value out of range
    """
    twice = sorted(set(odt or ()) & set(options))
    if twice:
        msg = f"got {twice} as keywords and in odt={{...}}; expected each option once"
        raise InvalidOptionError(msg)
    given = {**(odt or {}), **options}
    expect_known(given, OPTIONS, "options")
    return Options(**{name: plain_values(name, value) for name, value in given.items()})


def expect_known(
    given: Mapping[str, Any], known: Collection[str], what: str, stays: Collection[str] = STAYS
) -> None:
    """Refuse names that are none of the known ones, where `free` takes those in `stays`."""
    unknown = [name for name in given if name not in known]
    if unknown:
        hint = hint_for(unknown[0], known, stays)
        msg = f"got unknown {what} {unknown}; expected some of {list(known)}{hint}"
        raise InvalidOptionError(msg)


def hint_for(unknown: str, known: Collection[str], stays: Collection[str] = STAYS) -> str:
    """What may be meant by an unknown name, as the end of a sentence."""
    places = {name: f"smoothing={{{name!r}: ...}}" for name in SMOOTHING if "smoothing" in known}
    places |= {name: f"free={name!r}" for name in stays if "free" in known}
    places |= {name: "remesh" for name in SIZES if "method" in known}
    if unknown in {*SMOOTHING, *STAYS, *SIZES} - {*places, *known}:
        return f", and free={unknown!r} is for optimize alone" if "free" in known else ""
    name = meant(unknown, known, places)
    if name in known:
        return f", did you mean {name!r}?"
    return f", try {places[name]}" if name else ""
