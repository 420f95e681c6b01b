"""Work in a process of its own, which may crash or never end: ``python -m`` this module.

HDF5 needs that: a file that it could not write to its end, because the disk is full, stays half
open, and crashes the process when its handle is collected, or at its exit; and it reads some
damaged files for ever, while no other thread runs.
"""

from __future__ import annotations

import gc
import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from typing import Any

from odt_plugins.errors import exit_name

HDF5 = ("cgns", "exodus", "h5m", "hmf", "med", "xdmf")
"""Formats of meshio that HDF5 reads and writes, that of Exodus through netCDF."""


def call(function: Callable[..., Any], *arguments: Any, seconds: float | None = None) -> Any:
    """Call a function of a module in a process of its own.

    Parameters
    ----------
    function : callable
    *arguments : anything        that pickle takes
    seconds : float, optional    after which the process is ended

    Returns
    -------
    what the function returns

    Raises
    ------
    TimeoutError            it was not done
    ChildProcessError       the process ended without an answer
    Exception               what the function raises, or the collection of what it left
    """
    paths = os.pathsep.join(map(os.path.abspath, sys.path))
    try:
        done = subprocess.run(
            [sys.executable, "-P", "-m", "odt_plugins.adapters.apart"], capture_output=True,
            input=pickle.dumps((function, arguments)), check=False, timeout=seconds,
            env=dict(os.environ) | {"PYTHONPATH": paths},
        )
    except subprocess.TimeoutExpired as exc:
        msg = f"no answer within {seconds} s"
        raise TimeoutError(msg) from exc
    if done.returncode:
        said = done.stderr.decode("utf-8", "replace").strip().splitlines()
        msg = f"its process was ended by {exit_name(done.returncode)}"
        raise ChildProcessError(f"{msg}: {said[-1]}" if said else msg)
    answer, error = pickle.loads(done.stdout)
    if error is not None:
        raise error
    return answer


def main() -> None:
    """Do the work that standard input names, and write its result or error to standard output."""
    stream = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)

    def end(result: Any, error: BaseException | None) -> None:
        try:
            answer = pickle.dumps((result, error))
            pickle.loads(answer)
        except Exception:
            answer = pickle.dumps((None, RuntimeError(f"{type(error).__name__}: {error}")))
        stream.write(answer)
        stream.flush()
        # What is left open would crash the process on its way out.
        os._exit(0)

    sys.unraisablehook = lambda told: end(None, told.exc_value)
    try:
        function, arguments = pickle.load(sys.stdin.buffer)
        result = function(*arguments)
        del arguments
        gc.collect()
    # A reader or writer may raise anything at all.
    except Exception as exc:
        end(None, exc)
    end(result, None)


if __name__ == "__main__":
    main()
