"""The subcommand ``odt-plugins compare``: what it takes, what it shows in the terminal."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from odt_plugins.cli.flags import some_number
from odt_plugins.cli.terminal import check_folder, command_line
from odt_plugins.compare.cells import BETTER, best_figures, cells_of, marked, seconds
from odt_plugins.compare.contestants import OURS, Contestant, choose
from odt_plugins.compare.output import FILES, write_all
from odt_plugins.compare.rows import MeshResult, Row, compare_on
from odt_plugins.compare.runner import Limits
from odt_plugins.compare.score import score_table, verdict
from odt_plugins.compare.start import distinct, read_start, stored
from odt_plugins.compare.start import suite as suite_meshes
from odt_plugins.compare.table import as_text
from odt_plugins.generate.clouds import SEED
from odt_plugins.report.machine import describe
from odt_plugins.report.template import check_page

CHOSEN_SUITES = ("standard", "large", "tangled", "remesh")


@click.command(short_help="Measure other tools on the same meshes.")
@click.argument("sources", metavar="[MESH]...", nargs=-1, type=click.Path(path_type=Path))
@click.option("--suite", type=click.Choice(CHOSEN_SUITES),
              help="Start meshes of the package: modest ones of every kind, or millions of cells; "
                   "tangled: every MESH, or the package's, with vertices that turn cells over; "
                   "remesh: each made anew with edges of other lengths.")
@click.option("--against", metavar="TOOL", multiple=True,
              help="Compare with this tool only (gmsh, netgen, mmg, cgal, stellar, tetgen, "
                   "tetwild, laplacian, pymeshlab, open3d, odt-plugins, the name of a row, or "
                   "module:name of a function of yours); may be repeated. Everybody unless given.")
@click.option("--result", "results", metavar="FILE", multiple=True,
              type=click.Path(path_type=Path),
              help="Measure this mesh file, too, as what another program made of the one MESH; may "
                   "be repeated.")
@click.option("--keep", type=click.Path(path_type=Path), metavar="DIR",
              help="Keep the start and what every contestant made of it in this directory.")
@click.option("--out", type=click.Path(path_type=Path), default=Path("comparison"),
              show_default=True, help="Directory for CSV, JSON, the page, Markdown, LaTeX, BibTeX.")
@click.option("--repeats", type=click.IntRange(min=1), default=3, show_default=True,
              help="Runs of every contestant; fewer where one takes long.")
@click.option("--time-limit", type=click.FloatRange(min=0.0, min_open=True), default=None,
              metavar="S", callback=some_number,
              help="Seconds after which a contestant is ended, without import and compilation.  "
                   "[default: 60, in suites 20 and 900]")
@click.option("--threads", type=click.IntRange(min=1), default=1, show_default=True,
              help="Threads that a contestant may use.")
@click.option("--poisson/--no-poisson", default=True, show_default=True,
              help="Solve the Poisson problem on every result.")
def compare(
    sources: tuple[Path, ...],
    suite: str | None,
    against: tuple[str, ...],
    results: tuple[Path, ...],
    keep: Path | None,
    out: Path,
    repeats: int,
    time_limit: float | None,
    threads: int,
    poisson: bool,
) -> int:
    """Run every installed tool on the same start MESH and measure all of them alike.

    Each tool runs in a process of its own; one that is not installed, crashes, hangs or breaks the
    boundary is a row that says so. Nothing is written outside --out, --keep and temporary folders.
    """
    check_page()
    if results and (suite or len(sources) != 1):
        msg = "got --result for several meshes; expected one MESH and no --suite beside it"
        raise click.UsageError(msg)
    if keep and suite in ("tangled", "remesh"):
        msg = f"got --keep for --suite {suite}, which keeps no meshes; expected another suite"
        raise click.UsageError(msg)
    check_folder(out, "--out")
    if keep:
        check_folder(keep, "--keep")
    if suite == "tangled":
        from odt_plugins.compare.tangled import FILE, run_tangled

        meshes = distinct(map(read_start, sources)) or [stored("bunny"), stored("bone")]
        click.echo(run_tangled(out, meshes, against, Limits(time_limit or 60.0, repeats, 2.0,
                               threads), say=lambda name: click.echo(name, err=True)))
        click.echo(f"written: {out / FILE}")
        return 0
    if suite == "remesh":
        from odt_plugins.compare.sized import FILE as SIZED
        from odt_plugins.compare.sized import run_sized

        click.echo(run_sized(out, distinct(map(read_start, sources)), against, Limits(
            time_limit or 60.0, repeats, 2.0, threads), lambda name: click.echo(name, err=True)))
        click.echo(f"written: {out / SIZED}")
        return 0
    if not sources and suite is None:
        msg = "nothing to compare on; give a mesh file, or --suite standard"
        raise click.UsageError(msg)
    contestants = choose(against)
    starts = distinct([*map(read_start, sources), *(suite_meshes(suite) if suite else [])])
    usual = {"standard": 20.0, "large": 900.0}.get(suite or "", 60.0)
    limit = time_limit or usual
    limits = Limits(limit, repeats, min(1.5, limit / 4), threads)
    words = command_line(click.get_current_context(), out=out, repeats=repeats,
                         time_limit=limit, threads=threads)
    found: list[MeshResult] = []
    for start in starts:
        view = _Table(start.name)
        result = compare_on(start, contestants, limits, poisson=poisson, begin=view.begin,
                            results=results, keep=keep)
        view.show(result)
        found.append(result)
        write_all(out, found, describe(threads, SEED), words)
    score = score_table(found)
    if score:
        click.echo("\n".join([*as_text(score)[1:], ""]))
    click.echo("written: " + ", ".join(str(out / name) for name in FILES))
    return 0


class _Table:
    """Shows who is running, and the table of one mesh when it is complete."""

    def __init__(self, start_name: str) -> None:
        from rich.console import Console

        self.name = start_name
        self.console = Console()
        width = self.console.width if self.console.is_terminal else WIDTH
        self.console = Console(width=max(width, WIDTH))
        self.progress = Console(stderr=True)

    def begin(self, contestant: Contestant) -> None:
        """Name the contestant that runs, on a terminal only."""
        if self.progress.is_terminal:
            self.progress.print(f"[dim]{self.name}: {contestant.name}[/dim]", highlight=False)

    def show(self, result: MeshResult) -> None:
        """Print the table of a mesh, and the sentence that says what ours loses."""
        self.console.print(make_table(result), crop=False)
        for message, names in _not_measured(result).items():
            click.echo(f"{', '.join(names)}: {message}")
        click.echo(verdict(result) + "\n")


WIDTH = 140
"""Columns of a table where the terminal is narrower or the output goes to a file."""

SHOWN = ("min_quality", "p1_quality", "mean_quality", "min_angle", "max_angle", "below_20",
         "inverted", "n_points", "n_cells")


def make_table(result: MeshResult) -> Any:
    """Make the rich table of one mesh: best in bold, ▲ or △ where a row beats our default."""
    from rich.table import Table

    start = cells_of(result.measured)
    table = Table(
        title=f"{result.start.name}: {result.start.about}",
        title_justify="left", header_style="bold", show_edge=False, pad_edge=False,
    )
    table.add_column("contestant", no_wrap=True)
    for head in ("seconds", "min q", "1 % q", "mean q", "from", "to", "<20°", "inv.", "vertices",
                 "cells"):
        table.add_column(head, justify="right", no_wrap=True)
    place = "surface" if result.start.kind == "surface" else "boundary"
    table.add_column(place, no_wrap=True)
    table.add_column("CG", justify="right")
    table.add_row("start", "", *(start[f] for f in SHOWN), "", start["cg"], style="dim")
    for row in result.rows:
        style = "bold" if row.contestant == OURS else ""
        if row.measured is None:
            table.add_row(row.contestant, *[""] * 10, row.status, "", style=style or "dim")
            continue
        cells, best = cells_of(row.measured), best_figures(row, result.rows)
        took = seconds(row.timing.median) if row.timing else ""
        took = _shown(row, "seconds", took, best)
        figures = [_shown(row, f, cells[f], best) for f in SHOWN]
        table.add_row(row.contestant, took, *figures, cells["farthest"], cells["cg"], style=style)
    return table


def _not_measured(result: MeshResult) -> dict[str, list[str]]:
    """Contestants without a result, by what is to be said about them."""
    found: dict[str, list[str]] = {}
    for row in result.rows:
        if row.measured is None:
            found.setdefault(f"{row.status}, {row.message}", []).append(row.contestant)
    return found


def _shown(row: Row, figure: str, text: str, best: set[str]) -> str:
    mark = marked(row, figure, "")
    text = f"[bold]{text}[/bold]" if figure in best else text
    return f"[{'dark_orange3' if mark == BETTER else 'dim'}]{mark}[/]{text}" if mark else text
