"""What Sphinx reads: every page where it stands in the repository, and the pages of reference."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import odt_plugins
from odt_plugins.errors import MeshFileError
from odt_plugins.pages.reference import commands_page, python_page

TOP = Path(odt_plugins.__file__).parents[1]
"""The repository."""

GUIDES: dict[str, tuple[str, ...]] = {
    "Pages": ("examples/README.md", "odt_plugins/README.md", "odt_plugins/adapters/README.md",
              "odt_plugins/engine/README.md", "odt_plugins/generate/README.md",
              "odt_plugins/distributed/README.md", "odt_plugins/compare/README.md"),
    "Reference": ("reference/python.rst", "reference/commands.rst"),
    "The project": ("odt_plugins/CHANGELOG.md", "examples/paper/README.md", "tests/README.md",
                    "tests/measure/README.md"),
}
"""Pages behind the first one, as they are listed beside every page."""

FIRST = "index.md"
"""The first page, which is README.md in the repository."""

LINK = re.compile(r"(\]\()([^)#\s]+)(#[^)\s]*)?(\))")
"""Target of a link or picture in Markdown, and the place in it."""

SETTINGS = """project = "odt-plugins"
author = "The odt_plugins authors"
version = release = {version!r}
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon",
              "odt_plugins.pages.docstrings"]
root_doc = "index"
html_theme = "furo"
html_title = "odt-plugins {version}"
html_copy_source = False
html_show_sourcelink = False
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True
autodoc_typehints = "none"
autodoc_member_order = "bysource"
myst_heading_anchors = 3
myst_enable_extensions = ["fieldlist"]
suppress_warnings = ["myst.xref_missing", "misc.highlighting_failure"]
pygments_style = "friendly"
"""
"""The file conf.py."""


def write_sources(folder: Path) -> None:
    """Lay everything out that Sphinx reads.

    Parameters
    ----------
    folder : Path    is made; files of the repository stand in it as in the repository

    Raises
    ------
    MeshFileError    this is no checkout of the repository
    """
    if not (TOP / "README.md").is_file() or not (TOP / "examples").is_dir():
        msg = (f"got a package without its repository around it, in {TOP}; expected a checkout, "
               "which has the pages and pictures")
        raise MeshFileError(msg)
    folder.mkdir(parents=True)
    (folder / "conf.py").write_text(
        SETTINGS.format(version=odt_plugins.__version__), encoding="utf-8")
    pages = ["README.md", *(page for pages in GUIDES.values() for page in pages
                            if page.endswith(".md"))]
    for page in pages:
        text = _linked((TOP / page).read_text(encoding="utf-8"), Path(page), folder)
        target = folder / (FIRST if page == "README.md" else page)
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(text + (_contents() if page == "README.md" else ""), encoding="utf-8")
    from odt_plugins.cli.main import cli

    reference = folder / "reference"
    reference.mkdir()
    (reference / "python.rst").write_text(python_page(), encoding="utf-8")
    (reference / "commands.rst").write_text(commands_page(cli), encoding="utf-8")


def _linked(text: str, page: Path, folder: Path) -> str:
    """A page whose links hold on the site; the files that they lead to are copied."""

    def target(found: re.Match[str]) -> str:
        start, link, place, end = found.groups()
        if ":" in link:
            return found[0]
        file = (TOP / page.parent / link).resolve()
        if not file.is_file() or not file.is_relative_to(TOP):
            return found[0]
        name = file.relative_to(TOP)
        if name == Path("README.md"):
            up = "../" * len(page.parent.parts)
            return f"{start}{up}{FIRST}{place or ''}{end}"
        if name.suffix != ".md":
            copy = folder / name
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file, copy)
        return found[0]

    return LINK.sub(target, text)


def _contents() -> str:
    """Lists of all other pages, for the side of every page."""
    lines = [""]
    for caption, pages in GUIDES.items():
        lines += ["```{toctree}", ":hidden:", ":maxdepth: 1", f":caption: {caption}", "", *pages,
                  "```", ""]
    return "\n".join(lines)
