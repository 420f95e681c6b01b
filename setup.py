"""Compiles the kernels while the package is built, so that its first run begins at once.

The first page of the package is README.md with its picture in it, and tests and examples go into
the source archive. Everything else is said in pyproject.toml. A package without machine code works
as well: it compiles what a run needs when it needs it.
"""

import re
import subprocess
import sys
import tomllib
from base64 import b64encode
from pathlib import Path

from setuptools import Distribution, setup
from setuptools.command.build_py import build_py
from setuptools.command.sdist import sdist

TOP = Path(__file__).parent


def first_page() -> str:
    """README.md where nothing lies beside it: links lead to the address that is called Source in
    pyproject.toml; as long as there is none, they are plain words and pictures stand in the page.
    """
    project = tomllib.loads((TOP / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    address = project.get("urls", {}).get("Source")

    def link(found: re.Match[str]) -> str:
        mark, words, target = found.groups()
        if target.startswith("https:"):
            return found[0]
        if address:
            return f"{mark}[{words}]({address}/{'raw' if mark else 'blob'}/main/{target})"
        if not mark:
            return words
        picture = b64encode((TOP / target).read_bytes()).decode()
        return f"![{words}](data:image/png;base64,{picture})"

    text = (TOP / "README.md").read_text(encoding="utf-8")
    return re.sub(r"(!?)\[([^\]]*)\]\(([^)]+)\)", link, text)


class WithKernels(build_py):
    """Copies the package, and adds machine code."""

    def run(self) -> None:
        super().run()
        target = Path("." if self.editable_mode else self.build_lib)
        folder = target / "odt_plugins" / "engine" / "compiled" / "ahead"
        try:
            subprocess.run([sys.executable, "-m", "odt_plugins.ahead", str(folder)], check=True)
        except (OSError, subprocess.CalledProcessError) as error:
            self.warn(f"no kernels compiled ahead ({error}); the first run will compile them")


class WithTests(sdist):
    """Packs what is no part of a wheel as well: the site, tests, examples, what CI runs."""

    def make_distribution(self) -> None:
        for folder in ("odt_plugins/pages", "tests", "examples", ".ci"):
            self.filelist.extend(
                str(path) for path in sorted(Path(folder).rglob("*"))
                if path.is_file() and "__pycache__" not in path.parts)
        self.filelist.append(".gitignore")
        super().make_distribution()


class ForOneSystem(Distribution):
    """A package with machine code."""

    def has_ext_modules(self) -> bool:
        return True


setup(cmdclass={"build_py": WithKernels, "sdist": WithTests}, distclass=ForOneSystem,
      long_description=first_page(), long_description_content_type="text/markdown")
