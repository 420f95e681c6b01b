"""TetWild followed by Optimal Delaunay Triangulation, in one call shaped like pytetwild's own.

TetWild runs in a process and a directory of its own: it writes `__tracked_surface.stl` into the
working directory, and it cannot be interrupted. pytetwild is imported in that process only.
"""

from __future__ import annotations

import inspect
import math
import pickle
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from numpy.typing import NDArray

from odt_plugins.api import optimize as optimize_mesh
from odt_plugins.api import optimize_with_report
from odt_plugins.errors import (
    CrashError,
    InvalidMeshError,
    InvalidOptionError,
    NotFilledWarning,
    UnsupportedMeshError,
    exit_name,
    plain_values,
    require,
    warn,
)
from odt_plugins.keywords import OptionKeywords, with_option_signature
from odt_plugins.mesh.simplex import barycentric, diagonal, mesh_arrays, reverse, vertices_of
from odt_plugins.options import EDGE_LENGTH, OPTIONS, Progress, hint_for, make_options
from odt_plugins.progress import part, telling
from odt_plugins.remeshing import CURVATURE, check_sizes, remesh, remesh_with_report

if TYPE_CHECKING:
    from odt_plugins.generate.covered import Covered
    from odt_plugins.report.report import Report

PROGRAM = """
import pickle
with open("arguments", "rb") as file:
    arguments = pickle.load(file)
try:
    import pytetwild
    result = pytetwild.tetrahedralize(**arguments)
except Exception as exc:
    try:
        result = pickle.loads(pickle.dumps(exc))
    except Exception:
        result = RuntimeError(f"{type(exc).__name__}: {exc}")
with open("result", "wb") as file:
    pickle.dump(result, file)
"""

BY_TETWILD = 0.8
"""Part of the progress that TetWild takes."""

SHARES = {"Tetrahedralization performed": 0.1, "initializing": 0.2, "postprocessing": 0.95}
"""How far TetWild is when it says so, besides its passes."""

Mesh = tuple[NDArray[np.float64], NDArray[np.int32]]
RegionsOf = Callable[[NDArray[np.float64], NDArray[np.int32]], NDArray[np.int32]]

INSIDE = -1e-9
"""Least barycentric coordinate of a point that counts as inside a tetrahedron."""


PLACES = ("vertices", "bg_vertices")
"""Arguments of TetWild that are points."""

LENGTHS = ("vertices", "edge_length_abs", "bg_vertices", "bg_values")
"""Arguments of TetWild in the unit of the surface."""

USUAL = (1e-3, 1e6)
"""Diagonals of surfaces that TetWild gets as they are."""

FAR = 10.0
"""Diagonals from the origin beyond which TetWild gets a surface that begins there."""

OF_TETRAHEDRA = ("density", "metric", "fixed", "selection", "regions")
"""Options with a value for every vertex or cell, of which there are none before TetWild."""

SIZES = ("size", "scale", "cells", "growth")
"""Arguments of :func:`odt_plugins.remesh` that follow TetWild."""


OF_FILES = ("target", "file_format", "binary", "levels", "edge_length", "bodies")
"""Keywords that the file of a surface has, and arrays have not."""

TWINS = {"edge_length": "edge_length_fac", "edge_length_fac": "edge_length",
         "epsilon": "envelope", "num_threads": "threads"}
"""What the other of both calls a keyword."""


def asked(**sizes: Any) -> dict[str, Any]:
    """Those sizes that are given."""
    return {name: value for name, value in sizes.items() if value is not None}


def check_asked(sizes: Mapping[str, Any], options: Mapping[str, Any]) -> None:
    """Refuse sizes that the tetrahedra of TetWild cannot have, before any work is done."""
    check_sizes(**sizes, **options)
    size: Any = sizes.get("size")
    named = isinstance(size, str) and size != CURVATURE
    if named or np.ndim(size):
        told = f"size={size!r}" if named else f"size= of shape {np.shape(size)}"
        msg = (f"got {told} for a surface, whose vertices and faces are not those of the "
               f"tetrahedra; expected a length, size={CURVATURE!r}, or a function size(points)")
        raise InvalidOptionError(msg)


@with_option_signature()
def tetrahedralize(
    vertices: NDArray[np.floating],
    faces: NDArray[np.integer],
    edge_length_fac: float = EDGE_LENGTH,
    edge_length_abs: float | None = None,
    optimize: bool = True,
    simplify: bool = True,
    epsilon: float = 1e-3,
    stop_energy: float = 10.0,
    coarsen: bool = False,
    num_threads: int = 0,
    num_opt_iter: int = 80,
    loglevel: int = 3,
    quiet: bool = True,
    vtk_ordering: bool = False,
    disable_filtering: bool = False,
    bg_vertices: NDArray[np.float64] | None = None,
    bg_tets: NDArray[np.int32] | None = None,
    bg_values: NDArray[np.float64] | None = None,
    *,
    odt: Mapping[str, Any] | bool = True,
    size: Any = None,
    scale: float | None = None,
    cells: int | None = None,
    growth: float | None = None,
    **options: Unpack[OptionKeywords],
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Fill a triangle surface of arrays; see :func:`odt_plugins.tetrahedralize`."""
    given = {name: value for name, value in locals().items()
             if name not in ("odt", "options", *SIZES)}
    sizes = asked(size=size, scale=scale, cells=cells, growth=growth)
    chosen = _checked(given, odt, options, sizes)
    if chosen is None:
        return run_tetwild(given)
    with _made(given, chosen) as (mesh, _, improving):
        out: Mesh = (remesh if sizes else optimize_mesh)(mesh, **sizes, **improving)
        compare_with_surface(given, chosen, out)
        return out


def tetrahedralize_with_report(
    vertices: NDArray[np.floating], faces: NDArray[np.integer],
    regions_of: RegionsOf | None = None, **keywords: Any,
) -> tuple[Any, Report]:
    """The same with a report; `regions_of` is given points and cells, and gives labels (m,)."""
    own = inspect.signature(tetrahedralize).parameters
    usual = {name: about.default for name, about in own.items()
             if name not in ("vertices", "faces", "odt", *SIZES, *OPTIONS)}
    given = {"vertices": vertices, "faces": faces} | {
        name: keywords.pop(name, value) for name, value in usual.items()}
    sizes = asked(**{name: keywords.pop(name, None) for name in SIZES})
    chosen = _checked(given, keywords.pop("odt", True), keywords, sizes)
    if chosen is None:
        msg = ("got odt=False, TetWild alone, of which there is no report; expected True or a dict "
               "of options, try odt_plugins.tetrahedralize")
        raise InvalidOptionError(msg)
    with _made(given, chosen) as (mesh, seconds, improving):
        if regions_of is not None:
            improving["regions"] = regions_of(*mesh)
        improve = remesh_with_report if sizes else optimize_with_report
        out, report = improve(mesh, **sizes, **improving)
        filled = compare_with_surface(given, chosen, out)
    return out, replace(report, times={"TetWild": seconds, **report.times}, filled=filled)


def compare_with_surface(
    given: Mapping[str, Any], chosen: Mapping[str, Any], mesh: Any
) -> Covered | None:
    """How the surface and the boundary of tetrahedra lie to each other; a warning where apart.

    Parameters
    ----------
    given : dict     arguments of TetWild
    chosen : dict    options of ODT
    mesh : tuple     points and cells
    """
    if given["disable_filtering"]:
        return None
    from odt_plugins.generate.covered import REACH, compare

    surface = mesh_arrays(np.asarray(given["vertices"], dtype=np.float64), given["faces"])
    points, cells = mesh_arrays(*mesh[:2])
    moved = make_options(**chosen) if chosen.get("boundary") == "slide" else None
    part = given["epsilon"] + (moved.envelope if moved else 0.0)
    reach = REACH * part * diagonal(surface[0][np.unique(surface[1])])
    inward = np.full(len(cells), not given["vtk_ordering"])
    filled = compare(surface, (points, reverse(cells, inward)), reach)
    if not filled.filled:
        warn(filled.complaint(), NotFilledWarning)
    return filled


def _checked(
    given: dict[str, Any], odt: Mapping[str, Any] | bool, options: Mapping[str, Any],
    sizes: Mapping[str, Any],
) -> dict[str, Any] | None:
    """The options of ODT, None for TetWild alone; all that can be refused at once is.

    The faces among the arguments are turned if asked to.
    """
    _expect_known(options, given)
    chosen = odt_options(odt, **options)
    if sizes:
        if chosen is None or given["bg_values"] is not None:
            what = "odt=False, TetWild alone" if chosen is None else "a sizing field of TetWild"
            given_sizes = " and ".join(f"{name}=" for name in sizes)
            msg = f"got {given_sizes} beside {what}; expected either"
            raise InvalidOptionError(msg)
        chosen.setdefault("boundary", "slide")
        check_asked(sizes, chosen)
    for name in OF_TETRAHEDRA:
        value = (chosen or {}).get(name)
        if not (value is None or isinstance(value, str) or callable(value)):
            msg = (f"got {name} of type {type(value).__name__} for a surface, whose vertices and "
                   f"faces are not those of the tetrahedra; expected none, try {name}= of "
                   "odt_plugins.optimize on the result")
            raise InvalidOptionError(msg)
    given.update(read_surface(given["vertices"], given["faces"]))
    if chosen and chosen.get("repair") == "orient":
        from odt_plugins.generate.bodies import outward

        faces = given["faces"]
        given["faces"] = reverse(faces, outward(*mesh_arrays(given["vertices"], faces)))
    return chosen


@contextmanager
def _made(given: Mapping[str, Any], chosen: dict[str, Any]) -> Iterator[tuple[Mesh, float, Any]]:
    """The mesh of TetWild, its seconds, and the options to improve it with, in one progress."""
    asked = chosen.pop("progress", None)
    with telling(asked, "TetWild") as tell:
        first = (part(tell, 0.0, BY_TETWILD),) if asked else ()
        clock = time.perf_counter()
        points, cells = run_tetwild(given, *first)
        seconds = time.perf_counter() - clock
        chosen["progress"] = part(tell, BY_TETWILD, 1.0)
        improving = {"free": "layers"} | _with_field(chosen, points, cells, given)
        yield (points, cells), seconds, improving


def _with_field(
    chosen: dict[str, Any], points: NDArray[np.float64], cells: NDArray[np.int32],
    given: Mapping[str, Any],
) -> dict[str, Any]:
    """The options, with the density that keeps the sizing field of the arguments, if any."""
    field = (given["bg_vertices"], given["bg_tets"], given["bg_values"])
    if given["bg_values"] is not None and "density" not in chosen:
        ideal = (given["edge_length_abs"]
                 or given["edge_length_fac"] * _diagonal(np.asarray(given["vertices"])))
        lab = make_options(smoothing=chosen.get("smoothing", {})).smoothing
        power = -float(points.shape[1] + 2 if lab.exponent is None else lab.exponent)
        chosen["smoothing"] = replace(lab, exponent=None)

        def density(x: NDArray[np.float64]) -> NDArray[np.float64]:
            size = background_sizes(x, *field, outside=ideal) / ideal
            rho: NDArray[np.float64] = size**power
            return rho

        # An array is quicker, but of no use when it could be one of cells as well.
        chosen["density"] = density if len(points) == len(cells) else density(points)
    return chosen


def expect_none_of(
    names: Collection[str], given: Collection[str], these: str, others: str
) -> None:
    """Refuse keywords of other surfaces than these."""
    if wrong := next((name for name in given if name in names), ""):
        hint = f", did you mean {TWINS[wrong]!r}?" if wrong in TWINS else ""
        if wrong == "levels":
            hint = ", try odt_plugins.refine((vertices, faces), levels)"
        msg = f"got {wrong}= with {these}; expected it with {others}{hint}"
        raise InvalidOptionError(msg)


def _expect_known(options: Mapping[str, Any], own: Mapping[str, Any]) -> None:
    """Refuse keywords that are neither options nor pytetwild's own."""
    expect_none_of(OF_FILES, options, "arrays", "the path of a file")
    unknown = [name for name in options if name not in OPTIONS]
    if unknown:
        hint = hint_for(unknown[0], [*OPTIONS, *own])
        msg = (f"got unknown keywords {unknown}; expected those of pytetwild.tetrahedralize, or "
               f"options of odt_plugins.optimize{hint}")
        raise InvalidOptionError(msg)
    for name in ("edge_length_fac", "edge_length_abs", "epsilon", "stop_energy"):
        value = own.get(name, 1.0)
        known = isinstance(value, int | float | np.number) and 0.0 < value < np.inf
        if not known and (value is not None or name != "edge_length_abs"):
            msg = f"got {name}={value!r}; expected a number above 0"
            raise InvalidOptionError(msg)


def odt_options(odt: Mapping[str, Any] | bool, **options: Any) -> dict[str, Any] | None:
    """Check the options given as keywords and in `odt`; None when nothing is to be improved."""
    if not isinstance(odt, bool | Mapping):
        msg = f"got odt={odt!r}; expected a dict of options of odt_plugins.optimize, True or False"
        raise InvalidOptionError(msg)
    if odt is False:
        if options:
            msg = (f"got odt=False, TetWild alone, and options {list(options)}; expected either, "
                   "leave out odt=False")
            raise InvalidOptionError(msg)
        return None
    group = odt if isinstance(odt, Mapping) else {}
    make_options(group, **options)
    return {**group, **options}


def read_surface(vertices: Any, faces: Any) -> dict[str, Any]:
    """The vertices that have a face, and the faces, which name these.

    TetWild measures its lengths by the box around all vertices. What would end it without a word
    is refused, and what the process of TetWild does not get; lists, pytetwild names.
    """
    given = {"vertices": vertices, "faces": faces}
    for name, value in given.items():
        if not isinstance(value, np.ndarray | list | tuple):
            what = "vertices" if name == "vertices" else "triangles"
            msg = (f"got {name} of type {type(value).__name__}; expected a NumPy array, such as "
                   f"numpy.asarray(mesh.{what})")
            raise UnsupportedMeshError(msg)
    if not all(isinstance(value, np.ndarray) for value in given.values()):
        return {}
    for name, array in given.items():
        plain_values(name, array, InvalidMeshError)
        if array.dtype.kind == "c":
            msg = f"{name} have dtype {array.dtype}; expected real numbers, try {name}.real"
            raise InvalidMeshError(msg)
        if array.size and array.shape[1:] != (3,):
            expected = "(n, 3)" if name == "vertices" else "(m, 3)"
            msg = f"{name} have shape {array.shape}; expected {expected}"
            raise InvalidMeshError(msg)
    try:
        mesh_arrays(vertices.astype(np.float64), faces)
    except InvalidMeshError as exc:
        words = str(exc).replace("the mesh", "the surface").replace(" or tetrahedron", "")
        raise InvalidMeshError(words.replace("cell", "face")) from exc
    used = vertices_of(faces)
    if len(used) == len(vertices):
        return {"vertices": vertices, "faces": faces}
    return {"vertices": vertices[used],
            "faces": np.searchsorted(used, faces).astype(faces.dtype)}


def expect_pytetwild() -> None:
    """Refuse at once when pytetwild is not there."""
    require("tetrahedralize", "pytetwild", "pytetwild")


def run_tetwild(
    given: Mapping[str, Any], report: Progress | None = None
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Run pytetwild.tetrahedralize on arguments by name, in a process of its own.

    A callable `report` is told a share that grows with the passes that TetWild names.

    Arguments that have their default are left out, so that older versions run too.

    Raises
    ------
    MissingDependencyError, InvalidMeshError, CrashError, and what pytetwild raises
    """
    expect_pytetwild()
    usual = inspect.signature(tetrahedralize).parameters
    arguments = {name: value for name, value in given.items()
                 if usual[name].default is inspect.Parameter.empty
                 or value is not usual[name].default}
    power, origin = _power(given["vertices"]), _origin(given["vertices"])
    for name in PLACES if np.any(origin) else ():
        if arguments.get(name) is not None:
            arguments[name] = np.asarray(arguments[name], dtype=np.float64) - origin
    for name in LENGTHS if power else ():
        if arguments.get(name) is not None:
            arguments[name] = np.ldexp(arguments[name], -power)
    quiet = given.get("quiet", True)
    if report is not None:
        arguments["quiet"] = False
    with tempfile.TemporaryDirectory(prefix="odt-plugins-") as folder:
        (Path(folder) / "arguments").write_bytes(pickle.dumps(arguments))
        code, errors = _run(Path(folder), quiet, report)
        file = Path(folder) / "result"
        if code or not file.is_file():
            said = errors.strip().splitlines()
            error = CrashError(_no_tetrahedra(f"it was ended by {exit_name(code)}"
                                              + (f" ({said[-1]})" if said else "")))
            error.code = code
            raise error
        result = pickle.loads(file.read_bytes())
    if isinstance(result, Exception):
        raise result
    points, cells = result
    if not len(cells):
        raise InvalidMeshError(_no_tetrahedra("it gave an empty mesh"))
    return (np.ldexp(points, power) if power else points) + origin, cells


def _power(vertices: Any) -> int:
    """Power of 2 that the diagonal of a surface of unusual size has, 0 for any other.

    TetWild crashes at diagonals such as 1e-9. A power of 2 changes no digit.
    """
    length = diagonal(vertices) if isinstance(vertices, np.ndarray) and vertices.size else 0.0
    return 0 if USUAL[0] <= length <= USUAL[1] else math.frexp(length)[1]


def _origin(vertices: Any) -> NDArray[np.float64]:
    """The least coordinates in magnitude where a surface is far from the origin, else 0.

    TetWild leaves such a surface. Differences to coordinates of up to the double have no rounding.
    """
    if not isinstance(vertices, np.ndarray) or not vertices.size:
        return np.zeros(3)
    low, high = np.asarray([vertices.min(axis=0), vertices.max(axis=0)], dtype=np.float64)
    near = np.where(low > 0.0, low, np.minimum(high, 0.0))
    return np.where(np.abs(near) > FAR * diagonal(vertices), near, 0.0)


def _run(folder: Path, quiet: bool, report: Progress | None) -> tuple[int, str]:
    """Run the program in a directory; its exit code, and what it wrote to stderr."""
    out = None if not quiet else subprocess.DEVNULL
    with (
        open(folder / "errors", "w", encoding="utf-8") as errors,
        subprocess.Popen(
            [sys.executable, "-c", PROGRAM], cwd=folder, text=True, errors="replace",
            stdout=out if report is None else subprocess.PIPE, stderr=errors,
        ) as job,
    ):
        try:
            for line in job.stdout or ():
                if report is not None and (share := share_done(line)):
                    report("TetWild", share)
                if not quiet:
                    sys.stdout.write(line)
            code = job.wait()
        except BaseException:
            job.kill()
            raise
    return code, (folder / "errors").read_text(encoding="utf-8", errors="replace")


def share_done(line: str) -> float:
    """About how far TetWild is when it writes a line, 0 when the line does not tell.

    The number of passes is not known before, so each takes a quarter of what the others left.
    """
    if found := re.match(r"/+ pass (\d+) /+", line):
        return 0.2 + 0.7 * (1.0 - 0.75 ** (int(found[1]) + 1))
    return next((share for word, share in SHARES.items() if word in line), 0.0)


def background_sizes(
    points: NDArray[np.float64],
    bg_vertices: Any,
    bg_tets: Any,
    bg_values: Any,
    *,
    outside: float,
) -> NDArray[np.float64]:
    """Edge lengths (k,) that a sizing field asks for, by linear interpolation on its tetrahedra.

    Parameters
    ----------
    points : (k, 3) float64        where it is asked
    bg_vertices : (n, 3)           background mesh
    bg_tets : (m, 4) int           its tetrahedra, of either orientation
    bg_values : (n,)               edge length at its vertices
    outside : float                edge length where there is no tetrahedron
    """
    from scipy.spatial import cKDTree

    corner = np.asarray(bg_vertices, dtype=np.float64)[np.asarray(bg_tets)]
    values = np.asarray(bg_values, dtype=np.float64).ravel()[np.asarray(bg_tets)]
    centre = corner.mean(axis=1)
    reach = np.sqrt(((corner - centre[:, None]) ** 2).sum(axis=2)).max(axis=1)
    near = cKDTree(points).query_ball_point(centre, reach * (1.0 + 1e-6), return_sorted=True)
    tet = np.repeat(np.arange(len(centre)), [len(found) for found in near])
    nowhere = np.zeros(0, dtype=np.intp)
    point = np.concatenate([nowhere, *(np.asarray(found, dtype=np.intp) for found in near)])
    share = barycentric(corner[tet], points[point])
    order = np.lexsort((-share.min(axis=1), point))
    first = order[np.flatnonzero(np.diff(point[order], prepend=-1))]
    first = first[share[first].min(axis=1) >= INSIDE]
    sizes = np.full(len(points), float(outside))
    sizes[point[first]] = (share[first] * values[tet[first]]).sum(axis=1)
    return sizes


def _diagonal(points: NDArray[Any]) -> float:
    return float(np.sqrt(((points.max(axis=0) - points.min(axis=0)) ** 2).sum()))


def _no_tetrahedra(reason: str) -> str:
    return (f"TetWild found no tetrahedra inside the surface: {reason}; expected a closed "
            f"surface, try closing its holes or another edge length")
