"""HDF5 files, written in a process of their own.

A file that HDF5 could not write to its end, because the disk is full, stays half open: the process
crashes when its handle is collected, or at its exit.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

from odt_plugins.adapters.reading import sentences
from odt_plugins.errors import exit_name

FORMATS = ("cgns", "exodus", "h5m", "hmf", "med", "xdmf")
"""Formats of meshio that HDF5 writes, that of Exodus through netCDF."""

PROGRAM = """
import gc, os, pickle, sys
answer = os.fdopen(os.dup(1), "wb")
sys.stdout = sys.stderr

def end(error):
    try:
        answered = pickle.dumps(error)
        pickle.loads(answered)
    except Exception:
        answered = pickle.dumps(RuntimeError(f"{type(error).__name__}: {error}"))
    answer.write(answered)
    answer.flush()
    sys.stderr.flush()
    os._exit(0)

sys.unraisablehook = lambda told: end(told.exc_value)
try:
    path, name, mesh = pickle.load(sys.stdin.buffer)
    import meshio
    meshio.write(path, mesh, file_format=name)
    del mesh
    gc.collect()
except Exception as exc:
    end(exc)
end(None)
"""
"""What the process runs. It ends with the first error, in the collection of a handle as well, as
what is left open would crash it."""


def write(path: Path, mesh: Any, name: str) -> list[str]:
    """Write a mesh as meshio.write does.

    Parameters
    ----------
    path : path
    mesh : meshio.Mesh
    name : str              one of FORMATS

    Returns
    -------
    list of str             what meshio says about it

    Raises
    ------
    Exception               what meshio raises
    ChildProcessError       the process ended without an answer
    """
    done = subprocess.run(
        [sys.executable, "-P", "-c", PROGRAM], input=pickle.dumps((str(path), name, mesh)),
        capture_output=True, check=False,
        env=dict(os.environ) | {"PYTHONPATH": os.pathsep.join(map(os.path.abspath, sys.path))},
    )
    if done.returncode:
        msg = f"the process that wrote it was ended by {exit_name(done.returncode)}"
        raise ChildProcessError(msg)
    error = pickle.loads(done.stdout)
    if error is not None:
        raise error
    return sentences(done.stderr.decode("utf-8", "replace"))
