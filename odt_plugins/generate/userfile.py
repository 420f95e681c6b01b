"""Domains from a Python file that defines fd and, if it likes, fh, bbox, pfix and h0."""

from __future__ import annotations

import runpy
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from odt_plugins.errors import InvalidOptionError, MeshFileError, ODTError
from odt_plugins.generate.samples import Sample
from odt_plugins.generate.sizes import huniform
from odt_plugins.mesh.arrays import FloatArray

UNIT_BOX = ((-1.0, -1.0), (1.0, 1.0))
"""Bounding box of a file that names none."""


def read_domain(path: Path) -> tuple[Sample, bool]:
    """Run a Python file, which may import those beside it, and take what distmesh2d is given.

    Parameters
    ----------
    path : Path    defines fd(p); optional are fh(p), bbox, pfix and h0

    Returns
    -------
    sample : Sample      h0 is 0 when the file does not say
    known : bool         whether the file says h0

    Raises
    ------
    MeshFileError        there is no such file
    InvalidOptionError   it does not run, or defines no function fd
    """
    if not path.is_file():
        msg = f"cannot read {path}: it is missing; expected a Python file that defines fd"
        raise MeshFileError(msg)
    beside = str(path.absolute().parent)
    sys.path.insert(0, beside)
    try:
        names = runpy.run_path(str(path))
    except (Exception, SystemExit) as exc:
        msg = f"{path} does not run: {type(exc).__name__}: {exc}"
        raise InvalidOptionError(msg) from exc
    finally:
        if beside in sys.path:
            sys.path.remove(beside)
    if not callable(names.get("fd")):
        msg = (f"{path} defines no function fd; expected fd(p), the signed distance of points "
               "(n, 2), and optionally fh(p), bbox, pfix and h0")
        raise InvalidOptionError(msg)
    fd = _guarded(path, "fd", names["fd"])
    fh = _guarded(path, "fh", names["fh"]) if callable(names.get("fh")) else names.get("fh")
    sample = Sample(path.stem, fd, huniform if fh is None else fh, names.get("h0", 0.0),
                    names.get("bbox", UNIT_BOX), names.get("pfix", ()), (np.nan,) * 3)
    return sample, "h0" in names


def _guarded(path: Path, name: str, function: Callable[..., Any]) -> Callable[[FloatArray], Any]:
    """Turn what a function of the user's raises into a sentence."""

    def guarded(points: FloatArray) -> Any:
        try:
            return function(points)
        except ODTError:
            raise
        except Exception as exc:
            msg = f"{name} of {path} fails: {type(exc).__name__}: {exc}"
            raise InvalidOptionError(msg) from exc

    return guarded
