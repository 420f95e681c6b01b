"""The report of one run: before and after, how it went, and what binds the minimum."""

from __future__ import annotations

import dataclasses
import json
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from odt_plugins.carrying.untangling import Tangle, worse_than_valid
from odt_plugins.errors import UnsupportedMeshError
from odt_plugins.figures import (
    QualitySummary,
    cell_figures,
    measured,
    summarize,
    volumes,
    volumes_of,
)
from odt_plugins.mesh.numbering import in_old_numbers
from odt_plugins.mesh.numbers import vertex_mask
from odt_plugins.mesh.seen import as_seen
from odt_plugins.mesh.simplex import SimplexMesh
from odt_plugins.options import Options, Smoothing
from odt_plugins.promise.volume import held_by, held_vertices
from odt_plugins.report.binding import BindingCell, Freeing, binding_cells
from odt_plugins.report.machine import installed_version
from odt_plugins.report.story import story
from odt_plugins.table import table_html, table_lines, text_html

if TYPE_CHECKING:
    from odt_plugins.engine.run.outcome import Outcome
    from odt_plugins.report.interpolation import InterpolationErrors
    from odt_plugins.report.worth import Worth

BINS = np.linspace(0.0, 1.0, 51)
"""Bins of the quality histograms, 0:0.02:1 as in Figs 6 and 10 of the paper."""

OF_MESHES = ("cell_origin", "meshes", "metrics", "carrying", "plane")
"""Fields of a report that are of the meshes and not in :meth:`Report.to_dict`."""


@dataclass(frozen=True)
class Report:
    """What one run did to a mesh.

    Attributes
    ----------
    dim : int                               dimension d
    before, after : QualitySummary          figures of the input and of the result
    histogram_before, histogram_after       counts of the radius ratio in 50 bins 0:0.02:1
    energy : tuple of (stage, E)            ODT energy after every round
    times : dict stage -> seconds           wall time
    stop_reason : str                       why the run ended, one sentence
    fallback : str or None                  why an earlier state is returned, when it is
    counts : dict name -> int               sweeps, flips, exchanges, refusals
    n_used, n_movable : int                 vertices in use, and those of them that may move
    binding : tuple of BindingCell          the cells that bind the minimum after, and why
    options : dict                          every option used, plain values
    versions : dict                         of this package, Python and what computes
    slid : dict or None                     envelope, distances both ways (upper bounds), relative
                                            change of the volume and vertices moved, when the
                                            boundary of tetrahedra slid; of flat facets, with how
                                            far these are from curved ones or CAD in the envelope
    surface : dict or None                  of a curved surface, and of triangles in the plane whose
                                            rims :func:`odt_plugins.optimize` lets slide:
                                            "envelope" and "diagonal" as
                                            lengths, "forward" and "backward", upper bounds of the
                                            distances of its points from the input and of the
                                            input's from it, and the numbers of
                                            "feature_edges", "corners", vertices "on_lines" that
                                            slide along features, and "held" ones
    regions_from : tuple of str             names of the cell arrays taken as labels of regions;
                                            empty when there were none, or an array was given
    cell_origin : (m',) int64 or None       cell of the input of which every cell of the result has
                                            the data, counted over all cells of the object; not in
                                            :meth:`to_dict`
    interpolated : tuple of str             names of the point arrays whose values at vertices that
                                            moved are those that the field has there
    layers : int                            cells of layers that stay as they are, see the option
                                            `free`
    notes : tuple of str                    what was done to the mesh on its way in, and what may be
                                            done about it
    untangled : dict or None                of a mesh with inverted or flat cells: the numbers of
                                            "inverted" and "flat" cells, of vertices "moved" and
                                            "added" and of "flips" until all were valid, of cells
                                            "left" that were not, and in what the result is "worse"
                                            than the valid cells of the input
    curved : dict or None                   of curved "cells": before and after "least" and "mean"
                                            of least by largest determinant of a cell,
                                            "least_of_corners" and "mean_of_corners" by that of its
                                            corners, "volume" of all, but of surfaces and tangled
                                            meshes; the number of "vertices_held" for them
    integrals : dict name -> float          relative changes of the sums of value by volume of cell
                                            of cell arrays, by the sum of the absolute values, where
                                            larger than 1e-9, of float32 than 1.2e-7; none of
                                            untangled meshes
    point_integrals : dict name -> float    the same of point arrays
    filled : Covered or None                how the surface that was filled and the boundary of the
                                            tetrahedra lie to each other, see
                                            :func:`odt_plugins.tetrahedralize`
    vetoed : dict or None                   of a refused state with a better mean: the figures that
                                            were "worse", name -> (before, there), and its
                                            "mean_quality" and "min_quality"
    meshes : two of (points, cells)         before and after, for :meth:`worth`; not in
                                            :meth:`to_dict`
    metrics : two of (n, k) float64         in which the figures of both were measured, without rows
                                            if in none; not in :meth:`to_dict`
    carrying : callable or None             what carries arrays, for :meth:`transfer`; not in
                                            :meth:`to_dict`
    plane : PlaneFrame or None              plane of triangles in space, in whose coordinates
                                            `meshes` are; not in :meth:`to_dict`
    parts : tuple of Report                 of an object of several meshes, those of each; the
                                            figures are those of all together then
    name : str                              of such a mesh: that of the block, geometry or mesh
    """

    dim: int
    before: QualitySummary
    after: QualitySummary
    histogram_before: tuple[int, ...]
    histogram_after: tuple[int, ...]
    energy: tuple[tuple[str, float], ...]
    times: Mapping[str, float]
    stop_reason: str
    fallback: str | None
    counts: Mapping[str, int]
    n_used: int
    n_movable: int
    binding: tuple[BindingCell, ...]
    options: Mapping[str, Any]
    versions: Mapping[str, str]
    slid: Mapping[str, float] | None = None
    surface: Mapping[str, float] | None = None
    regions_from: tuple[str, ...] = ()
    cell_origin: NDArray[np.int64] | None = dataclasses.field(
        default=None, repr=False, compare=False)
    interpolated: tuple[str, ...] = ()
    layers: int = 0
    notes: tuple[str, ...] = ()
    untangled: Mapping[str, Any] | None = None
    curved: Mapping[str, float] | None = None
    integrals: Mapping[str, float] = dataclasses.field(default_factory=dict)
    point_integrals: Mapping[str, float] = dataclasses.field(default_factory=dict)
    filled: Any = None
    vetoed: Mapping[str, Any] | None = None
    meshes: tuple[tuple[NDArray[Any], NDArray[Any]], ...] = dataclasses.field(
        default=(), repr=False, compare=False)
    metrics: tuple[NDArray[Any], ...] = dataclasses.field(default=(), repr=False, compare=False)
    carrying: Any = dataclasses.field(default=None, repr=False, compare=False)
    plane: Any = dataclasses.field(default=None, repr=False, compare=False)
    parts: tuple[Report, ...] = ()
    name: str = ""

    @property
    def movable_share(self) -> float:
        """Share of the vertices in use that may move, from 0 to 1."""
        return self.n_movable / self.n_used if self.n_used else 0.0

    def __repr__(self) -> str:
        """One line, for lists and notebooks; ``print`` gives the page."""
        old, new = self.before, self.after
        return (f"<Report: mean quality {old.mean_quality:.4f} -> {new.mean_quality:.4f}, least "
                f"{old.min_quality:.4f} -> {new.min_quality:.4f}; print it for the rest>")

    def __str__(self) -> str:
        """Text of a page: the table of figures, then how it went."""
        table = table_lines({"before": self.before, "after": self.after})
        return "\n".join([*table, "", *story(self)])

    def _repr_html_(self) -> str:
        """The same for a notebook."""
        table = table_html({"before": self.before, "after": self.after})
        return table + text_html("\n".join(story(self)))

    def to_dict(self) -> dict[str, Any]:
        """Give all but what is of the meshes as values that JSON knows; None if not finite."""
        data: dict[str, Any] = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)
                                if f.name not in OF_MESHES}
        data |= {"before": self.before.to_dict(), "after": self.after.to_dict(),
                 "binding": [dataclasses.asdict(cell) for cell in self.binding],
                 "movable_share": self.movable_share,
                 "filled": self.filled and self.filled.to_dict(),
                 "parts": [part.to_dict() for part in self.parts]}
        return {name: _plain(value) for name, value in data.items()}

    def to_json(self) -> str:
        """Give :meth:`to_dict` as JSON text, strictly: without NaN or Infinity."""
        return json.dumps(self.to_dict(), indent=2, allow_nan=False)

    def worth(self) -> Worth:
        """Solve on both meshes: condition number, steps of CG, stable time step.

        Raises
        ------
        UnsupportedMeshError          triangles of a curved surface; a mesh in pieces
        MissingDependencyError        scikit-fem is not installed
        """
        from odt_plugins.report.interpolation import meshes_of
        from odt_plugins.report.worth import Worth, solved

        return Worth(*(solved(points, cells) for points, cells in meshes_of(self)))

    def interpolation_error(
        self, f: Callable[[NDArray[np.float64]], ArrayLike]
    ) -> InterpolationErrors:
        """Measure how well linear functions on the cells interpolate a function, before and after.

        Parameters
        ----------
        f : callable                  f(x) -> (k,) for places x (k, d) as the mesh has its points

        Returns
        -------
        InterpolationErrors           `before` and `after`, each with `l1`, `l2` and `largest`

        Raises
        ------
        InvalidOptionError            f gives anything but one finite real number for every place
        UnsupportedMeshError          a mesh in pieces

        Examples
        --------
        >>> import numpy as np
        >>> import odt_plugins
        >>> points = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.9, 0.8]])
        >>> cells = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
        >>> _, report = odt_plugins.optimize_with_report((points, cells))
        >>> found = report.interpolation_error(lambda x: x[:, 0] ** 2)
        >>> bool(found.after.l2 < found.before.l2)
        True
        """
        from odt_plugins.report.interpolation import errors_of_report

        return errors_of_report(self, f)

    def transfer(
        self, values: ArrayLike, at: Literal["points", "cells"] | None = None
    ) -> NDArray[Any]:
        """Carry an array of your own to the result, as those on the mesh are carried.

        Parameters
        ----------
        values : (n, ...) or (m, ...)    of the vertices of the input, or of all cells of the object
        at : {"points", "cells"}         which of both, where there are as many

        Returns
        -------
        (n', ...) or (m', ...)           of the result, in the same type. Floating-point numbers and
                                         colours in bytes are interpolated linearly at vertices that
                                         moved or came if the option `fields` of the run does so,
                                         others stay with their vertices; cells have those of that
                                         which `cell_origin` names. With fields="conserve" integrals
                                         stay

        Raises
        ------
        InvalidOptionError               an array of another length, of as many vertices as cells,
                                         or of which some values are masked
        UnsupportedMeshError             values at the points of cells of higher order; a report of
                                         a mesh in pieces, or of several meshes, of which each of
                                         `parts` has this method

        Examples
        --------
        >>> import numpy as np
        >>> import odt_plugins
        >>> points = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.9, 0.8]])
        >>> cells = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
        >>> (better, _), report = odt_plugins.optimize_with_report((points, cells))
        >>> bool(np.allclose(report.transfer(points[:, 0]), better[:, 0]))
        True
        """
        if self.carrying is None:
            from odt_plugins.report.interpolation import meshes_of

            meshes_of(self)
            msg = ("got a report of several meshes; expected that of one mesh, try the method of "
                   "one of its parts")
            raise UnsupportedMeshError(msg)
        carried: NDArray[Any] = self.carrying(values, at)
        return carried

    def plot(self, path: str | PathLike[str]) -> None:
        """Write a figure: histograms before and after (cf. Figs 6 and 10) and the energy.

        Parameters
        ----------
        path : str or path-like       .png, .pdf or .svg

        Raises
        ------
        MissingDependencyError        matplotlib is not installed
        MeshFileError                 the figure cannot be written there
        """
        from odt_plugins.report.plotting import plot_report

        plot_report(self, path)


def make_report(
    before: SimplexMesh, outcome: Outcome, options: Options, *, tangle: Tangle | None = None,
    refused: Sequence[str] = (), nodes: int | None = None, **told: Any,
) -> Report:
    """Measure a run from outside.

    Parameters
    ----------
    before : SimplexMesh    what the engine was given
    outcome : Outcome       what it handed back
    options : Options       what it was asked for
    tangle : Tangle         what was done to a mesh with inverted or flat cells
    refused : sequence      options, some with a value, that the call does not take
    nodes : int             points of the result, unless they are those of the outcome
    **told                  fields of the report that only the adapters know
    """
    old = measured(before, options.threads)
    there = as_seen(outcome.points, outcome.cells, outcome.metric)
    plain = None if len(outcome.metric) else outcome.figures(options.threads)
    new = plain or cell_figures(*there, options.threads)
    used = np.zeros(len(before.points), bool)
    used[before.cells] = True
    n = len(before.points)
    now = outcome.points if outcome.origin is None else in_old_numbers(
        before.points, outcome.points, outcome.origin)[:n]
    kept = getattr(outcome, "kept", None)
    movable = used & (~held_vertices(before) | (now != before.points).any(axis=1))
    if kept is not None:
        movable = used & ~kept.locked
    counts = {k: int(v) for k, v in outcome.counts.items()}
    movable_after = movable
    added = np.zeros(n, bool)
    if outcome.origin is not None:
        added = outcome.origin < 0
        movable_after = added | movable[outcome.origin]
    if options.insert:
        counts["vertices added"] = int(added.sum())
        counts["vertices removed"] = n + int(added.sum()) - len(added)
    after = replace(summarize(*there, new),
                    n_points=len(outcome.points) if nodes is None else nodes,
                    volume=float((volumes(outcome.points, outcome.cells) if plain is None
                                  else plain.volume).sum()))
    was = replace(old.summary, turned=before.turned, volume=float(volumes_of(before).sum()))
    slid = outcome.slid and outcome.slid._asdict()
    if "volume_after" in (curved := told.get("curved") or {}):
        was = replace(was, volume=curved["volume_before"])
        after = replace(after, volume=curved["volume_after"])
        slid = slid and slid | {"volume": after.volume / was.volume - 1.0}
    untangled = None
    if tangle is not None:
        untangled = {**tangle.facts, "worse": worse_than_valid(tangle, after, tuple(options.keep))}
    return Report(
        dim=before.dim,
        before=was,
        after=after,
        histogram_before=histogram(old.quality),
        histogram_after=histogram(new.quality),
        energy=tuple((str(stage), float(e)) for stage, e in outcome.energy),
        times={k: float(v) for k, v in outcome.times.items()},
        stop_reason=outcome.stop_reason,
        fallback=outcome.fallback,
        counts=counts,
        n_used=int(used.sum()),
        n_movable=int(movable.sum()),
        binding=binding_cells(outcome.points, outcome.cells, before.bodies(outcome.regions),
                              movable_after, new, _freeing(before, outcome, options, refused)),
        options=described(options),
        versions=versions(),
        slid=slid,
        surface=_surface_facts(before, outcome, used),
        untangled=untangled,
        vetoed=outcome.vetoed,
        meshes=((before.points, before.cells), (outcome.points, outcome.cells)),
        metrics=(before.metric, outcome.metric),
        **told,
    )


def _freeing(
    before: SimplexMesh, outcome: Outcome, options: Options, refused: Sequence[str]
) -> Freeing:
    """The options that free cells of the result, but for those that the call does not take."""
    solid, surface = before.dim == 3, before.is_surface
    held = held_by(before)
    given = vertex_mask(options.fixed, len(before.points), "fixed", "vertices")
    features = getattr(outcome, "kept", None)
    if features is not None:
        held["boundary"] = held["boundary"] | features.locked
    known = {
        'boundary="slide"': held["boundary"] & ~(held["fixed"] | held["frozen"]),
        "regions=None": held["interface"] & ~(held["boundary"] | held["fixed"] | held["frozen"]),
        'free="periodic"': before.coupled & ~(held["frozen"] | given),
        'free="inside"': before.fixed & before.anchored & (before.body.size > 0) & ~(
            held["boundary"] | held["interface"] | held["frozen"] | given),
        "fewer vertices in fixed": given & ~held["frozen"],
        'free="layers"' if options.selection is None else "a larger selection": held["frozen"],
    }
    wider = f"envelope={2.0 * options.envelope:g}" if solid or surface else ""
    if not (solid or surface) or options.boundary == "slide":
        slides = known.pop('boundary="slide"')
        known |= {wider: slides} if wider else {}
    if outcome.origin is not None:
        kept = outcome.origin >= 0
        old = outcome.origin[kept]
        for name, mask in known.items():
            known[name] = np.zeros(len(kept), bool)
            known[name][kept] = mask[old]
    may = options.finish and options.smoothing.connectivity != "none" and options.metric is None
    insert = "insert=True" if solid and may and not options.insert else ""
    without = {*refused, *(f"free='{word}'" for word in options.free)}
    known = {name: mask for name, mask in known.items()
             if not {name.partition("=")[0], name.replace('"', "'")} & without}
    return Freeing(known, insert * ("insert" not in refused),
                   wider if surface and "envelope" not in refused else "", options.free)


def _surface_facts(
    before: SimplexMesh, outcome: Any, used: NDArray[np.bool_]
) -> dict[str, float] | None:
    """What there is to say of a curved surface, if it is one."""
    kept = getattr(outcome, "kept", None)
    if kept is None:
        return None
    same = np.array_equal(outcome.points, before.points) and np.array_equal(
        outcome.cells, before.cells
    )
    return {
        "diagonal": kept.diagonal,
        "envelope": kept.envelope,
        "forward": 0.0 if same else outcome.distance.forward,
        "backward": 0.0 if same else outcome.distance.backward,
        "feature_edges": len(kept.lines),
        "corners": kept.corners,
        "on_lines": kept.on_lines,
        "held": int((kept.locked & used).sum()),
    }


def histogram(quality: NDArray[np.float64]) -> tuple[int, ...]:
    """Count radius ratios in the 50 bins 0:0.02:1; negative ones fall into the first."""
    counts = np.histogram(np.clip(quality, 0.0, 1.0), bins=BINS)[0]
    return tuple(int(c) for c in counts)


def described(options: Options) -> dict[str, Any]:
    """Give every option as a plain value; arrays and callables by what they are."""
    values = {f.name: getattr(options, f.name) for f in dataclasses.fields(options)}
    del values["progress"]
    if not isinstance(values["reference"], str | PathLike | None):
        values["reference"] = f"a {type(values['reference']).__name__}"
    return {name: _describe(value) for name, value in values.items()}


def _describe(value: Any) -> Any:
    if value is None or isinstance(value, (str, bool, int, float)):
        return value
    if isinstance(value, PathLike):
        return str(value)
    if isinstance(value, Smoothing):
        return dataclasses.asdict(value)
    if callable(value):
        return f"function {getattr(value, '__name__', type(value).__name__)}"
    if isinstance(value, tuple | list) and all(isinstance(v, str) for v in value):
        return list(value)
    array = np.asarray(value)
    return f"{array.dtype} array of shape {array.shape}"


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value


def versions() -> dict[str, str]:
    """Versions of what computes."""
    names = ("odt-plugins", "numpy", "scipy", "numba", "pyamg")
    return {"python": platform.python_version()} | {name: installed_version(name) for name in names}
