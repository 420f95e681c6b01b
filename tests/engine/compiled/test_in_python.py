"""Kernels as functions of Python, where NumPy looks whether every index is within its array."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from odt_plugins import optimize, remesh
from odt_plugins.generate import clouds

RUNS = {
    "cells": ("ball", "optimize(mesh, insert=True)", "remesh(mesh, scale=0.9)"),
    "triangles in the plane": (
        "plate", "optimize(mesh)", "optimize(mesh, boundary='slide')", "remesh(mesh, scale=0.9)"),
    "a curved surface": ("pebble", "optimize(mesh)", "remesh(mesh, scale=0.9)"),
}
"""The start mesh, and what is done with it."""

RUN = """
import sys
from importlib import import_module
from pkgutil import walk_packages
import numpy as np
from odt_plugins import engine, optimize, remesh
from odt_plugins.engine.compiled.kernel import Kernel
from odt_plugins.generate import clouds
# A kernel that calls another calls its function, without asking each time how it is to run.
names = [found.name for found in walk_packages(engine.__path__, "odt_plugins.engine.")
         if ".compiled." not in found.name]
for module in map(import_module, names):
    for name, value in [*vars(module).items()]:
        if isinstance(value, Kernel):
            value.py_func.py_func = value.py_func
            setattr(module, name, value.py_func)
mesh = getattr(clouds, sys.argv[1])(6)
np.seterr(divide="ignore", invalid="ignore")
for call in sys.argv[2:]:
    for array in eval(call):
        print(array.shape, array.tobytes().hex())
"""


def told(array):
    return f"{array.shape} {array.tobytes().hex()}"


@pytest.mark.parametrize("name", RUNS)
def test_kernels_in_python_give_the_same_bits(name):
    made, *calls = RUNS[name]
    mesh = getattr(clouds, made)(6)
    known = [told(part) for call in calls
             for part in eval(call, {"optimize": optimize, "remesh": remesh, "mesh": mesh})]
    done = subprocess.run(
        [sys.executable, "-W", "error::RuntimeWarning", "-c", RUN, *RUNS[name]], check=False,
        env=os.environ | {"NUMBA_DISABLE_JIT": "1"}, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == known
