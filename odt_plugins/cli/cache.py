"""The subcommand ``odt-plugins cache``: machine code that this user's runs have compiled."""

from __future__ import annotations

import shutil

import click

from odt_plugins.ahead import kept_kernels
from odt_plugins.errors import counted


@click.command(short_help="Show or remove machine code that runs have compiled.")
@click.option("--clear", is_flag=True, help="Remove it; later runs compile what they need again.")
def cache(clear: bool) -> None:
    """Show where machine code lies that runs have compiled, and how much of it.

    An installation has its own, which stays.
    """
    folder, found = kept_kernels()
    size = sum(path.stat().st_size for path in found)
    if clear and folder is not None:
        shutil.rmtree(folder, ignore_errors=True)
    where = folder or "no folder, since there is no home"
    click.echo(f"{counted(len(found), 'kernel')}, {size / 1e6:.1f} MB, "
               f"{'removed from' if clear else 'in'} {where}")
