"""Triangles remeshed to a size by this package and by others: figures by independent code."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from odt_plugins.adapters.files import read_file
from odt_plugins.adapters.registry import find_adapter
from odt_plugins.compare.table import Say

HEADS = "mesh size | who | vertices | q least / 1 % / mean | angles | < 30 | in | distance, 1e-3"

SAMPLES = 60_000

SCALES = (0.5, 1.0, 2.0)
"""Sizes, as multiples of the mean edge of the input."""

ENVELOPE = 1e-3


def run_retiling(meshes: list[Path], say: Say) -> str:
    """Give the figures of remeshed triangles, a line for each mesh, size and program."""
    lines = [HEADS]
    for path in meshes:
        host = find_adapter(read_file(path)).read(read_file(path))
        points, cells = np.asarray(host.points, np.float64), np.asarray(host.cells, np.int64)
        planar = points.shape[1] == 2 or not np.ptp(points[:, 2])
        points = np.pad(points[:, :2], ((0, 0), (0, 1))) if planar else points
        mean = float(_edges(points, cells).mean())
        for scale in SCALES:
            for name, run in (IN_PLANE if planar else ON_SURFACE).items():
                say(f"{path.stem} x{scale} {name}")
                clock = time.perf_counter()
                try:
                    p, t = run(points, cells, scale * mean)
                except Exception as exc:
                    lines.append(f"{path.stem} x{scale} | {name} | {exc}")
                    continue
                seconds = time.perf_counter() - clock
                figures = _figures(points, cells, p, t, scale * mean)
                lines.append(f"{path.stem} x{scale} | {name} {seconds:.1f} s | {figures}")
    return "\n".join(lines)


def _ours(p: Any, t: Any, h: float) -> tuple[Any, Any]:
    from odt_plugins import remesh

    planar = not np.ptp(p[:, 2])
    points, cells = remesh((p[:, :2].copy() if planar else p, t), h, envelope=ENVELOPE)
    return np.pad(points, ((0, 0), (0, 3 - points.shape[1]))), cells


def _meshlab(p: Any, t: Any, h: float) -> tuple[Any, Any]:
    import pymeshlab

    scene = pymeshlab.MeshSet()
    scene.add_mesh(pymeshlab.Mesh(p, t))
    bound = pymeshlab.PureValue(ENVELOPE * np.linalg.norm(np.ptp(p, axis=0)))
    scene.meshing_isotropic_explicit_remeshing(
        iterations=10, targetlen=pymeshlab.PureValue(h), checksurfdist=True, maxsurfdist=bound)
    return scene.current_mesh().vertex_matrix(), scene.current_mesh().face_matrix()


def _mmg(p: Any, t: Any, h: float) -> tuple[Any, Any]:
    import mmgpy

    bound = ENVELOPE * float(np.linalg.norm(np.ptp(p, axis=0)))
    planar = not np.ptp(p[:, 2])
    kind = mmgpy.MmgMesh2D if planar else mmgpy.MmgMeshS
    mesh = kind(np.ascontiguousarray(p[:, :2] if planar else p), t.astype(np.int32))
    mesh.remesh(hsiz=h, hausd=bound, verbose=-1)
    points = mesh.get_vertices()
    return np.pad(points, ((0, 0), (0, 3 - points.shape[1]))), mesh.get_triangles()


def _gmsh(p: Any, t: Any, h: float) -> tuple[Any, Any]:
    import gmsh

    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.addDiscreteEntity(2, 1)
        gmsh.model.mesh.addNodes(2, 1, np.arange(1, len(p) + 1), p.ravel())
        gmsh.model.mesh.addElementsByType(1, 2, [], (t + 1).ravel())
        gmsh.model.mesh.classifySurfaces(0.7, True, True)
        gmsh.model.mesh.createGeometry()
        for option in ("Min", "Max"):
            gmsh.option.setNumber(f"Mesh.MeshSize{option}", h)
        gmsh.model.mesh.generate(2)
        tags, x, _ = gmsh.model.mesh.getNodes()
        rows = np.concatenate([gmsh.model.mesh.getElementsByType(2, e)[1]
                               for _, e in gmsh.model.getEntities(2)]).reshape(-1, 3)
    finally:
        gmsh.finalize()
    number = np.zeros(int(tags.max()) + 1, np.int64)
    number[tags] = np.arange(len(tags))
    return x.reshape(-1, 3), number[rows.astype(np.int64)]


Run = Callable[[Any, Any, float], tuple[Any, Any]]

ON_SURFACE: dict[str, Run] = {"odt-plugins": _ours, "MeshLab": _meshlab, "mmgs": _mmg,
                              "Gmsh": _gmsh}
IN_PLANE: dict[str, Run] = {"odt-plugins": _ours, "mmg2d": _mmg, "Gmsh": _gmsh}


def _edges(p: Any, t: Any) -> Any:
    pairs = np.unique(np.sort(np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]]), axis=1),
                      axis=0)
    return np.linalg.norm(p[pairs[:, 0]] - p[pairs[:, 1]], axis=1)


def _figures(p: Any, t: Any, points: Any, cells: Any, h: float) -> str:
    """Vertices, radius ratios, angles, edges of that length, distances both ways by samples."""
    x = points[cells]
    a, b, c = (np.linalg.norm(x[:, i] - x[:, j], axis=1) for i, j in ((1, 2), (0, 2), (0, 1)))
    q = (b + c - a) * (c + a - b) * (a + b - c) / (a * b * c)
    angles = np.degrees([np.arccos(np.clip((v * v + w * w - u * u) / (2 * v * w), -1, 1))
                         for u, v, w in ((a, b, c), (b, a, c), (c, a, b))])
    ratio = _edges(points, cells) / h
    diagonal = np.linalg.norm(np.ptp(p, axis=0))
    far = "/".join(f"{1e3 * d / diagonal:.2f}" for d in _distances(p, t, points, cells))
    return (f"{len(np.unique(cells))} | {q.min():.3f} {np.quantile(q, 0.01):.3f} {q.mean():.3f} | "
            f"{angles.min():.1f}..{angles.max():.1f} | {(angles.min(axis=0) < 30).sum()} | "
            f"{((ratio > 0.5**0.5) & (ratio < 2**0.5)).mean():.3f} | {far}")


def _distances(p: Any, t: Any, points: Any, cells: Any) -> Iterator[float]:
    import igl

    for (x, rows), other in (((points, cells), (p, t)), ((p, t), (points, cells))):
        corners = x[rows]
        area = np.linalg.norm(np.cross(*(corners[:, i] - corners[:, 0] for i in (1, 2))), axis=1)
        rng = np.random.default_rng(0)
        chosen = rng.choice(len(rows), SAMPLES, p=area / area.sum())
        inner = np.einsum("ij,ijk->ik", rng.dirichlet(np.ones(3), SAMPLES), corners[chosen])
        middles = ((corners + np.roll(corners, 1, axis=1)) / 2).reshape(-1, 3)
        samples = np.concatenate([inner, middles, x[np.unique(rows)]])
        yield igl.point_mesh_squared_distance(samples, *other)[0].max() ** 0.5
