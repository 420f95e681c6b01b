"""Builds the library of kernels with the package, so that its first run begins at once.

The first page of the package is README.md with its picture in it, and tests and examples go into
the source archive. Where there is no linker the package has no library and needs numba, which
compiles what a run needs when it needs it. Everything else is said in pyproject.toml.
"""

import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from base64 import b64encode
from pathlib import Path

from setuptools import Distribution, setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_py import build_py
from setuptools.command.sdist import sdist

TOP = Path(__file__).parent

LINKS = shutil.which(shlex.split(os.environ.get("CC", "cc"))[0]) is not None
"""Whether there is a linker."""

NEEDS = ["numpy>=1.26", "scipy>=1.11", "pyamg>=5.1", "meshio>=5.3.5", "click>=8.2", "rich>=13.7",
         "h5py>=3.10", "netCDF4>=1.6.5", "libigl>=2.6"]
"""What running needs beside a library of kernels."""

READY = """
from odt_plugins.ahead import SIGNATURES
from odt_plugins.engine.compiled.library import FILE, load
raise SystemExit(not {*SIGNATURES.read_text(encoding="utf-8").splitlines()} <= {*load(FILE)})
"""
"""Ends without an error where the library beside the sources has all kernels as they are now."""


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
    """Copies the package, and adds the library, built unless it is there already."""

    def run(self) -> None:
        super().run()
        if not LINKS:
            self.warn("no linker (CC or cc): numba will compile the kernels when they first run")
            return
        place = Path("odt_plugins") / "engine" / "compiled" / "kernels.so"
        library = place if self.editable_mode else Path(self.build_lib) / place
        if subprocess.run([sys.executable, "-c", READY], stderr=subprocess.DEVNULL).returncode == 0:
            if library != place:
                self.copy_file(str(place), str(library))
            return
        try:
            subprocess.run([sys.executable, "-m", "odt_plugins.ahead", str(library)], check=True)
        except (OSError, subprocess.CalledProcessError) as error:
            self.warn(f"no library of kernels ({error}); install odt-plugins[numba] as well")


class ForAnyPython(bdist_wheel):
    """Names the wheel: the library is for one system, and uses nothing of Python's."""

    def get_tag(self) -> tuple[str, str, str]:
        return "py3", "none", super().get_tag()[2]


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
    """A package with machine code, where that can be linked."""

    def has_ext_modules(self) -> bool:
        return LINKS


setup(cmdclass={"bdist_wheel": ForAnyPython, "build_py": WithKernels, "sdist": WithTests},
      distclass=ForOneSystem, install_requires=NEEDS if LINKS else [*NEEDS, "numba>=0.60"],
      long_description=first_page(), long_description_content_type="text/markdown")
