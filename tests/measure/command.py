"""Measure the package: ``python tests/measure threads cold --largest 100000``."""

from __future__ import annotations

from pathlib import Path

import click

from measure.ablation import ablation
from measure.against import against_table
from measure.aniso import aniso_tables
from measure.resizing import resizing_table
from measure.robustness import FILE, run_hard
from measure.rounds import rounds_table
from measure.scaling import FILES, PARTS, run_scaling, sizes_between
from odt_plugins.compare.start import read_start, suite
from odt_plugins.compare.table import as_text
from odt_plugins.options import Options

NAMES = (*PARTS, "hard", "ablation", "aniso", "against", "resize", "rounds")


def _known(_ctx: click.Context, _param: click.Parameter, words: tuple[str, ...]) -> tuple[str, ...]:
    for word in words:
        if word not in NAMES and not Path(word).suffix and "/" not in word and not Path(
                word).is_dir():
            msg = (f"got {word!r}; expected some of {', '.join(NAMES)}, or the path of a mesh or a "
                   "source tree")
            raise click.BadParameter(msg)
    if not set(words) & set(NAMES):
        raise click.BadParameter(f"expected some of {', '.join(NAMES)}")
    if "against" in words and set(words) <= set(NAMES):
        raise click.BadParameter("got against alone; expected the path of a source tree besides")
    return words


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("words", metavar="NAME... [MESH]...", nargs=-1, required=True, callback=_known)
@click.option("--out", type=click.Path(path_type=Path), default=Path("measured"),
              show_default=True, help="Directory for JSON and the page.")
@click.option("--smallest", type=click.IntRange(min=1000), default=10_000, show_default=True,
              help="Cells of the smallest mesh.")
@click.option("--largest", type=click.IntRange(min=1000), default=1_000_000, show_default=True,
              help="Cells of the largest mesh.")
@click.option("--threads", type=click.IntRange(min=1), default=1, show_default=True)
def main(words: tuple[str, ...], out: Path, smallest: int, largest: int, threads: int) -> None:
    """Measure what is named, print tables, and write JSON and one page.

    How time, memory and iterations grow: stages, surface, races, forty-sweeps, multigrid,
    bandwidth, threads, blocks, generation, ladder, small, cold. Default runs on hard meshes, and
    whether the promise holds on each: hard. What each phase of the schedule gains on each MESH, or
    on the standard suite: ablation. Errors of meshes that are adapted to functions, and how
    well others match metrics: aniso. How remeshing grows, beside other tools: resize; what each
    part of its rounds gains on each MESH of tetrahedra, or on those of the standard suite: rounds.
    Processor time beside the source tree in a folder, which is given as MESH: against.
    """
    def say(line: str) -> None:
        click.echo(line, err=True)

    parts = [name for name in words if name in PARTS]
    if parts:
        click.echo(run_scaling(out, largest, threads, say, smallest=smallest, parts=parts))
        click.echo("written: " + ", ".join(str(out / name) for name in FILES))
    if "hard" in words:
        click.echo(run_hard(out, threads, say))
        click.echo(f"written: {out / FILE}")
    if "ablation" in words:
        meshes = [read_start(Path(word)) for word in words if word not in NAMES]
        table = ablation(meshes or suite("standard"), Options(threads=threads), say)
        click.echo("\n".join(as_text(table)[1:]))
    if "aniso" in words:
        for table in aniso_tables(say):
            click.echo("\n".join(as_text(table)))
    if "resize" in words:
        table = resizing_table(sizes_between(smallest, largest), say)
        click.echo("\n".join(as_text(table)))
    if "rounds" in words:
        meshes = [read_start(Path(word)) for word in words if word not in NAMES]
        solid = [start for start in meshes or suite("standard") if start.kind == "tets"]
        click.echo("\n".join(as_text(rounds_table(solid, say))[1:]))
    if "against" in words:
        for tree in [Path(word) for word in words if word not in NAMES]:
            if not (tree / "odt_plugins").is_dir():
                msg = f"got {tree}; expected the path of a source tree, with odt_plugins in it"
                raise click.BadParameter(msg)
            click.echo("\n".join(as_text(against_table(tree, say))))
