"""Remeshing: the same shape with other sizes of cells, and vertices that come and go."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from odt_plugins.carrying.roundtrip import run_engine
from odt_plugins.carrying.untangling import Wanted
from odt_plugins.errors import InvalidOptionError, expect, plain_values
from odt_plugins.keywords import OptionKeywords, with_option_signature
from odt_plugins.mesh.bodies import of_bodies
from odt_plugins.mesh.facets import directed_facets
from odt_plugins.mesh.numbers import even_rows
from odt_plugins.mesh.simplex import SimplexMesh, freeze
from odt_plugins.multiblock import has_parts, run_parts
from odt_plugins.options import NOT_SIZED, OPTIONS, STAYS_SIZED, Options, expect_known, make_options

if TYPE_CHECKING:
    from odt_plugins.engine.remesh.wish import Wish
    from odt_plugins.engine.run.outcome import Leaving, Outcome
    from odt_plugins.report.report import Report

WISHES = ("scale", "cells", "vertices", "growth", "most_cells", "adapt")
"""Arguments of :func:`remesh` that say what sizes there are to be, beside `size`."""

CURVATURE = "curvature"
"""Size that follows the curvature, and no array of that name."""

MOST_CROWDED, LEAST_STRETCHED, STRETCHES = 2.0, 10.0, 4
"""Multiple of a number of cells that a metric may make of it before lengths are stretched less,
ratio of lengths that does not become less, and most such ratios that are tried."""

HARDLY_FEWER = 0.8
"""Part of that multiple above which it is not the ratio of lengths that makes so many cells."""


class _CrowdedError(Exception):
    """The lengths of a metric make so many times as many cells as they should."""


@with_option_signature(*NOT_SIZED, boundary="slide")
def remesh(
    mesh: Any, size: Any = None, *, scale: float | None = None, cells: int | None = None,
    vertices: int | None = None, growth: float | None = None, most_cells: int = 20_000_000,
    adapt: str | Sequence[str] = (), **options: Unpack[OptionKeywords],
) -> Any:
    """Give a mesh other sizes: edges are split and collapsed, and the mesh is then optimised.

    Parameters
    ----------
    mesh : object             what :func:`odt_plugins.optimize` takes; it is never changed
    size : float, array, str or callable
                              length that edges should have: everywhere, one for each vertex (n,) or
                              cell (m,), the name of a point or cell array of them, or a function
                              size(points) -> (k,), asked between the vertices too unless the
                              boundary is fixed. "curvature": as coarse as `envelope` allows
                              where a surface, an interface or a feature line is curved, and growing
                              from there
    scale : float             instead, a multiple of the local size that the mesh has: 2 is twice as
                              coarse everywhere; with a `metric`, of the lengths that it gives,
                              which are what is wanted where nothing else is said
    cells, vertices : int     instead, how many there are to be, as near as possible, where sizes
                              are in proportion as they are; vertices are corners of cells. Of
                              several blocks or geometries, as many in all
    growth : float            largest ratio of the sizes at the ends of an edge as long as the
                              smaller one; what grows faster is made smaller. 1.3 unless given, 3
                              with a `metric`, of lengths in any direction
    most_cells : int          a mesh of more is refused before it is made
    adapt : str or list of str
                              point arrays to whose second derivatives sizes and shapes of cells are
                              adapted, see :func:`odt_plugins.metric_from_field`; beside `cells` or
                              `vertices`. Tetrahedra are stretched less where their boundary allows
                              no longer edges, as the report says
    **options
                              The fields of :class:`odt_plugins.Options`, but `insert` and
                              `density`. The default of `boundary` is "slide" here: vertices of the
                              boundary, of interfaces between regions and of feature lines are
                              moved, added and removed within `envelope`, corners stay; with
                              "fixed", and by default of parts that touch, all of these stay bit for
                              bit. Figures named in `keep` do not fall; unless some are named, good
                              ones may fall as far as to good ones, and means and shares where
                              only good cells become fewer

    Returns
    -------
    same type as `mesh`       Vertices that are left keep their order, new ones come last. Fields
                              are interpolated, cell data are those of the nearest input cell of the
                              same region. Lines and triangles beside the cells become others of
                              the same labels where the boundary is resized. What cannot be
                              reached is not done, and the report says so

    Raises
    ------
    InvalidOptionError        sizes that are not positive lengths, too small, or for too many cells
    UnsupportedMeshError      cells of another order than the first and the second

    References
    ----------
    J.-F. Remacle et al., Tetrahedral mesh adaptation; M. Botsch, L. Kobbelt, A remeshing approach
    to multiresolution modeling, SGP 2004: rounds of splits, collapses, flips and moves. The moves
    are those of :func:`odt_plugins.optimize` with rho = h^-(d + 2).

    Examples
    --------
    >>> import numpy as np
    >>> import odt_plugins
    >>> points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    >>> finer, _ = odt_plugins.remesh((points, np.array([[0, 1, 2, 3]])), 0.4)  # doctest: +SKIP
    """
    wishes: dict[str, Any] = {"scale": scale, "cells": cells, "vertices": vertices,
                              "growth": growth, "most_cells": most_cells, "adapt": adapt}
    if has_parts(mesh):
        return _run_parts(mesh, size, wishes, options)[0]
    return _run(mesh, size, wishes, _checked(options))[0]


@with_option_signature(*NOT_SIZED, boundary="slide")
def remesh_with_report(
    mesh: Any, size: Any = None, *, scale: float | None = None, cells: int | None = None,
    vertices: int | None = None, growth: float | None = None, most_cells: int = 20_000_000,
    adapt: str | Sequence[str] = (), **options: Unpack[OptionKeywords],
) -> tuple[Any, Report]:
    """Give a mesh other sizes as :func:`remesh` does and tell what was done.

    Returns
    -------
    mesh : same type as the input
    report : Report     its notes say how many edges have their size, and where they do not; of an
                        object of several meshes its `parts` are those of each
    """
    from odt_plugins.report.joined import report_of_parts
    from odt_plugins.report.report import make_report

    wishes: dict[str, Any] = {"scale": scale, "cells": cells, "vertices": vertices,
                              "growth": growth, "most_cells": most_cells, "adapt": adapt}
    if has_parts(mesh):
        whole, reports = _run_parts(mesh, size, wishes, options)
        return whole, report_of_parts(reports)
    chosen = _checked(options)
    result, before, outcome, told = _run(mesh, size, wishes, chosen)
    return result, make_report(before, outcome, replace(chosen, density="keep"), **told)


def _run_parts(
    mesh: Any, size: Any, wishes: dict[str, Any], options: Any
) -> tuple[Any, list[Report]]:
    """Results and reports of the parts of an object, which have numbers of cells together."""
    totals = {name: plain_values(name, wishes[name]) for name in ("cells", "vertices")}
    wish = _wish(size, wishes, metric=options.get("metric") is not None)
    named = {"size": size if wish.given else None, "adapt": wishes["adapt"] or ()}
    _checked(options)
    one = partial(remesh_with_report, size=size, **wishes)
    return run_parts(mesh, options, one, slides=True, totals=totals, named=named)


def _checked(options: Any) -> Options:
    """Options of a run without those that sizes take the place of."""
    given = [name for name in NOT_SIZED if name in options]
    if given:
        msg = f"got {given[0]}= for remeshing; expected sizes by size, scale, cells or vertices"
        raise InvalidOptionError(msg)
    known = [name for name in OPTIONS if name not in NOT_SIZED]
    expect_known(options, ["size", *WISHES, *known], "options", STAYS_SIZED)
    chosen = make_options(**{"boundary": "slide", **options})
    if not {*chosen.free} <= {*STAYS_SIZED}:
        msg = (f"got free='inside' for remeshing, where facets inside of a region stay; expected "
               f"some of {list(STAYS_SIZED)}")
        raise InvalidOptionError(msg)
    return chosen


def _with_still_walls(mesh: SimplexMesh) -> SimplexMesh:
    """The mesh whose regions are its bodies: a cell at every facet between regions of one stays."""
    if not mesh.body.size:
        return mesh
    key = directed_facets(mesh.cells, len(mesh.points))[0].ravel()
    order = np.argsort(key, kind="stable")
    twin = np.flatnonzero(key[order][1:] == key[order][:-1])
    one, other = order[twin] // mesh.cells.shape[1], order[twin + 1] // mesh.cells.shape[1]
    inside = (mesh.regions[one] != mesh.regions[other]) & (
        mesh.bodies()[one] == mesh.bodies()[other])
    frozen = np.zeros(len(mesh.cells), dtype=np.bool_)
    frozen[np.where(mesh.regions[one] > mesh.regions[other], one, other)[inside]] = True
    return freeze(of_bodies(mesh), frozen)


def check_sizes(size: Any = None, **given: Any) -> None:
    """Refuse sizes and options of :func:`remesh` before any work is done."""
    wishes = {name: value for name, value in given.items() if name in WISHES}
    _wish(size, wishes, metric=given.get("metric") is not None)
    _checked({name: value for name, value in given.items() if name not in WISHES})


def _wish(size: Any, wishes: dict[str, Any], *, metric: bool) -> Wish:
    """What the arguments ask for."""
    from odt_plugins.engine.remesh.wish import GROWTH as OF_SIZES
    from odt_plugins.engine.remesh.wish import Wish
    from odt_plugins.metric.limits import GROWTH as OF_METRICS

    wishes = {name: plain_values(name, value) for name, value in wishes.items()}
    adapt, length = wishes.get("adapt"), None
    size = plain_values("size", size)
    names = () if adapt is None else [adapt] if isinstance(adapt, str) else adapt
    if not isinstance(names, list | tuple) or not all(isinstance(name, str) for name in names):
        msg = (f"got adapt= of type {type(adapt).__name__}; expected names of point arrays, try "
               f"metric=odt_plugins.metric_from_field(mesh, values, cells) for values")
        raise InvalidOptionError(msg)
    expect("" not in names, "adapt", adapt, "names of point arrays")
    if adapt and metric:
        msg = "got adapt= and metric=; expected one of them"
        raise InvalidOptionError(msg)
    asked = [name for name, value in ({"size": size} | wishes).items()
             if name in ("size", "scale", "cells", "vertices") and value is not None]
    if adapt and not {"cells", "vertices"} & {*asked}:
        msg = "got adapt= without a number of cells; expected cells= or vertices= beside it"
        raise InvalidOptionError(msg)
    if adapt and len(asked) > 1:
        msg = (f"got adapt= with {' and '.join(f'{name}=' for name in asked)}; expected cells= or "
               "vertices= alone beside it")
        raise InvalidOptionError(msg)
    metric = metric or bool(adapt)
    named = isinstance(size, str) and size != ""
    given = named or callable(size) or even_rows("size", size).ndim > 0
    if size is not None and not given:
        try:
            length = float("" if isinstance(size, bool | np.bool_) else size)
        except (TypeError, ValueError) as exc:
            msg = (f"got size={size!r}; expected a length, an array of lengths or its name, a "
                   f"function or {CURVATURE!r}")
            raise InvalidOptionError(msg) from exc
    if metric and size is not None:
        msg = "got size= and metric=; expected one of them, try scale= for a multiple of a metric"
        raise InvalidOptionError(msg)
    if metric and not asked:
        wishes = wishes | {"scale": 1.0}
    if wishes.get("growth") is None:
        wishes = wishes | {"growth": OF_METRICS if metric else OF_SIZES}
    curved = isinstance(size, str) and size == CURVATURE
    numbers = {name: value for name, value in wishes.items() if name != "adapt"}
    return Wish(length=length, curved=curved, given=given and not curved, **numbers)


def _run(mesh: Any, size: Any, wishes: dict[str, Any], options: Options) -> tuple[Any, ...]:
    """What :func:`odt_plugins.carrying.roundtrip.run_engine` gives."""
    wish = _wish(size, wishes, metric=options.metric is not None)
    if options.fields == "auto":
        options = replace(options, fields="interpolate")
    if wishes.get("adapt"):
        return _run_adapted(mesh, wish, wishes["adapt"], wishes["growth"], options)
    name = size if wish.given and isinstance(size, str) else ""
    if wish.given and not name:
        options = replace(options, density=make_options(density=size).density)
    return _run_once(mesh, wish, options, name)


def _run_adapted(
    mesh: Any, wish: Wish, names: str | Sequence[str], growth: float | None, options: Options
) -> tuple[Any, ...]:
    """As :func:`_run`, in a metric whose cells are stretched as far as the boundary allows.

    Where the boundary does not allow the longest lengths, cells are more by about the square root
    of the ratio of lengths.
    """
    from odt_plugins.metric.field import adapted_metric, largest_ratio

    def crowded(multiple: float) -> None:
        if multiple > MOST_CROWDED:
            raise _CrowdedError(multiple)

    ratio: float | None = None
    before, notes = np.inf, tuple[str, ...]()
    for tried in range(STRETCHES):
        metric = adapted_metric(mesh, names, wish.cells, wish.vertices, growth, ratio)
        ratio = largest_ratio(metric)
        more = tried < STRETCHES - 1 and ratio > 2.0 * LEAST_STRETCHED
        try:
            return _run_once(mesh, replace(wish, crowded=crowded if more else None),
                             replace(options, metric=metric), notes=notes)
        except _CrowdedError as found:
            multiple: float = found.args[0]
            if multiple > HARDLY_FEWER * before:
                break
            less = max(ratio * min((MOST_CROWDED / multiple) ** 2, 0.5), LEAST_STRETCHED)
            notes = (f"cells are to be stretched {less:.3g} times at most, as {ratio:.4g} times "
                     f"made {multiple:.2g} times as many as asked for: the boundary allows no "
                     "longer edges",)
            ratio, before = less, multiple
    metric = adapted_metric(mesh, names, wish.cells, wish.vertices, growth, None)
    return _run_once(mesh, wish, replace(options, metric=metric))


def _run_once(
    mesh: Any, wish: Wish, options: Options, name: str = "", notes: tuple[str, ...] = ()
) -> tuple[Any, ...]:
    """Run the engine with sizes, of an array of that name if any; the report has the notes, too."""

    def engine(simplices: SimplexMesh, chosen: Options, leaving: Leaving) -> Outcome:
        from odt_plugins.engine.remesh.run import remesh as resized

        outcome = resized(_with_still_walls(simplices), chosen, leaving, wish)
        outcome = replace(outcome, notes=notes + outcome.notes)
        if not simplices.is_surface or simplices.frozen.all():
            return outcome
        from odt_plugins.engine.retile.run import with_kept

        return with_kept(simplices, outcome, chosen)

    wanted = Wanted(linear=True, sizes=name, growth=wish.growth,
                    refused=(*NOT_SIZED, "free='inside'"))
    return run_engine(mesh, options, engine, wanted)
