"""Random options, drawn from the package's own list."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from typing import TYPE_CHECKING, Any, Literal, get_args, get_origin, get_type_hints

import numpy as np

from odt_plugins.errors import InvalidOptionError
from odt_plugins.options import (
    DENSITIES,
    FIGURES,
    STAYS,
    Connectivity,
    LinearSolver,
    Options,
    Solver,
)

if TYPE_CHECKING:
    from attack.shapes import RandomMesh

Rng = np.random.Generator

GIVEN = 0.25
"""Probability that an option is given."""

OFTEN = {"repair": 0.6, "smoothing": 0.6}
"""The same of some: a mesh that needs no turning is not changed by it, and of the values of the
other each is given seldom."""


def random_options(
    rng: Rng, mesh: RandomMesh, labels: np.ndarray | None = None
) -> dict[str, Any]:
    """Options for a mesh that go together, and now and then some that do not.

    Parameters
    ----------
    rng : Generator
    mesh : RandomMesh
    labels : (m,) int    to be given as regions, if any
    """
    while True:
        found = {}
        for name, hint in get_type_hints(Options).items():
            if rng.random() < OFTEN.get(name, GIVEN) or (name == "regions" and labels is not None):
                found[name] = random_value(name, hint, rng, mesh, labels)
        try:
            Options(**found)
        except InvalidOptionError:
            if rng.random() < 0.97:
                continue
        return found


def random_value(
    name: str, hint: Any, rng: Rng, mesh: RandomMesh, labels: np.ndarray | None = None
) -> Any:
    """One value of an option: by its name where that says more than its type.

    Raises
    ------
    TypeError    a new option whose type says nothing
    """
    if name in BY_NAME:
        return BY_NAME[name](rng, mesh, labels)
    if get_origin(hint) is Literal:
        return str(rng.choice(get_args(hint)))
    if hint is bool:
        return bool(rng.random() < 0.5)
    if hint is int:
        return int(rng.integers(0, 4))
    msg = f"nothing is known of the option {name}; give it a line in BY_NAME"
    raise TypeError(msg)


def _density(rng: Rng, mesh: RandomMesh, _labels: Any) -> Any:
    chance = rng.random()
    if chance < 0.6:
        return str(rng.choice(DENSITIES))
    if chance < 0.75:
        origin, size = mesh.points[0], float(np.ptp(mesh.points)) or 1.0
        d = len(origin)
        return lambda x: 1.0 + (((x[:, :d] - origin) / size) ** 2).sum(axis=1)
    count = rng.choice([len(mesh.points), len(mesh.cells)])
    values = 10.0 ** rng.uniform(-3, 3, count)
    if chance > 0.97 and count:
        values[rng.integers(count)] = rng.choice([0.0, -1.0, np.nan, np.inf])
    return values


def _metric(rng: Rng, mesh: RandomMesh, _labels: Any) -> Any:
    """That of the mesh, or tensors with ratios of lengths up to 100, the same everywhere or not."""
    if rng.random() < 0.3:
        return "input"
    n, d = mesh.points.shape
    axes = np.linalg.qr(rng.normal(size=(d, d)))[0]
    values = np.exp(rng.uniform(-4.6, 4.6, (1 if rng.random() < 0.5 else n, d)))
    tensors = np.broadcast_to((axes * values[:, None]) @ axes.T, (n, d, d))
    if rng.random() < 0.03 and n:
        tensors = tensors.copy()
        tensors[rng.integers(n), 0, 0] = rng.choice([0.0, -1.0, np.nan, np.inf])
    return tensors if rng.random() < 0.8 else tensors[:, *np.tril_indices(d)]


def _some_of(count: int, rng: Rng) -> Any:
    """A mask, or indices as an array or a list."""
    mask = rng.random(count) < rng.choice([0.05, 0.5, 0.9, 1.0])
    chance = rng.random()
    if chance < 0.5:
        return mask
    return np.flatnonzero(mask) if chance < 0.8 else np.flatnonzero(mask).tolist()


def _regions(_rng: Rng, _mesh: RandomMesh, labels: Any) -> Any:
    return "auto" if labels is None else labels


def _keep(rng: Rng, _mesh: RandomMesh, _labels: Any) -> tuple[str, ...]:
    return tuple(name for name in FIGURES if rng.random() < 0.5)


def _share(rng: Rng) -> float:
    """A share of vertices: too small for one of them up to more than there were; or no share."""
    if rng.random() < 0.03:
        return float(rng.choice([-0.1, np.nan, np.inf]))
    return float(10.0 ** rng.uniform(-3, 0.2))


SMOOTHING: dict[str, Callable[[Rng], Any]] = {
    "solver": lambda rng: str(rng.choice(get_args(Solver))),
    "connectivity": lambda rng: str(rng.choice(get_args(Connectivity))),
    "linear_solver": lambda rng: str(rng.choice(get_args(LinearSolver))),
    "exponent": lambda rng: float(10.0 ** rng.uniform(-2, 1)),
    "omega": lambda rng: float(rng.uniform(0.05, 3.0)),
    "rounds": lambda rng: int(rng.choice([0, 1, 5, 100])),
    "cycles": lambda rng: int(rng.integers(0, 4)),
}

BY_NAME: dict[str, Callable[[Rng, Any, Any], Any]] = {
    "density": _density,
    "metric": _metric,
    "reference": lambda _rng, mesh, _: (mesh.points, mesh.cells),
    "smoothing": lambda rng, *_: {
        name: draw(rng) for name, draw in SMOOTHING.items() if rng.random() < GIVEN},
    "envelope": lambda rng, *_: float(10.0 ** rng.uniform(-8, -0.1)),
    "feature_angle": lambda rng, *_: float(rng.uniform(1.0, 180.0)),
    "fixed": lambda rng, mesh, _: _some_of(len(mesh.points), rng),
    "selection": lambda rng, mesh, _: _some_of(len(mesh.cells), rng),
    "regions": _regions,
    "keep": _keep,
    "free": lambda rng, *_: tuple(name for name in STAYS if rng.random() < 0.5),
    "insert": lambda rng, *_: bool(rng.random() < 0.5) if rng.random() < 0.5 else _share(rng),
    "repair": lambda rng, *_: str(rng.choice(["orient", "auto", "none"], p=[0.6, 0.1, 0.3])),
    "threads": lambda rng, *_: int(rng.integers(1, 4)),
    "progress": lambda *_: lambda _stage, _fraction: None,
}


def all_known() -> list[str]:
    """Names of the options that a random value cannot be drawn for; none."""
    hints = get_type_hints(Options)
    return [f.name for f in fields(Options)
            if f.name not in BY_NAME and get_origin(hints[f.name]) is not Literal
            and hints[f.name] not in (bool, int)]
