"""The command that gives a mesh file other sizes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from odt_plugins.cli.flags import (
    QUIET_FLAG,
    REPORT_FLAG,
    given,
    size_flags,
    some_option_flags,
    take_sizes,
)
from odt_plugins.cli.named import resolve_arrays
from odt_plugins.cli.terminal import check_paths, progress_bar, tell_report, warnings_told
from odt_plugins.options import NOT_SIZED, OPTIONS


@click.command(short_help="Make a mesh file coarser or finer, with all its data.")
@click.argument("source", metavar="INPUT", type=click.Path(path_type=Path))
@click.argument("target", metavar="OUTPUT", type=click.Path(path_type=Path))
@size_flags()
@click.option("--boundary", type=click.Choice(OPTIONS["boundary"].metadata["choices"]),
              default="slide", show_default=True,
              help="slide moves, adds and removes vertices of the boundary, of interfaces and of "
                   "feature lines within the envelope; fixed keeps all of these bit for bit.")
@some_option_flags(*(name for name in OPTIONS if name not in (*NOT_SIZED, "boundary")))
@REPORT_FLAG
@QUIET_FLAG
def remesh(
    source: Path, target: Path, report_file: Path | None, quiet: bool, **options: Any
) -> int:
    """Give the mesh INPUT other sizes and write it to OUTPUT with all its data.

    One of --size, --scale, --cells and --vertices says how fine it is to be. Surfaces stay within
    --envelope of those of INPUT, both ways.
    """
    check_paths(source, target, report_file)
    sizes = take_sizes(options)
    if not given("boundary"):
        del options["boundary"]
    from odt_plugins.adapters.files import check_output, expect_same_kind, read_file, write_file
    from odt_plugins.remeshing import remesh_with_report

    check_output(target)
    with warnings_told(quiet), progress_bar(quiet) as progress:
        options = resolve_arrays(source, options)
        mesh = read_file(source)
        expect_same_kind(mesh, target)
        found, report = remesh_with_report(mesh, **sizes | options | {"progress": progress})
        write_file(target, found)
    tell_report(report, report_file, quiet)
    return 0
