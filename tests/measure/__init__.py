"""Measurements of the package itself: ``python tests/measure NAME ...``, see `measure.command`."""

from __future__ import annotations

import os
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]

# The processes in which some of it runs import it as well.
os.environ["PYTHONPATH"] = os.pathsep.join(
    filter(None, [str(TESTS), os.environ.get("PYTHONPATH", "")]))
