"""The command line ``odt-plugins``. Only here is anything printed."""

from __future__ import annotations

import errno
import json
import os
import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

import click

from odt_plugins.cli.flags import (
    EDGE_LENGTH,
    LEVELS,
    QUIET_FLAG,
    REPORT_FLAG,
    chosen,
    cluster_flags,
    given,
    instead_of,
    limit_flags,
    option_flags,
    refuse,
    refuse_for_kind,
    size_flags,
    some_number,
    some_option_flags,
    take_sizes,
)
from odt_plugins.cli.named import resolve_arrays
from odt_plugins.cli.terminal import (
    Command,
    ShareOption,
    beyond_limits,
    check_paths,
    command_line,
    in_flags,
    one_line,
    progress_bar,
    tell_report,
    warnings_told,
    write_beside,
)
from odt_plugins.errors import InvalidOptionError, NotFilledWarning, ODTError
from odt_plugins.hints import meant
from odt_plugins.options import DENSITIES, OF_MESHES, OPTIONS
from odt_plugins.processes import handling

DONE, COULD_NOT, WRONG_USE, BEYOND = 0, 1, 2, 3

LATER = {"cache": "odt_plugins.cli.cache", "compare": "odt_plugins.cli.compare",
         "mesh": "odt_plugins.cli.generate", "paraview": "odt_plugins.cli.paraview",
         "remesh": "odt_plugins.cli.remesh"}
"""Modules of the commands that are loaded when they are asked for."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code: 0 done, 1 could not, 2 wrong use.

    Parameters
    ----------
    argv : sequence of str    the words after the program's name; those of the process if None
    """
    with handling(signal.SIGTERM, signal.default_int_handler):
        try:
            code = cli.main(args=None if argv is None else list(argv), prog_name="odt-plugins",
                            standalone_mode=False)
        except click.exceptions.NoArgsIsHelpError as exc:
            click.echo(exc.format_message(), err=True)
            return WRONG_USE
        except click.UsageError as exc:
            where = exc.ctx.command_path if exc.ctx else "odt-plugins"
            unknown = isinstance(exc, click.NoSuchOption)
            said = (exc.message if unknown else exc.format_message()).rstrip(".") + instead_of(exc)
            return _fail(f"{said} (see {where} --help)", WRONG_USE)
        except InvalidOptionError as exc:
            return _fail(exc, WRONG_USE)
        except ODTError as exc:
            return _fail(exc, COULD_NOT)
        except (click.Abort, KeyboardInterrupt):
            return _fail("stopped before the end, no half-written file is left", COULD_NOT)
        except BrokenPipeError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return COULD_NOT
        except OSError as exc:
            nowhere = "usable temporary directory" in str(exc.strerror)
            if exc.errno not in (errno.ENOSPC, errno.EDQUOT) and not nowhere:
                raise
            return _fail(f"cannot write: {exc.strerror}; try more room in "
                         f"{tempfile.tempdir or 'one of them'}, or in another folder that TMPDIR "
                         "names", COULD_NOT)
        except MemoryError:
            return _fail("not enough memory for a mesh of this size", COULD_NOT)
    return code if isinstance(code, int) else DONE


class _Commands(click.Group):
    """The subcommands, of which some are loaded when they are asked for."""

    command_class = Command

    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted([*super().list_commands(ctx), *LATER])

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in LATER:
            return super().get_command(ctx, cmd_name)
        command: click.Command = getattr(import_module(LATER[cmd_name]), cmd_name)
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        known = self.list_commands(ctx)
        if args[0] not in known and (name := meant(args[0], known)):
            ctx.fail(f"No such command {args[0]!r}. Did you mean {name!r}?")
        return super().resolve_command(ctx, args)


@click.group(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="odt-plugins")
def cli() -> None:
    """Improve the tet and triangle meshes you already have by Optimal Delaunay Triangulation.

    The boundary stays, cells stay valid, and no quality figure that you name gets worse.

    Start with: odt-plugins optimize in.vtu out.vtu
    """


@cli.command(short_help="Improve a mesh file and write it with all its data.")
@click.argument("source", metavar="INPUT", type=click.Path(path_type=Path))
@click.argument("target", metavar="OUTPUT", type=click.Path(path_type=Path))
@option_flags
@REPORT_FLAG
@click.option("--plot", "plot_file", type=click.Path(path_type=Path), metavar="FILE.png",
              help="Draw histograms before and after there (.png, .pdf, .svg).")
@click.option("--worth", is_flag=True,
              help="Print what a solver gains: condition number, steps of conjugate gradients, "
                   "stable time step. It needs scikit-fem.")
@click.option("--blocks", type=click.IntRange(min=1), default=None,
              help="Optimise the mesh in so many blocks, one after the other unless there are "
                   "workers.")
@click.option("--block-rounds", type=click.IntRange(min=1), default=3, show_default=True,
              help="Most rounds of --blocks, cut elsewhere in each.")
@click.option("--file-format", type=click.Choice(["gmsh22", "gmsh41"]),
              help="Version of a .msh file; that of INPUT unless given.")
@click.option("--ascii/--binary", "text", default=None,
              help="Write OUTPUT as text or binary, where its format has both; unless given a "
                   ".msh file is as INPUT was, others are binary.")
@cluster_flags
@QUIET_FLAG
def optimize(
    source: Path,
    target: Path,
    report_file: Path | None,
    plot_file: Path | None,
    worth: bool,
    blocks: int | None,
    block_rounds: int,
    file_format: str | None,
    text: bool | None,
    scheduler: str | None,
    workers: int,
    quiet: bool,
    **options: Any,
) -> int:
    """Improve the mesh INPUT and write it to OUTPUT with all its data.

    Files are of any format that meshio knows, by their suffix. The boundary stays as it is and
    no figure named in --keep gets worse. With an OUTPUT ending in .pvtu, INPUT is another such file
    or a directory of .vtu files, and only one of the pieces is in memory at a time.
    """
    check_paths(source, target, report_file, plot_file)
    pieces = target.suffix == ".pvtu"
    if given("block_rounds") and blocks is None and not pieces:
        refuse("block_rounds", "for a mesh that is one block", "--blocks beside it")
    if pieces and blocks is not None:
        refuse("blocks", "for a mesh in pieces", "it for whole meshes")
    if pieces and options["density"] not in DENSITIES:
        refuse("density", "with the name of an array for a mesh in pieces", "keep or uniform")
    if pieces and (file_format or text is not None):
        msg = "--file-format, --ascii and --binary are for meshes of one file, OUTPUT names pieces"
        raise click.UsageError(msg)
    if blocks is None and (scheduler or workers) and not pieces:
        msg = "--scheduler and --workers need --blocks, the number of blocks to cut the mesh into"
        raise click.UsageError(msg)
    if source.suffix.lower() in (".glb", ".gltf") and (plot_file or worth):
        msg = "--plot and --worth are for one mesh, INPUT is a scene"
        raise click.UsageError(msg)
    if pieces and (report_file or plot_file or worth):
        msg = "--report, --plot and --worth are for one file each, OUTPUT names pieces"
        raise click.UsageError(msg)
    from odt_plugins.api import optimize_file

    how: Any = {"block_rounds": block_rounds, "workers": workers}
    if not pieces:
        how |= {"blocks": blocks, "file_format": file_format,
                "binary": None if text is None else not text}
    with warnings_told(quiet):
        if not pieces:
            options = resolve_arrays(source, options)
            refuse_for_kind(source, options["boundary"])
        with _cluster(scheduler, quiet) as client, progress_bar(quiet) as progress:
            options["progress"] = progress
            report = optimize_file(source, target, client=client, **how, **options)
    if not quiet:
        click.echo(in_flags(str(report)))
    if worth:
        click.echo(f"\n{report.worth()}")
    if report_file:
        write_beside(report_file, lambda path: path.write_text(report.to_json() + "\n"))
    if plot_file:
        write_beside(plot_file, report.plot)
    return DONE


@cli.command(short_help="Fill a surface with good tetrahedra.")
@click.argument("source", metavar="SURFACE", type=click.Path(path_type=Path))
@click.argument("target", metavar="OUTPUT", type=click.Path(path_type=Path))
@EDGE_LENGTH
@LEVELS
@size_flags("After TetWild, see remesh: ", "vertices", "most_cells", "adapt")
@some_option_flags(*(name for name in OPTIONS if name not in OF_MESHES))
@click.option("--bodies", is_flag=True,
              help="Number the closed components of SURFACE in a cell array \"body\", from 1, 0 "
                   "for none.")
@REPORT_FLAG
@click.option("--file-format", type=click.Choice(["gmsh22", "gmsh41"]),
              help="Version of a .msh file.")
@click.option("--ascii/--binary", "text", default=None,
              help="Write OUTPUT as text or binary, where its format has both.")
@QUIET_FLAG
def tetrahedralize(
    source: Path, target: Path, edge_length: float, levels: int, bodies: bool,
    report_file: Path | None, file_format: str | None, text: bool | None, quiet: bool,
    **options: Any,
) -> int:
    """Fill the surface of triangles SURFACE with tetrahedra and write them to OUTPUT.

    TetWild fills it, Optimal Delaunay Triangulation improves the tetrahedra. Labels and other
    arrays of the faces come to the triangles of the boundary, which stand beside the tetrahedra
    then. --envelope is how far the boundary may be from SURFACE. With --repair orient faces are
    turned first: neighbours agree, closed components face outward, hollows stay hollow. The exit
    code is 1 where more than a hundredth of SURFACE has no boundary beside it, or of the boundary
    no SURFACE; OUTPUT is written all the same.
    """
    from odt_plugins.generate.fill import tetrahedralize_with_report

    sizes = take_sizes(options)
    slides = options["boundary"] == "slide" or (sizes and not given("boundary"))
    if given("feature_angle") and not levels and not slides:
        refuse("feature_angle", "for a boundary that stays", "--boundary slide or --levels")
    check_paths(source, target, report_file)
    with warnings_told(quiet), progress_bar(quiet) as progress:
        warnings.simplefilter("ignore", NotFilledWarning)
        report: Any
        _, report = tetrahedralize_with_report(
            source, target=target, levels=levels, edge_length=edge_length, bodies=bodies,
            file_format=file_format, binary=None if text is None else not text,
            progress=progress, **sizes, **chosen(options))
    tell_report(report, report_file, quiet)
    if not report.filled.filled:
        return _fail(f"{target} is written, but {report.filled.complaint()}", COULD_NOT)
    return DONE


@cli.command(short_help="Make the inverted cells of a mesh file valid, and no more.")
@click.argument("source", metavar="INPUT", type=click.Path(path_type=Path))
@click.argument("target", metavar="OUTPUT", type=click.Path(path_type=Path))
@click.option("--rest", type=click.Path(path_type=Path), metavar="FILE",
              help="A valid mesh of the same cells: cells are brought near to the shapes they have "
                   "there.")
@click.option("--partial", is_flag=True,
              help="Write the mesh with the fewest inverted cells where no valid one is found.")
@click.option("--insert/--no-insert", cls=ShareOption, default=False,
              help="Whether vertices may be inserted where neither other places nor flips make all "
                   "tetrahedra valid: at most half as many as there are, or a number for at most "
                   "that part of them.")
@some_option_flags("fixed", "selection", "regions", "threads")
@REPORT_FLAG
@QUIET_FLAG
def untangle(source: Path, target: Path, rest: Path | None, partial: bool,
             report_file: Path | None, quiet: bool, **options: Any) -> int:
    """Make every cell of the mesh INPUT valid, write it to OUTPUT with all its data, and no more.

    The boundary, interfaces and fixed vertices stay where they are; the others move.
    """
    check_paths(source, target, report_file)
    from odt_plugins.adapters.files import check_output, expect_same_kind, read_file, write_file
    from odt_plugins.api import untangle_with_report

    check_output(target)
    with warnings_told(quiet), progress_bar(quiet) as progress:
        options = resolve_arrays(source, options)
        mesh = read_file(source)
        expect_same_kind(mesh, target)
        found, report = untangle_with_report(
            mesh, rest=None if rest is None else read_file(rest), partial=partial,
            progress=progress, **options)
        write_file(target, found)
    tell_report(report, report_file, quiet)
    return DONE


@cli.command(short_help="Improve many mesh files.")
@click.argument("sources", metavar="INPUT...", nargs=-1, required=True)
@click.option("--out", type=click.Path(path_type=Path), required=True,
              help="Folder for the results and the summary.")
@click.option("--tetrahedralize", is_flag=True, help="Let TetWild fill the surfaces first.")
@EDGE_LENGTH
@LEVELS
@click.option("--suffix", default=None, metavar=".vtu", help="Format of the results.  [default: "
              "that of the input, .vtu with --tetrahedralize]")
@click.option("--timeout", type=click.FloatRange(min=0.0, min_open=True), default=None,
              metavar="S", callback=some_number, help="Seconds after which an input is given up.")
@click.option("--memory-limit", type=click.FloatRange(min=0.0, max=1e9, min_open=True),
              default=None, metavar="GB", callback=some_number,
              help="Memory that the process of an input may take.")
@click.option("--resume", is_flag=True,
              help="Leave results that are there, of the same input, options and versions, and "
                   "failures that had the same limits as well.")
@click.option("--retry", is_flag=True, help="With --resume: try again what failed.")
@limit_flags
@cluster_flags
@size_flags("Remesh: ")
@option_flags
@QUIET_FLAG
def batch(
    sources: tuple[str, ...], out: Path, suffix: str | None, memory_limit: float | None,
    scheduler: str | None, workers: int, quiet: bool, tetrahedralize: bool, edge_length: float,
    levels: int, timeout: float | None, resume: bool, retry: bool, min_quality: float | None,
    min_angle: float | None, max_angle: float | None, **options: Any,
) -> int:
    """Improve many mesh files, in processes of their own that small ones share.

    With --size, --scale, --cells or --vertices each is remeshed, see the command remesh.
    INPUT are files or quoted patterns such as 'models/**/*.stl'. An input that crashes, takes too
    long or is no mesh is a row in the summary that --out gets beside the results; each result has
    its report beside it as JSON. With limits the exit code is 3 where a result is beyond one of
    them.
    """
    from odt_plugins.distributed import batch as batches
    from odt_plugins.distributed import summary
    from odt_plugins.distributed.job import WRITTEN

    if retry and not resume:
        msg = "--retry goes with --resume; without it all inputs are worked on"
        raise click.UsageError(msg)
    if given("edge_length") and not tetrahedralize:
        refuse("edge_length", "for meshes that are there", "--tetrahedralize beside it")
    summary.check_summary()
    sizes = take_sizes(options)
    wanted = chosen(options) if levels or sizes else options
    jobs = batches.make_jobs(
        batches.find_inputs(sources, out), out, wanted, suffix=suffix, retry=retry, resume=resume,
        tetrahedralize=tetrahedralize, edge_length=edge_length, levels=levels, timeout=timeout,
        memory_limit=None if memory_limit is None else round(memory_limit * 1e9), sizes=sizes,
    )
    with _cluster(scheduler, quiet) as client, progress_bar(quiet) as progress:
        clock = time.perf_counter()
        stopped = None
        try:
            told = progress if callable(progress) else None
            rows = batches.run_batch(jobs, client=client, workers=workers, progress=told)
        except batches.Stopped as exc:
            rows, stopped = exc.rows, exc
        seconds = time.perf_counter() - clock
        rows = [row | {"message": in_flags(row["message"])} for row in rows]
        words = command_line(click.get_current_context())
        summary.write_summary(out, rows, words, options["threads"], seconds)
    if not quiet:
        click.echo(summary.counts(rows))
        if any(row["resumed"] and row["status"] not in WRITTEN for row in rows):
            click.echo("what failed before was left as it is; --resume --retry tries it again")
        for name, value in summary.totals(rows, seconds):
            click.echo(f"  {name:<26}{value}")
        click.echo("written: " + ", ".join(str(out / name) for name in summary.FILES))
    if stopped:
        raise stopped
    code = DONE if all(row["status"] == "ok" for row in rows) else COULD_NOT
    limits = {"min_quality": min_quality, "min_angle": min_angle, "max_angle": max_angle}
    for row in rows:
        if row["status"] in WRITTEN and (beyond := beyond_limits(
                {figure: row[f"after_{figure}"] for figure in limits}, limits)):
            code = _fail(f"{row['result']} has {', '.join(beyond)}", BEYOND)
    return code


@cli.command()
@click.argument("sources", metavar="INPUT...", nargs=-1, required=True,
                type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print the figures as JSON.")
@limit_flags
def quality(sources: tuple[Path, ...], as_json: bool, **limits: float | None) -> int:
    """Print the quality figures of mesh files.

    With limits the exit code is 3 where a mesh is beyond one of them.
    """
    from odt_plugins.api import quality as measured
    from odt_plugins.table import table_lines

    code = DONE
    found = {}
    for source in sources:
        try:
            with warnings_told(quiet=False):
                found[str(source)] = measured(source)
        except ODTError as exc:
            code = _fail(exc if str(source) in str(exc) else f"{source}: {exc}", COULD_NOT)
    if as_json:
        rows = [{"file": name, **summary.to_dict()} for name, summary in found.items()]
        click.echo(json.dumps(rows, indent=2, allow_nan=False))
    elif found:
        click.echo("\n".join(table_lines(found)))
    for name, summary in found.items():
        beyond = beyond_limits(summary.to_dict(), limits)
        if beyond:
            code = max(code, _fail(f"{name} has {', '.join(beyond)}", BEYOND))
    return code


@cli.command(short_help="Apply a MeshLab script that may hold our filters.")
@click.argument("file", metavar="FILE.mlx", type=click.Path(path_type=Path))
@click.argument("source", metavar="INPUT", type=click.Path(path_type=Path))
@click.argument("target", metavar="OUTPUT", type=click.Path(path_type=Path))
@QUIET_FLAG
def script(file: Path, source: Path, target: Path, quiet: bool) -> int:
    """Apply a MeshLab filter script that may hold filters of odt-plugins.

    INPUT is read and OUTPUT written by MeshLab. When OUTPUT is a file of tetrahedra, such as
    .vtu or .msh, it gets those of the script's last "ODT Tetrahedralization".
    """
    from odt_plugins.hosts.script import run_script_on_files

    with warnings_told(quiet):
        run_script_on_files(file, source, target, progress=None if quiet else click.echo)
    return DONE


@cli.command(short_help="Improve and draw a TetWild mesh of the bunny.")
@click.option("--out", type=click.Path(path_type=Path), default=Path("demo-output"),
              show_default=True, help="Directory for the demo's files.")
@click.option("--edge-length", type=click.FloatRange(min=0.0, max=1.0, min_open=True),
              default=None, help="For TetWild, relative to the diagonal of the bunny.")
@click.option("--threads", type=click.IntRange(min=1), default=os.cpu_count() or 1,
              show_default="all processors", help=OPTIONS["threads"].metadata["help"])
def demo(out: Path, edge_length: float | None, threads: int) -> int:
    """Improve a TetWild mesh of the Stanford bunny and draw it before and after."""
    from odt_plugins.cli.demo import EDGE_LENGTH, FILES, run_demo

    with warnings_told(quiet=False), progress_bar(quiet=False) as progress:
        report = run_demo(out, edge_length=edge_length or EDGE_LENGTH, say=click.echo,
                          threads=threads, progress=progress)
    click.echo(f"\n{report}\n")
    click.echo("written: " + ", ".join(str(out / name) for name in FILES))
    return DONE


@contextmanager
def _cluster(scheduler: str | None, quiet: bool) -> Iterator[Any]:
    """Connect to Dask when asked to, and tell where its dashboard is; None otherwise."""
    if scheduler is None:
        yield None
        return
    from odt_plugins.distributed.cluster import connected

    with connected(scheduler) as client:
        if not quiet:
            click.echo(f"Dask dashboard: {client.dashboard_link}", err=True)
        yield client


def _fail(message: object, code: int) -> int:
    click.echo(f"odt-plugins: {one_line(in_flags(str(message)))}", err=True)
    return code
