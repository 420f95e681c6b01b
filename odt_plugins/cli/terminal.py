"""What the commands share in the terminal: bar, signals, warnings in one line, whole files."""

from __future__ import annotations

import math
import os
import re
import shlex
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from odt_plugins.errors import MeshFileError, ODTWarning, require
from odt_plugins.options import OPTIONS, Progress
from odt_plugins.progress import shown

PLOT_SUFFIXES = (".png", ".pdf", ".svg")

PARTLY = "the command untangle with --partial"
"""What there is to try on the command line where Python has an argument of a function."""

JOINED = "an INPUT whose geometries are joined to one"
"""What there is to try on the command line where Python has a method of scenes."""

OF_DOMAINS = {"h0": "size", "level": "levels", "most_points": "most_points"}
"""Flags of the command mesh, by arguments of the functions that it calls."""

OF_FILES = ("blocks", "bodies", "file_format", "levels", "suffix", "tetrahedralize")
"""Arguments of functions for files that are flags of the same names."""


class ShareOption(click.Option):
    """A switch, or a number that follows it, of a :class:`Command`."""

    def number_taken(self, ctx: click.Context, words: list[str]) -> list[str]:
        """Take the numbers that follow the switch, of which the last holds, out of the words."""
        left: list[str] = []
        waits = False
        for place, word in enumerate(words):
            if word == "--":
                return left + words[place:]
            flag, follows, told = word.partition("=")
            number: float | bool = True
            if flag in self.opts:
                left.append(flag)
                number = click.FLOAT(told, self, ctx) if follows else True
            elif waits and _is_number(word):
                number = float(word)
            else:
                left.append(word)
                waits = False
                continue
            waits = number is True
            ctx.meta[f"{__name__}.{self.name}"] = number
        return left

    def type_cast_value(self, ctx: click.Context, value: Any) -> Any:
        """Give a number, or what a switch gives."""
        given = super().type_cast_value(ctx, value)
        return ctx.meta.get(f"{__name__}.{self.name}", True) if given is True else given


class Command(click.Command):
    """A command whose switches may have numbers."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Read the words of a call."""
        for option in self.get_params(ctx):
            if isinstance(option, ShareOption):
                args = option.number_taken(ctx, args)
        return super().parse_args(ctx, args)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def command_line(context: click.Context, **settled: Any) -> str:
    """Give the command of a context again, with the flags that were given.

    Parameters
    ----------
    context : click.Context
    **settled                  flags that are written in any case, by parameter, and their values
    """
    words = context.command_path.split()
    for parameter in context.command.params:
        name = str(parameter.name)
        value, source = context.params[name], context.get_parameter_source(name)
        if isinstance(parameter, click.Argument):
            words += map(str, value)
        elif name in settled or source is ParameterSource.COMMANDLINE:
            value = settled.get(name, value)
            on, off = parameter.opts, parameter.secondary_opts
            flag = (off or on)[0] if value is False else on[0]
            if parameter.multiple:
                words += [word for one in value for word in (flag, str(one))]
            elif isinstance(value, bool):
                words.append(flag)
            else:
                words += [flag, ",".join(value) if isinstance(value, tuple) else str(value)]
    return shlex.join(words)


def check_paths(
    source: Path, target: Path, report_file: Path | None, plot_file: Path | None = None
) -> None:
    """Refuse a report or a figure that cannot be written, before any work is done.

    They take the place of no other file of the command, while `target` may be `source`.
    """
    beside = {flag: os.path.realpath(path) for flag, path in (
        ("--report", report_file), ("--plot", plot_file)) if path is not None}
    for word, other in (("OUTPUT", target), ("INPUT", source)):
        names = {word: os.path.realpath(other), **beside}
        same = [name for name, path in names.items() if [*names.values()].count(path) > 1]
        if same:
            msg = f"{', '.join(same[:-1])} and {same[-1]} name the same file; expected others"
            raise click.UsageError(msg)
    if plot_file is not None:
        if plot_file.suffix.lower() not in PLOT_SUFFIXES:
            msg = f"got {plot_file.name!r}; expected a file ending in {', '.join(PLOT_SUFFIXES)}"
            raise click.BadParameter(msg, param_hint="--plot")
        require("--plot", "plot", "matplotlib")
    for path in (report_file, plot_file):
        if path is None:
            continue
        folder = Path(os.path.realpath(path)).parent
        if path.is_dir() or not folder.is_dir() or not os.access(folder, os.W_OK | os.X_OK):
            what = "it is a directory" if path.is_dir() else f"{folder} is no writable directory"
            msg = f"cannot write {path}: {what}; try another path"
            raise MeshFileError(msg)


def check_folder(folder: Path, flag: str) -> None:
    """Refuse a folder that cannot be made or written into, before any work is done."""
    whole = folder.absolute()
    there = next(path for path in (whole, *whole.parents) if os.path.lexists(path))
    if not there.is_dir() or not os.access(there, os.W_OK | os.X_OK):
        msg = f"cannot write into {folder}: {there} is no writable directory; try another {flag}"
        raise MeshFileError(msg)


def write_beside(path: Path, write: Callable[[Path], Any]) -> None:
    """Write a file, behind a link too, in a directory beside its place and rename it then."""
    try:
        real = Path(os.path.realpath(path))
        with tempfile.TemporaryDirectory(prefix=f".{path.stem}-", dir=real.parent) as folder:
            write(Path(folder) / path.name)
            os.replace(Path(folder) / path.name, real)
    except OSError as exc:
        # An error of our own names the file in that directory, its cause says the reason alone.
        cause = exc.__cause__ if isinstance(exc, MeshFileError) and exc.__cause__ else exc
        msg = f"cannot write {path}: {getattr(cause, 'strerror', None) or cause}; try another path"
        raise MeshFileError(msg) from exc


def tell_report(report: Any, report_file: Path | None, quiet: bool) -> None:
    """Print a report unless the command is quiet, and write it where --report says."""
    if not quiet:
        click.echo(in_flags(str(report)))
    if report_file:
        write_beside(report_file, lambda path: path.write_text(report.to_json() + "\n"))


@contextmanager
def warnings_told(quiet: bool) -> Iterator[None]:
    """Show the package's own warnings as one line each on stderr, once each, or nowhere."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", ODTWarning)
        try:
            yield
        finally:
            ours = [w.message for w in caught if issubclass(w.category, ODTWarning) and not quiet]
            for words in dict.fromkeys(one_line(in_flags(str(message))) for message in ours):
                click.echo(f"odt-plugins: warning: {words}", err=True)


@contextmanager
def progress_bar(quiet: bool) -> Iterator[Progress | bool]:
    """Show a bar on stderr when that is a terminal; nothing in a pipe, where it yields False."""
    if quiet or not sys.stderr.isatty():
        yield False
        return
    with shown() as progress:
        yield progress


def in_flags(text: str) -> str:
    """Name options by their flags: "try --insert" for "try insert=True", "--keep" for "keep=".

    A method of scenes becomes what is to be done with the file.
    """
    from odt_plugins.adapters.trimesh_scene import LOADED, TOGETHER
    from odt_plugins.remeshing import WISHES

    def called(found: re.Match[str]) -> str:
        return OF_DOMAINS.get(found[1], found[1]).replace("_", "-")

    def flag(found: re.Match[str]) -> str:
        name = called(found)
        parts = re.findall(r"""'([^']*)'|"([^"]*)"|([-+.\w]+)""", found[2])
        value = ",".join("".join(part) for part in parts)
        plain = {"True": f"--{name}", "False": f"--no-{name}", "None": f"--{name} none"}
        return plain.get(value, f"--{name} {shlex.quote(value) if parts else 'none'}")

    own = (name for name, about in OPTIONS.items() if about.metadata["flag"] is not None)
    names = "|".join(("size", *OF_FILES, *OF_DOMAINS, *WISHES, *own))
    value = r"""'[^']*'|"[^"]*"|\([^()]*\)|[-+.\w]*\w"""
    text = text.replace(TOGETHER, JOINED).replace(LOADED, JOINED)
    text = text.replace("untangle(mesh, partial=True)", PARTLY)
    text = re.sub(r"smoothing=\{'(\w+)': '?([^{}']*)'?\}", r"--smoothing \1=\2", text)
    text = re.sub(rf"(?<![\w.-])({names})=({value})", flag, text)
    return re.sub(rf"(?<![\w.-])({names})=(?=[\s,.;)]|$)",
                  lambda found: "--" + called(found), text)


def one_line(message: object) -> str:
    """Put a message on one line."""
    return " ".join(str(message).split())


def beyond_limits(
    figures: Mapping[str, float | None], limits: Mapping[str, float | None]
) -> list[str]:
    """Figures of a mesh that are beyond a limit, those that are not finite too, with the limit."""
    out = []
    for figure, limit in limits.items():
        known = figures[figure]
        value = math.nan if known is None else known
        least = figure.startswith("min")
        if limit is not None and not (value >= limit if least else value <= limit):
            word = "least" if least else "most"
            out.append(f"{figure} {value:.4g}, expected at {word} {limit:g}")
    return out
