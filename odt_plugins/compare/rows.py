"""Rows of the comparison: one contestant on one start mesh, measured by one measure for all."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.compare.contestants import OURS, Contestant, refusals
from odt_plugins.compare.hull import ROUNDING, BoundaryChange, compare_boundaries, labels_of
from odt_plugins.compare.measures import further
from odt_plugins.compare.own import keep_mesh, of_file
from odt_plugins.compare.poisson import PoissonFigures, solve_poisson
from odt_plugins.compare.runner import Limits, Run, run_contestant
from odt_plugins.compare.start import StartMesh, distinct
from odt_plugins.errors import InvalidMeshError, MissingDependencyError
from odt_plugins.figures import QualitySummary, cell_figures, summarize
from odt_plugins.generate.clouds import SEED
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.mesh.simplex import reverse
from odt_plugins.promise.volume import LOWER_IS_BETTER

BINS = 50
"""Bins of the quality histograms, from 0 to 1."""

RIVALRY = ("min_quality", "p1_quality", "mean_quality", "min_angle", "max_angle", "below_20")
"""Figures by which a row is held against ours."""

WORST = 60
"""Cells kept for the pictures."""

MARGIN = 1e-9
"""Relative difference below which two figures are the same."""


@dataclass(frozen=True)
class Measured:
    """A mesh as it is measured: the start itself, or what a contestant made of it.

    Attributes
    ----------
    summary : QualitySummary          inverted cells are those against the mesh's own orientation
    histogram : list of int           cells in BINS bins of the radius ratio
    worst : list of cells             corners (k, d) of the worst cells and their quality
    boundary : BoundaryChange
    volume_change : float             relative to the volume of the start, of the region where it
                                      changed most; None on a surface
    poisson : PoissonFigures or None
    further : dict                    see :func:`odt_plugins.compare.measures.further`
    regions_ignored : bool            the start has regions, and this mesh came back without
    """

    summary: QualitySummary
    histogram: list[int]
    worst: list[tuple[list[list[float]], float]]
    boundary: BoundaryChange
    volume_change: float | None
    poisson: PoissonFigures | None
    further: dict[str, float] = field(default_factory=dict)
    regions_ignored: bool = False


@dataclass(frozen=True)
class Timing:
    """Seconds of all repeats: median, least, most; memory in bytes.

    `cpu` is the median of the processor time, which other work on the machine disturbs less.
    """

    runs: int
    median: float
    least: float
    most: float
    convert: float
    imports: float
    compile: float | None
    peak: int
    growth: int
    cpu: float


@dataclass(frozen=True)
class Row:
    """One contestant on one start mesh; every row stays, whatever became of it.

    Attributes
    ----------
    mesh, kind, contestant, family, remark : str
    settings : dict                  of the contestant
    version : str or None            of its package
    threads, seed : int
    status, message : str            of :class:`odt_plugins.compare.runner.Run`
    measured : Measured or None      of the first repeat
    spread : float                   largest minus least mean quality over the repeats
    repeats_itself : bool or None    all repeats gave the same bits
    timing : Timing or None
    better_than_ours : tuple         names of the figures in which it beats our default, with
                                     "seconds" when it is also faster
    freer : str                      why that is no plain win: what it was free to do and ours was
                                     not, "" where it kept to the same
    """

    mesh: str
    kind: str
    contestant: str
    family: str
    remark: str
    settings: dict[str, Any]
    version: str | None
    threads: int
    seed: int
    status: str
    message: str = ""
    measured: Measured | None = None
    spread: float = 0.0
    repeats_itself: bool | None = None
    timing: Timing | None = None
    better_than_ours: tuple[str, ...] = ()
    freer: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Give the row as plain values, without the cells for the pictures."""
        out = asdict(self)
        if self.measured is not None:
            del out["measured"]["worst"]
            out["measured"]["summary"] = self.measured.summary.to_dict()
            out["measured"]["boundary"] = self.measured.boundary._asdict()
        return out


@dataclass(frozen=True)
class MeshResult:
    """One start mesh, its own figures, and the row of everybody.

    `drawn` holds the boundary of the start for the pictures: (points, facets).
    """

    start: StartMesh
    measured: Measured
    rows: list[Row] = field(default_factory=list)


def compare_on(
    start: StartMesh,
    contestants: Sequence[Contestant],
    limits: Limits,
    *,
    poisson: bool = True,
    results: Sequence[Path] = (),
    keep: Path | None = None,
    begin: Callable[[Contestant], None] = lambda contestant: None,
) -> MeshResult:
    """Run all contestants for this kind of mesh, one after the other, and measure them.

    Parameters
    ----------
    start : StartMesh
    contestants : sequence      a tool of which none is for this kind of mesh has one row, which
                                says why
    limits : Limits
    poisson : bool              whether the Poisson problem is solved on every result
    results : sequence of Path  mesh files that are measured as what others made of the start
    keep : Path                 folder for the start and every result, as .vtu files
    begin : callable            is given every contestant before it runs
    """
    before = measure_mesh(start, start.points, start.cells, start.regions, poisson=poisson)
    names = [path.name for path in results]
    found = [of_file(path, start) for path in results]
    own = distinct(replace(who, name=str(path)) if names.count(path.name) > 1 else who
                   for path, (who, _) in zip(results, found, strict=True))
    files = zip(own, [run for _, run in found], strict=True)
    if keep is not None:
        keep_mesh(keep, start, "start", start.points, start.cells, start.regions)
    rows = []
    for contestant, run in chain(_runs(start, contestants, limits, begin), files):
        rows.append(make_row(start, contestant, run, limits, poisson=poisson))
        if keep is not None and rows[-1].measured is not None:
            keep_mesh(keep, start, contestant.name, *run.meshes[0])
    return MeshResult(start, before, mark(rows))


def _runs(
    start: StartMesh, contestants: Sequence[Contestant], limits: Limits,
    begin: Callable[[Contestant], None],
) -> Iterator[tuple[Contestant, Run]]:
    """Run the contestants that take the mesh; of a tool of which none does, tell once why."""
    refused = refusals(start.kind, contestants)
    for contestant in contestants:
        if start.kind in contestant.kinds:
            begin(contestant)
            yield contestant, run_contestant(start, contestant, limits)
        elif contestant.family in refused:
            name, why = refused.pop(contestant.family)
            yield replace(contestant, name=name, settings={}), Run("unsupported", why)


def make_row(
    start: StartMesh, contestant: Contestant, run: Run, limits: Limits, *, poisson: bool
) -> Row:
    """Measure what a contestant returned."""
    row = Row(start.name, start.kind, contestant.name, contestant.family, contestant.remark,
              contestant.settings, contestant.installed() if contestant.package else None,
              limits.threads, SEED, run.status, run.message)
    if run.status != "ok":
        return row
    prints = {_fingerprint(*mesh) for mesh in run.meshes}
    others = run.meshes[1:] if len(prints) > 1 else []
    try:
        measured = measure_mesh(start, *run.meshes[0], poisson=poisson)
        means = [measured.summary.mean_quality,
                 *(oriented(start, *mesh)[1].mean_quality for mesh in others)]
    except (InvalidMeshError, MissingDependencyError) as exc:
        return replace(row, status="failed", message=str(exc))
    # Whatever a tool returns, such as coordinates of 1e300, is a row.
    except Exception as exc:
        message = f"its mesh cannot be measured: {type(exc).__name__}: {exc}"
        return replace(row, status="failed", message=message)
    if not run.facts:
        return replace(row, measured=measured)
    facts = run.facts
    seconds = facts["seconds"]
    timing = Timing(len(seconds), float(np.median(seconds)), min(seconds), max(seconds),
                    float(np.median(facts["convert"])), facts["import"], facts["compile"],
                    facts["peak"], facts["peak"] - facts["peak_before"],
                    float(np.median(facts["cpu"][:len(seconds)])))
    return replace(row, measured=measured, spread=max(means) - min(means), timing=timing,
                   repeats_itself=len(prints) == 1 if len(run.meshes) > 1 else None)


def measure_mesh(
    start: StartMesh, points: FloatArray, cells: IntArray, regions: IntArray | None = None, *,
    poisson: bool,
) -> Measured:
    """Measure a mesh against the start: quality, boundary, volume, Poisson problem."""
    mesh, summary, figures = oriented(start, points, cells, regions)
    ignored = mesh.regions is None and start.regions is not None
    same = replace(start, regions=None) if ignored else start
    order = np.argsort(figures.quality, kind="stable")[:WORST]
    worst = [(mesh.points[mesh.cells[i]].tolist(), float(figures.quality[i])) for i in order]
    histogram = np.histogram(np.clip(figures.quality, 0.0, 1.0), BINS, (0.0, 1.0))[0]
    change = None
    if start.kind != "surface":
        before = _volumes(same, cell_figures(start.points, start.cells).volume)
        after = _volumes(mesh, figures.volume)
        change = max((after.get(label, 0.0) / before[label] - 1.0 for label in before), key=abs)
    sound = poisson and summary.inverted == 0
    return Measured(summary, histogram.tolist(), worst, compare_boundaries(same, mesh), change,
                    _poisson(mesh, start) if sound else None,
                    further(mesh.points, mesh.cells), ignored)


def _volumes(mesh: StartMesh, volume: FloatArray) -> dict[int, float]:
    """Volume of every region."""
    labels = labels_of(mesh)
    return {label: float(volume[labels == label].sum()) for label in np.unique(labels).tolist()}


def oriented(
    start: StartMesh, points: NDArray[Any], cells: NDArray[Any],
    regions: NDArray[Any] | None = None,
) -> tuple[StartMesh, QualitySummary, Any]:
    """Turn a mesh whose cells are mostly negative: a tool may have its own orientation.

    Returns
    -------
    mesh without unused vertices, its summary, its figures per cell
    """
    used, inverse = np.unique(cells, return_inverse=True)
    t = inverse.reshape(cells.shape).astype(np.int32)
    p = np.ascontiguousarray(points[used])
    figures = cell_figures(p, t)
    if 2 * int((figures.volume < 0).sum()) > len(t):
        t = reverse(t, np.ones(len(t), dtype=np.bool_))
        figures = cell_figures(p, t)
    mesh = replace(start, points=p, cells=np.ascontiguousarray(t),
                   regions=None if start.regions is None else regions)
    return mesh, summarize(p, t, figures), figures


def mark(rows: Sequence[Row]) -> list[Row]:
    """Write into every row in which figures it is better than our default on the same mesh.

    A row with inverted cells beats nobody. If ours has no result, every other that has one is
    better in everything. A row that moved the boundary further than ours, or ignored the regions,
    was freer, and what it wins by that is no plain win.
    """
    ours = next((row for row in rows if row.contestant == OURS), None)
    out = []
    for row in rows:
        names: tuple[str, ...] = ()
        freer = ""
        sound = row.measured is not None and row.measured.summary.inverted == 0
        if ours is not None and row is not ours and sound and row.family != ours.family:
            names, freer = _better(row, ours), _freer(row, ours)
        out.append(replace(row, better_than_ours=names, freer=freer))
    return out


def _freer(row: Row, ours: Row) -> str:
    if row.measured is None:
        return ""
    if row.measured.regions_ignored:
        return "regions ignored"
    limit = ours.measured.boundary.reach if ours.measured else math.inf
    if row.measured.boundary.reach > max(limit * (1.0 + MARGIN), ROUNDING):
        return f"{'boundary' if row.kind == 'planar' else 'surface'} moved further than ours"
    return ""


def _better(row: Row, ours: Row) -> tuple[str, ...]:
    if row.measured is None or ours.measured is None:
        return RIVALRY
    a, b = row.measured.summary, ours.measured.summary
    names = []
    for name in RIVALRY:
        x, y = float(getattr(a, name)), float(getattr(b, name))
        slack = MARGIN * max(abs(x), abs(y))
        better = x < y - slack if name in LOWER_IS_BETTER else x > y + slack
        if better:
            names.append(name)
    if row.timing and ours.timing and row.timing.median < ours.timing.median:
        names.append("seconds")
    return tuple(names)


def _poisson(mesh: StartMesh, start: StartMesh) -> PoissonFigures | None:
    try:
        return solve_poisson(mesh, start)
    except ImportError:
        return None


def _fingerprint(*arrays: NDArray[Any] | None) -> str:
    given = [np.ascontiguousarray(array).tobytes() for array in arrays if array is not None]
    return hashlib.sha256(b"".join(given)).hexdigest()
