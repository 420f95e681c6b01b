"""The command that gives a mesh file other sizes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from odt_plugins.cli.flags import some_option_flags
from odt_plugins.cli.named import resolve_arrays
from odt_plugins.cli.terminal import (
    check_paths,
    in_flags,
    progress_bar,
    warnings_told,
    write_beside,
)
from odt_plugins.options import OPTIONS
from odt_plugins.remeshing import NOT_HERE


@click.command(short_help="Make a mesh file coarser or finer, with all its data.")
@click.argument("source", metavar="INPUT", type=click.Path(path_type=Path))
@click.argument("target", metavar="OUTPUT", type=click.Path(path_type=Path))
@click.option("--size", default=None, metavar="LENGTH",
              help="Length that edges should have, or the name of a point or cell array of INPUT "
                   "with lengths.")
@click.option("--scale", type=float, default=None,
              help="Instead: multiple of the local size that INPUT has; 2 is twice as coarse.")
@click.option("--cells", type=int, default=None, help="Instead: how many cells, about.")
@click.option("--vertices", type=int, default=None, help="Instead: how many vertices, about.")
@click.option("--growth", type=float, default=1.3, show_default=True,
              help="Largest ratio of the sizes at the ends of an edge as long as the smaller one.")
@click.option("--most-cells", type=int, default=20_000_000, show_default=True,
              help="Refuse to make more cells.")
@click.option("--boundary", type=click.Choice(OPTIONS["boundary"].metadata["choices"]),
              default="slide", show_default=True,
              help="slide moves, adds and removes vertices of the boundary, of interfaces and of "
                   "feature lines within the envelope; fixed keeps all of these bit for bit.")
@some_option_flags(*(name for name in OPTIONS if name not in (*NOT_HERE, "boundary")))
@click.option("--report", "report_file", type=click.Path(path_type=Path), metavar="FILE.json",
              help="Write the report there as JSON.")
@click.option("--quiet", is_flag=True, help="Print nothing but errors.")
def remesh(
    source: Path, target: Path, size: str | None, scale: float | None, cells: int | None,
    vertices: int | None, growth: float, most_cells: int, report_file: Path | None, quiet: bool,
    **options: Any,
) -> int:
    """Give the mesh INPUT other sizes and write it to OUTPUT with all its data.

    One of --size, --scale, --cells and --vertices says how fine it is to be. Surfaces stay within
    --envelope of those of INPUT, both ways.
    """
    check_paths(target, report_file, None)
    options = resolve_arrays(source, {**options, "size": size})
    from odt_plugins.adapters.files import check_output, read_file, write_file
    from odt_plugins.remeshing import remesh_with_report

    check_output(target)
    with warnings_told(quiet), progress_bar(quiet) as progress:
        found, report = remesh_with_report(
            read_file(source), scale=scale, cells=cells, vertices=vertices, growth=growth,
            most_cells=most_cells, **options | {"progress": progress})
        write_file(target, found)
    if not quiet:
        click.echo(in_flags(str(report)))
    if report_file:
        write_beside(report_file, lambda path: path.write_text(report.to_json() + "\n"))
    return 0
