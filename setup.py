"""Compiles the kernels while the package is built, so that its first run begins at once.

Everything else is said in pyproject.toml. A package without them works as well: it compiles what
a run needs when it needs it.
"""

import subprocess
import sys
from pathlib import Path

from setuptools import Distribution, setup
from setuptools.command.build_py import build_py


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


class ForOneSystem(Distribution):
    """A package with machine code."""

    def has_ext_modules(self) -> bool:
        return True


setup(cmdclass={"build_py": WithKernels}, distclass=ForOneSystem)
