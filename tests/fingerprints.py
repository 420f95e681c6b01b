"""Prints one SHA-256 for every run of a fixed list: the bits of its points and cells.

    python tests/fingerprints.py > before.txt                      # then change the code
    python tests/fingerprints.py | diff before.txt -
    OPENBLAS_CORETYPE=Haswell python tests/fingerprints.py | diff before.txt -
    python tests/fingerprints.py --only slide                      # names that hold "slide"
    python tests/fingerprints.py a.vtu b.vtu                       # these meshes, not the list

A line holds the hash of the result, the first digits of that of the start mesh, and the name. A
run that raises has the hash of its error. All runs take one to two minutes on two cores once the
kernels are compiled.
"""

from __future__ import annotations

import argparse
import hashlib
import multiprocessing
import os
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from unittest import mock

import numpy as np
from measure.hard import hard_meshes
from measure.meshes import kuhn_lattice

import odt_plugins
from odt_plugins.compare.start import StartMesh, ball, pebble, plate, read_start, suite
from odt_plugins.distributed import optimize as blockwise
from odt_plugins.engine.compiled import threads
from odt_plugins.generate import SAMPLES, distmesh2d, odtmesh2d, refine_with_report, uniform_refine

Arrays = tuple[np.ndarray, ...]
Run = Callable[[], tuple[Arrays, Arrays]]
"""Gives the arrays of the start mesh and those of the result."""

threads.THREADED_CELLS = 0
HERE = Path(__file__).parent
sys.path.append(str(HERE / "helpers"))
HARD = 1000
"""Vertices of every hard mesh, about."""

FILES = sorted([*HERE.glob("data/*.vtu"), *HERE.glob("../examples/meshes/*.vtu")])

VOLUME = {
    "slide": {"boundary": "slide"},
    "slide far": {"boundary": "slide", "envelope": 0.02, "feature_angle": 60.0,
                  "smoothing": {"cycles": 2}},
    "insert": {"insert": True},
    "insert, slide, dihedral": {"insert": True, "boundary": "slide", "objective": "min_dihedral"},
    "three cycles": {"smoothing": {"cycles": 3}},
}
"""Options for tetrahedra."""

SOLID = {
    "global, amg": {"smoothing": {"solver": "global", "linear_solver": "amg"}},
    "global, direct": {"smoothing": {"solver": "global", "linear_solver": "direct"}},
    "global cpt": {"smoothing": {"solver": "global"}, "method": "cpt"},
    "lbfgs": {"smoothing": {"solver": "lbfgs", "rounds": 5}},
    "jacobi": {"smoothing": {"solver": "jacobi"}},
    "richardson": {"smoothing": {"solver": "richardson"}},
    "cpt": {"method": "cpt"},
    "laplacian": {"method": "laplacian"},
    "cvt": {"method": "cvt"},
    "connectivity delaunay": {"smoothing": {"connectivity": "delaunay"}},
    "connectivity flips": {"smoothing": {"connectivity": "flips"}},
    "connectivity none": {"smoothing": {"connectivity": "none"}},
    "objective min_dihedral": {"objective": "min_dihedral"},
    "objective amips": {"objective": "amips"},
    "density uniform": {"density": "uniform"},
    "density inverse-volume": {"density": "inverse-volume"},
    "without finishing": {"finish": False},
    "two threads": {"threads": 2},
    "keep nothing": {"keep": ()},
}
"""Options for tetrahedra and for triangles in a plane."""

CURVED = {
    "fixed": {"boundary": "fixed"},
    "slide": {"boundary": "slide"},
    "curvature": {"density": "curvature"},
    "far": {"envelope": 0.02},
    "two threads": {"threads": 2},
}
"""Options for curved surfaces."""


def optimized(start: Callable[[], Arrays], **options: object) -> tuple[Arrays, Arrays]:
    """A run of `optimize`."""
    mesh = start()
    return mesh, odt_plugins.optimize(mesh, **options)


@cache
def standard(name: str) -> Arrays:
    return next(arrays(start) for start in suite("standard") if start.name == name)


@cache
def hard() -> dict[str, Arrays]:
    return {mesh.name: (steady(mesh.points), mesh.cells)
            + (() if mesh.regions is None else (mesh.regions,)) for mesh in hard_meshes(HARD)}


def hard_one(name: str) -> Arrays:
    return hard()[name]


def arrays(start: StartMesh) -> Arrays:
    return steady(start.points), start.cells


def steady(points: np.ndarray) -> np.ndarray:
    """Points without their last bits: sines of numpy have others on other processors."""
    unit = 2.0 ** (np.ceil(np.log2(np.ptp(points, axis=0).max())) - 40)
    return np.round(points / unit) * unit


def read(path: Path) -> Arrays:
    start = read_start(path)
    return start.points, start.cells


@cache
def made(maker: Callable[[int], StartMesh], n: int) -> Arrays:
    return arrays(maker(n))


def shape(name: str) -> Arrays:
    """A curved surface with features, a rim, or both."""
    import surface_meshes

    points, cells = {
        "cylinder": lambda: surface_meshes.cylinder(noise=0.25),
        "cube": lambda: surface_meshes.cube(noise=0.25),
        "bowl": lambda: surface_meshes.bowl(noise=0.2),
        "torus": lambda: surface_meshes.torus(noise=0.3),
    }[name]()
    return steady(np.asarray(points, dtype=float)), np.asarray(cells)


def tilted() -> Arrays:
    """A planar mesh in a slanted plane of space."""
    points, cells = made(plate, 1500)
    x, y = points[:, 0], points[:, 1]
    return np.stack([0.6 * x + 3.0, 0.8 * x, 0.28 * y], axis=1), cells


def labelled() -> Arrays:
    """A ball of two halves."""
    points, cells = made(ball, 1200)
    center = points[cells].mean(axis=1)
    return points, cells, (center[:, 0] > 0.05).astype(np.int64)


def single() -> Arrays:
    points, cells = made(ball, 1200)
    return points.astype(np.float32), cells.astype(np.int64)


def selected(**options: object) -> tuple[Arrays, Arrays]:
    mesh = made(ball, 1200)
    chosen = mesh[0][mesh[1]].mean(axis=1)[:, 2] > 0.0
    return mesh, odt_plugins.optimize(mesh, selection=chosen, fixed=[900, 901], **options)


def in_blocks(start: Callable[[], Arrays], blocks: int) -> tuple[Arrays, Arrays]:
    mesh = start()
    with mock.patch.object(blockwise, "LEAST_CELLS", 5000):
        return mesh, odt_plugins.optimize(mesh, blocks=blocks)


def in_pieces() -> tuple[Arrays, Arrays]:
    from pieces import glued, write_pieces

    from odt_plugins.api import optimize_file
    from odt_plugins.distributed.partition import bricks

    points, cells = standard("ball-14k")
    label = bricks(points, cells, 3)
    with tempfile.TemporaryDirectory() as folder:
        index = write_pieces(Path(folder, "in"), points, cells, label)
        optimize_file(index, Path(folder, "out.pvtu"))
        return (points, cells), glued(Path(folder, "out.pvtu"), len(points))


def generated(name: str, mesher: Callable[..., Arrays]) -> tuple[Arrays, Arrays]:
    sample = SAMPLES[name]
    return (), mesher(sample.fd, sample.fh, sample.h0, sample.bbox, sample.pfix)


def refined(levels: int) -> tuple[Arrays, Arrays]:
    mesh = made(ball, 300)
    return mesh, refine_with_report(mesh, levels, envelope=0.01)[0]


def halved() -> tuple[Arrays, Arrays]:
    mesh = made(ball, 300)
    return mesh, uniform_refine(mesh)


def runs() -> dict[str, Run]:
    """All runs of the list, by name."""
    found: dict[str, Run] = {}
    for start in suite("standard"):
        found[f"standard: {start.name}"] = partial(optimized, partial(standard, start.name))
    for name in hard():
        found[f"hard: {name}"] = partial(optimized, partial(hard_one, name))
    for path in FILES:
        found[f"file: {path.name}"] = partial(optimized, partial(read, path))
    solids = {"ball": partial(made, ball, 600), "plate": partial(made, plate, 1500)}
    for title, start in solids.items():
        for name, options in SOLID.items():
            found[f"{title}: {name}"] = partial(optimized, start, **options)
    volumes = {"ball": partial(made, ball, 600), "bone": partial(standard, "bone"),
               "lattice": partial(kuhn_lattice, 6)}
    for title, start in volumes.items():
        for name, options in VOLUME.items():
            found[f"{title}: {name}"] = partial(optimized, start, **options)
    found["bunny: slide"] = partial(optimized, partial(standard, "bunny"), boundary="slide")
    found["bunny: global"] = partial(optimized, partial(standard, "bunny"),
                                     smoothing={"solver": "global"})
    found["plate-7k: global"] = partial(optimized, partial(standard, "plate-7k"),
                                        smoothing={"solver": "global", "linear_solver": "amg"})
    found["bunny: two threads"] = partial(optimized, partial(standard, "bunny"), threads=2)
    found["labelled ball"] = partial(optimized, labelled)
    found["labelled ball: slide"] = partial(optimized, labelled, boundary="slide")
    found["single precision"] = partial(optimized, single)
    found["selection"] = selected
    found["selection: slide"] = partial(selected, boundary="slide")
    found["plane in space"] = partial(optimized, tilted)
    surfaces = {"pebble": partial(made, pebble, 1500), "bone-surface":
                partial(standard, "bone-surface"), "cylinder": partial(shape, "cylinder"),
                "bowl": partial(shape, "bowl")}
    for title, start in surfaces.items():
        for name, options in CURVED.items():
            found[f"{title}: {name}"] = partial(optimized, start, **options)
    for title in ("cube", "torus"):
        found[f"surface: {title}"] = partial(optimized, partial(shape, title))
    found["blocks: bunny"] = partial(in_blocks, partial(standard, "bunny"), 4)
    found["blocks: ball"] = partial(in_blocks, partial(made, ball, 5000), 2)
    found["pieces: ball"] = in_pieces
    for name in SAMPLES:
        found[f"odtmesh2d: {name}"] = partial(generated, name, odtmesh2d)
    found["distmesh2d: ring"] = partial(generated, list(SAMPLES)[1], distmesh2d)
    found["refined and optimized"] = partial(refined, 2)
    found["uniformly refined"] = halved
    return found


def runs_on(paths: list[Path]) -> dict[str, Run]:
    """Runs on given files: default options, and what else fits the kind of mesh."""
    found: dict[str, Run] = {}
    for path in paths:
        tetrahedra = read(path)[1].shape[1] == 4
        for name, options in {"default": {}, **(VOLUME if tetrahedra else {})}.items():
            found[f"{path}: {name}"] = partial(optimized, partial(read, path), **options)
    return found


def digest(parts: Arrays) -> str:
    """SHA-256 of the types, shapes and bytes of arrays."""
    total = hashlib.sha256()
    for part in parts:
        total.update(f"{part.dtype.str} {part.shape}".encode())
        total.update(np.ascontiguousarray(part).tobytes())
    return total.hexdigest()


def line(run: Run, name: str) -> str:
    """One run's line."""
    warnings.simplefilter("ignore")
    try:
        start, result = run()
    except Exception as exc:
        text = f"{type(exc).__name__}: {exc}"
        print(f"{name}: {text}", file=sys.stderr)
        return f"{hashlib.sha256(text.encode()).hexdigest()}  {'raised':12}  {name}"
    return f"{digest(result)}  {digest(start)[:12]}  {name}"


def work(job: tuple[str, list[Path]]) -> tuple[str, float]:
    """Run one job in a process of the pool."""
    name, paths = job
    clock = time.perf_counter()
    text = line(_all(tuple(paths))[name], name)
    return text, time.perf_counter() - clock


@cache
def _all(paths: tuple[Path, ...]) -> dict[str, Run]:
    return runs_on(list(paths)) if paths else runs()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("meshes", nargs="*", type=Path, help="files to run on instead of the list")
    parser.add_argument("--only", default="", metavar="NAME", help="runs whose name holds this")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--times", action="store_true", help="seconds of every run, on stderr")
    given = parser.parse_args()
    names = [name for name in _all(tuple(given.meshes)) if given.only in name]
    with multiprocessing.get_context("spawn").Pool(given.workers) as pool:
        for text, seconds in pool.imap(work, [(name, given.meshes) for name in names]):
            print(text, flush=True)
            if given.times:
                print(f"{seconds:8.2f}  {text[80:]}", file=sys.stderr)


if __name__ == "__main__":
    main()
