"""The subcommand ``odt-plugins mesh``."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from odt_plugins.cli.flags import QUIET_FLAG, refuse
from odt_plugins.cli.terminal import (
    check_paths,
    progress_bar,
    tell_report,
    warnings_told,
    write_beside,
)
from odt_plugins.errors import InvalidOptionError
from odt_plugins.options import EDGE_LENGTH

SEED, MOST_POINTS = 2011, 10_000_000


@click.command(short_help="Make a mesh of a domain or a closed surface.")
@click.argument("what", metavar="DOMAIN")
@click.argument("target", metavar="OUTPUT", type=click.Path(path_type=Path))
@click.option("--size", type=float, default=None, metavar="H0",
              help="Edge length where the mesh is finest.  [default: the domain's own]")
@click.option("--levels", type=click.IntRange(min=0), default=None,
              help="How often a coarse mesh is refined.  [default: chosen by the size]")
@click.option("--seed", type=click.IntRange(min=0), default=None,
              help="Seed of the points that are left out where edges may be longer.  "
              f"[default: {SEED}]")
@click.option("--most-points", type=click.IntRange(min=3), default=None,
              help=f"Refuse sizes that would give more vertices.  [default: {MOST_POINTS}]")
@click.option("--edge-length", type=float, default=None, metavar="PART",
              help="Of TetWild's coarse mesh, as a part of the diagonal.  "
              f"[default: {EDGE_LENGTH}]")
@click.option("--envelope", type=float, default=None, metavar="PART",
              help="How far the boundary may be from the surface, as a part of the diagonal.  "
              "[default: 0.001]")
@click.option("--threads", type=click.IntRange(min=1), default=None,
              help="Worker threads for tetrahedra; the result does not depend on it.  [default: 1]")
@click.option("--report", "report_file", type=click.Path(path_type=Path), metavar="FILE.json",
              help="Write the figures of the mesh there as JSON.")
@QUIET_FLAG
def mesh(
    what: str,
    target: Path,
    size: float | None,
    levels: int | None,
    seed: int | None,
    most_points: int | None,
    edge_length: float | None,
    envelope: float | None,
    threads: int | None,
    report_file: Path | None,
    quiet: bool,
) -> int:
    """Make a mesh of triangles of DOMAIN, or of tetrahedra, and write it to OUTPUT.

    DOMAIN is one of the paper's, circle, ring, square, graded-square, crescent and pie, or a
    Python file that defines fd(p), the signed distance of points (n, 2), and optionally the sizes
    fh(p), bbox, pfix and h0, all as for distmesh. The file is run. OUTPUT is of any format that
    meshio knows, by its suffix.

    DOMAIN may also be the file of a closed surface of triangles, or of coarse tetrahedra. A surface
    is meshed coarsely by TetWild; then all is refined --levels times (1), moved to the surface and
    optimised.
    """
    from odt_plugins.adapters.files import check_output, expect_same_kind, write_arrays
    from odt_plugins.adapters.meshio_mesh import one_cell
    from odt_plugins.figures import summarize, uniformity
    from odt_plugins.generate.odtmesh import odtmesh2d
    from odt_plugins.generate.samples import SAMPLES
    from odt_plugins.generate.userfile import read_domain
    from odt_plugins.table import table_lines

    check_paths(Path(what), target, report_file)
    flat = what in SAMPLES or what.endswith(".py")
    check_output(target)
    expect_same_kind(one_cell(3 if flat else 4), target)
    if what in SAMPLES:
        sample, known = SAMPLES[what], True
    elif what.endswith(".py"):
        sample, known = read_domain(Path(what))
    elif Path(what).is_file():
        if any(given is not None for given in (size, seed, most_points)):
            msg = ("got --size, --seed or --most-points for a mesh of tetrahedra; expected "
                   "--edge-length and --levels")
            raise click.UsageError(msg)
        _refine(what, target, 1 if levels is None else levels, edge_length, envelope,
                1 if threads is None else threads, report_file, quiet)
        return 0
    else:
        msg = (f"got DOMAIN {what!r}; expected one of {', '.join(SAMPLES)}, a Python file (.py), "
               "or the file of a surface or of tetrahedra")
        raise InvalidOptionError(msg)
    if any(given is not None for given in (edge_length, envelope, threads)):
        msg = ("got --edge-length, --envelope or --threads for a mesh of triangles; expected "
               "--size")
        raise click.UsageError(msg)
    if size is None and not known:
        msg = f"{what} does not say h0; expected --size, the edge length where the mesh is finest"
        raise click.UsageError(msg)
    with warnings_told(quiet), progress_bar(quiet) as progress:
        points, cells = odtmesh2d(
            sample.fd, sample.fh, sample.h0 if size is None else size, sample.bbox, sample.pfix,
            level=levels, seed=SEED if seed is None else seed,
            most_points=MOST_POINTS if most_points is None else most_points, progress=progress,
        )
        write_arrays(target, points, cells)
    summary = replace(summarize(points, cells), uniformity=uniformity(points, cells, sample.fh))
    if not quiet:
        click.echo("\n".join(table_lines({sample.title: summary})))
    if report_file:
        values = {"domain": sample.title, **summary.to_dict()}
        write_beside(report_file, lambda path: path.write_text(json.dumps(values, indent=2) + "\n"))
    return 0


def _refine(
    what: str, target: Path, levels: int, edge_length: float | None, envelope: float | None,
    threads: int, report_file: Path | None, quiet: bool,
) -> None:
    """Make tetrahedra of a surface, or more of coarse ones."""
    from odt_plugins.adapters.files import read, write_file
    from odt_plugins.generate.levels import refine_with_report

    if edge_length is not None and read(Path(what)).cells.shape[1] == 4:
        refuse("edge_length", "for tetrahedra that are there", "the file of a surface")
    options: Any = {"edge_length": edge_length, "envelope": envelope}
    options = {name: value for name, value in options.items() if value is not None}
    with warnings_told(quiet), progress_bar(quiet) as progress:
        out, report = refine_with_report(
            what, levels, threads=threads, progress=progress, **options)
        write_file(target, out)
    tell_report(report, report_file, quiet)
