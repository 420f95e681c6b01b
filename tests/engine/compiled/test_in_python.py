"""Kernels as functions of Python, where NumPy looks whether every index is within its array."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

RUNS = {
    "cells": ("ball", "optimize(mesh, insert=True)", "remesh(mesh, scale=0.9)"),
    "triangles in the plane": (
        "plate", "optimize(mesh)", "optimize(mesh, boundary='slide')", "remesh(mesh, scale=0.9)"),
    "a curved surface": ("pebble", "optimize(mesh)", "remesh(mesh, scale=0.9)"),
}
"""The start mesh, and what is done with it."""

RUN = """
import sys
import numpy as np
from odt_plugins import optimize, remesh
from odt_plugins.generate import clouds
mesh = getattr(clouds, sys.argv[1])(6)
np.seterr(divide="ignore", invalid="ignore")
for call in sys.argv[2:]:
    for array in eval(call):
        print(array.shape, array.tobytes().hex())
"""


@pytest.mark.parametrize("name", RUNS)
def test_kernels_in_python_give_the_same_bits(name):
    told = []
    for python in "01":
        done = subprocess.run(
            [sys.executable, "-W", "error::RuntimeWarning", "-c", RUN, *RUNS[name]], check=False,
            env=os.environ | {"NUMBA_DISABLE_JIT": python}, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        told.append(done.stdout)
    assert told[0]
    assert told[0] == told[1]
