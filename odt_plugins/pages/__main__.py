"""Build the site: ``python -m odt_plugins.pages FOLDER``."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from odt_plugins.errors import ODTError
from odt_plugins.pages.build import build


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
def main(folder: Path) -> None:
    """Make a static site of all pages in FOLDER, with an API reference, the gallery and a search.

    It needs a checkout of the repository and the extra `site`.
    """
    try:
        build(folder)
    except ODTError as exc:
        raise click.ClickException(str(exc)) from exc
    click.echo(f"written: {folder / 'index.html'}")


if __name__ == "__main__":
    sys.exit(main())
