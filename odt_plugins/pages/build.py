"""From the pages of the repository to a folder of HTML."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from odt_plugins.errors import MeshFileError, require, writing
from odt_plugins.pages.sources import write_sources


def build(folder: Path) -> None:
    """Make the site in a folder, which is replaced when all is done.

    Raises
    ------
    MissingDependencyError    the extra `site` is not installed
    MeshFileError             the folder cannot be written, holds something else, or a page has a
                              fault
    """
    require("the site", "site", "sphinx", "myst_parser", "furo")
    if folder.exists() and not (folder / "index.html").is_file() and any(folder.iterdir()):
        msg = f"got {folder}, which holds something else than a site; expected an empty folder"
        raise MeshFileError(msg)
    with tempfile.TemporaryDirectory(prefix="odt-pages-") as name:
        sources, made = Path(name) / "sources", Path(name) / "site"
        write_sources(sources)
        done = subprocess.run(
            [sys.executable, "-m", "sphinx", "-b", "html", "-W", "--keep-going", "-q",
             str(sources), str(made)], capture_output=True, text=True, check=False)
        if done.returncode:
            said = done.stderr.replace(str(sources), "").strip()
            msg = f"got faults in the pages; expected none:\n{said}"
            raise MeshFileError(msg)
        with writing(f"into {folder}", "another folder"):
            if folder.exists():
                shutil.rmtree(folder)
            shutil.copytree(made, folder, ignore=shutil.ignore_patterns(".doctrees", ".buildinfo"))
