"""Flags of the commands: one for every option, and those that several commands share."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, get_args, get_type_hints

import click
from click.core import ParameterSource

from odt_plugins.cli.terminal import ShareOption
from odt_plugins.options import EDGE_LENGTH as DEFAULT_EDGE_LENGTH
from odt_plugins.options import FIGURES, OPTIONS, STAYS, STAYS_SIZED, Options, hint_for
from odt_plugins.words import smoothing_of

REPORT_FLAG = click.option(
    "--report", "report_file", type=click.Path(path_type=Path), metavar="FILE.json",
    help="Write the report there as JSON.")

QUIET_FLAG = click.option("--quiet", is_flag=True, help="Print nothing but errors.")

EDGE_LENGTH = click.option(
    "--edge-length", type=click.FloatRange(min=0.0, max=1.0, min_open=True, max_open=True),
    default=DEFAULT_EDGE_LENGTH, show_default=True, help="For TetWild, relative to the diagonal.")

OF_ARRAYS = ", the name of a point or cell array of lengths of INPUT"
"""What is told of a size for meshes whose vertices and cells stand for those of the result."""

SIZES: dict[str, dict[str, Any]] = {
    "size": {"metavar": "LENGTH", "callback": lambda _c, _p, text: length_or_name(text),
             "help": f"Length that edges should have{OF_ARRAYS}, or curvature: as coarse as the "
                     "envelope allows."},
    "scale": {"type": float, "help": "Instead: multiple of the local size that INPUT has; 2 is "
                                     "twice as coarse."},
    "cells": {"type": int, "help": "Instead: how many cells, about."},
    "vertices": {"type": int, "help": "Instead: how many vertices, about."},
    "growth": {"type": float,
               "help": "Largest ratio of the sizes at the ends of an edge as long as the smaller "
                       "one; 1.3 unless given, 3 of lengths in a metric."},
    "most_cells": {"type": int, "default": 20_000_000, "show_default": True,
                   "help": "Refuse to make more cells."},
    "adapt": {"multiple": True, "metavar": "NAME",
              "help": "Point array to whose second derivatives sizes and shapes of cells are "
                      "adapted, so that --cells or --vertices interpolate it best. May be given "
                      "several times."},
}
"""Flags that say how fine a mesh is to be."""

LEVELS = click.option(
    "--levels", type=click.IntRange(min=0), default=0, show_default=True,
    help="How often the mesh of TetWild is refined, moved to the surface and optimised; each "
         "level has eight times as many tetrahedra.")


def size_flags(
    start: str = "", *without: str
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Decorator that gives a command the flags in SIZES, `start` before what is told of them."""

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        for name, settings in reversed(SIZES.items()):
            if name not in without:
                of = OF_ARRAYS if "adapt" in without else ""
                told = settings | {"help": start + settings["help"].replace(of, "")}
                command = click.option("--" + name.replace("_", "-"), name, **told)(command)
        return command

    return decorate


def take_sizes(options: dict[str, Any]) -> dict[str, Any]:
    """Take the sizes that were given on the command line out of the values of a command."""
    return chosen({name: options.pop(name) for name in SIZES if name in options})


def length_or_name(text: str | None) -> float | str | None:
    """A length, or a name."""
    try:
        return text and float(text)
    except ValueError:
        return text


def some_option_flags(*names: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Decorator that gives a command the flags of some options."""
    return lambda command: option_flags(command, names)


def option_flags(
    command: Callable[..., Any], names: Sequence[str] = tuple(OPTIONS)
) -> Callable[..., Any]:
    """Give a command the flags of options, with the defaults and help texts of the options."""
    hints = get_type_hints(Options)
    for name, about in reversed(OPTIONS.items()):
        told: Any = about.metadata
        default: Any = about.default
        if told["flag"] is None or name not in names:
            continue
        flag = "--" + name.replace("_", "-")
        settings: dict[str, Any] = {"default": default, "show_default": default is not None,
                                    "help": f"{told['help']} {told['flag']}".strip()}
        if told["choices"]:
            settings["type"] = click.Choice(told["choices"])
        elif isinstance(default, bool):
            settings["cls"] = ShareOption if told["share"] else click.Option
            flag = f"{flag}/--no-{name.replace('_', '-')}"
        elif isinstance(default, int):
            settings["type"] = click.IntRange(min=told["least"])
        elif float in (hints[name], *get_args(hints[name])):
            settings["type"] = float
        elif name == "smoothing":
            settings |= {"default": (), "show_default": False, "multiple": True,
                         "metavar": "NAME=VALUE", "callback": lambda _c, _p, w: smoothing_of(w)}
        elif name == "regions":
            settings["callback"] = _region_names
        elif name in ("keep", "free"):
            settings |= {"default": ",".join(default), "callback": _names}
        else:
            settings["type"] = str
        command = click.option(flag, name, **settings)(command)
    return command


def chosen(options: dict[str, Any]) -> dict[str, Any]:
    """Options that were given on the command line; the others have other defaults with levels."""
    source = click.get_current_context().get_parameter_source
    return {name: value for name, value in options.items()
            if source(name) is ParameterSource.COMMANDLINE}


def given(*names: str) -> list[str]:
    """Those of some parameters whose flags stand on the command line."""
    source = click.get_current_context().get_parameter_source
    return [name for name in names if source(name) is ParameterSource.COMMANDLINE]


def instead_of(error: click.UsageError) -> str:
    """What to try where a flag is none, as the end of a sentence."""
    if not isinstance(error, click.NoSuchOption) or error.ctx is None:
        return ""
    flags = {flag.lstrip("-").replace("-", "_"): flag
             for param in error.ctx.command.get_params(error.ctx)
             for flag in (*param.opts, *param.secondary_opts) if flag.startswith("-")}
    stays = STAYS_SIZED if "size" in flags else STAYS
    hint = hint_for(error.option_name.lstrip("-").replace("-", "_"), flags, stays)
    return re.sub(r"mean '(\w+)'", lambda found: f"mean {flags[found[1]]}", hint)


def refuse(name: str, what: str, instead: str) -> None:
    """Refuse a flag that has no effect.

    Raises
    ------
    click.UsageError
    """
    msg = f"got --{name.replace('_', '-')} {what}, where it has no effect; expected {instead}"
    raise click.UsageError(msg)


def refuse_for_kind(source: Path, boundary: str) -> None:
    """Refuse flags that have no effect on the kind of mesh that a file holds.

    Raises
    ------
    click.UsageError
    ODTError            the file cannot be read
    """
    names = given("envelope", "feature_angle", "reference")
    if not names:
        return
    from odt_plugins.adapters import files
    from odt_plugins.mesh.plane import plane_frame
    from odt_plugins.mesh.simplex import mesh_arrays

    host = files.read(source)
    points, cells = mesh_arrays(host.points, host.cells)
    solid = cells.shape[1] == 4
    if not solid and points.shape[1] == 3 and plane_frame(points, cells) is None:
        return
    kind = "tetrahedra" if solid else "triangles in the plane"
    for name in names:
        if boundary != "slide":
            refuse(name, f"for {kind} whose boundary stays", "--boundary slide beside it")


def _region_names(_ctx: click.Context, _param: click.Parameter, text: str) -> str | None:
    return None if text == "none" else text


def _names(_ctx: click.Context, param: click.Parameter, text: str) -> tuple[str, ...]:
    known = FIGURES if param.name == "keep" else STAYS
    names = tuple(name.strip() for name in text.split(",") if name.strip())
    if names == ("none",) or (not text and param.name == "free"):
        return ()
    if not names:
        msg = f"got no name; expected some of {', '.join(known)}, separated by commas, or none"
        raise click.BadParameter(msg)
    for name in names:
        if name not in known:
            msg = f"got {name!r}; expected some of {', '.join(known)}, separated by commas"
            raise click.BadParameter(msg)
    return names


def cluster_flags(command: Callable[..., Any]) -> Callable[..., Any]:
    """Give a command the flags that say where the work is done."""
    command = click.option(
        "--workers", type=click.IntRange(min=0), default=0, show_default=True,
        help="Work in so many processes of this machine; 0 works in this one.",
    )(command)
    return click.option("--scheduler", default=None, metavar="ADDRESS",
                        help="Work on the Dask cluster of the scheduler at this address, such as "
                             "tcp://host:8786, in the place of processes; needs "
                             "odt-plugins[dask].")(command)


def some_number(_: click.Context, flag: click.Parameter, value: float | None) -> float | None:
    """Give a limit, which nan is not."""
    if value is not None and math.isnan(value):
        msg = "got nan; expected a number"
        raise click.BadParameter(msg, param=flag)
    return value


def limit_flags(command: Callable[..., Any]) -> Callable[..., Any]:
    """Give a command the flags of limits that figures of its meshes may not pass."""
    for flag, text in (("--max-angle", "Largest (dihedral) angle in degrees."),
                       ("--min-angle", "Least (dihedral) angle in degrees."),
                       ("--min-quality", "Least radius ratio that a mesh may have.")):
        command = click.option(
            flag, type=float, default=None, callback=some_number, help=text)(command)
    return command
