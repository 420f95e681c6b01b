"""Meshing the unit circle: odtmesh2d against the truss iteration of distmesh, over the vertices."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import Any

from measure.part import Part, power_laws
from measure.stages import fit
from odt_plugins.compare.table import Say, Table, Value
from odt_plugins.figures import radius_ratio, uniformity

TRUSS_STEPS = 100
"""Steps of the truss alone; it seldom comes to rest within a thousand."""

PATIENCE = 60.0
"""CPU seconds after which the truss is not asked for a larger mesh."""

HEADS = ("method", "vertices", "CPU [s]", "vertices a second", "least q", "1 % q", "mean q",
         "std of R/h [%]")


def generation_part(sizes: Sequence[int], threads: int, say: Say) -> Part:
    """Mesh the unit circle with about so many vertices.

    Parameters
    ----------
    sizes : ints      vertices
    threads : int     one is used
    say : callable    is told what is measured
    """
    from odt_plugins.generate import distmesh2d, odtmesh2d

    def truss(*domain: Any) -> Any:
        return distmesh2d(*domain, steps=TRUSS_STEPS, tolerance=0.0)

    rows: list[tuple[Value, ...]] = []
    series = []
    for name, method in (("odtmesh2d", odtmesh2d), (f"distmesh, {TRUSS_STEPS} steps", truss)):
        times: list[tuple[int, float]] = []
        _mesh(method, 2000)
        for size in sizes:
            if name != "odtmesh2d" and times and times[-1][1] > PATIENCE:
                break
            rows.append((name, *_mesh(method, size)))
            times.append((int(rows[-1][1]), float(rows[-1][2])))
            say(f"{name}: {times[-1][0]} vertices, {times[-1][1]:.1f} s")
        series.append((name, [n for n, _ in times], [s for _, s in times], fit(name, times)))
    notes = [f"time of {name} grows with the vertices to the power {found.exponent:.2f}"
             for name, _, _, found in series if found.exponent is not None]
    chart = power_laws("CPU seconds to mesh the unit circle", [s[:3] for s in series], "vertices",
                       "CPU seconds")
    title = "Unit circle of one size; the paper: least q .74, mean .99, 2.9 %"
    return Part([Table("generation", title, HEADS, rows, notes)], [chart])


def _mesh(method: Callable[..., Any], size: int) -> tuple[Value, ...]:
    from odt_plugins.generate import SAMPLES

    sample = SAMPLES["circle"]
    h0 = math.sqrt(math.pi / (size * math.sqrt(0.75)))
    clock = time.process_time()
    points, cells = method(sample.fd, sample.fh, h0, sample.bbox)
    seconds = time.process_time() - clock
    q = radius_ratio(points, cells)
    q.sort()
    return (len(points), seconds, len(points) / seconds, float(q[0]), float(q[len(q) // 100]),
            float(q.mean()), 100.0 * uniformity(points, cells))
