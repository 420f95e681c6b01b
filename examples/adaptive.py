"""Adaptive finite elements: solve, estimate, remesh to the sizes that the error asks for, repeat.

python examples/adaptive.py [plane | space | both] [--cells 20000] [--picture adaptive.png]

The Laplace problem on an L-shaped domain, and on the prism over it, with the solution
r^(2/3) sin(2 theta / 3) given on the boundary, whose gradient is infinite at the reentrant corner
or edge. `odt_plugins.remesh` makes every mesh of the one before and carries the solution, from
which conjugate gradients start. Beside it stand halved meshes, and mmg in the same loop where mmgpy
is installed. Prints unknowns, error in the energy norm and steps of conjugate gradients, and the
rate between first and last mesh.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import meshio
import numpy as np
import skfem
from scipy.sparse import diags
from scipy.sparse.linalg import cg
from skfem.helpers import dot, grad

import odt_plugins

REGULAR = {2: math.sqrt(3) / 4, 3: math.sqrt(2) / 12}
"""Volume of the regular simplex of edge 1."""

FINER, COARSER = 3.0, 1.5
"""How much smaller or larger sizes become in one step, at most."""

MORE = {2: 2.0, 3: 2.5}
"""How many times as many cells the next mesh shall have."""

Mesh = tuple[np.ndarray, np.ndarray]


class Solved(NamedTuple):
    """A mesh with the solution on it, the error, and steps of conjugate gradients."""

    mesh: Mesh
    values: np.ndarray
    unknowns: int
    error: float
    steps: int


def start(d: int) -> Mesh:
    """The square from -1 to 1 without a quarter, or the prism over it from 0 to 1."""
    axis = np.linspace(-1.0, 1.0, 9 if d == 2 else 5)
    make = skfem.MeshTri.init_tensor if d == 2 else skfem.MeshTet.init_tensor
    grid = make(*[axis, axis, np.linspace(0.0, 1.0, 3)][:d])
    middle = grid.p[:, grid.t].mean(axis=1)
    grid = grid.remove_elements(np.flatnonzero((middle[0] > 0.0) & (middle[1] < 0.0)))
    return grid.p.T.copy(), grid.t.T.copy()


def polar(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance from the reentrant edge and angle, from 0 to 270 degrees."""
    angle = np.arctan2(x[1], x[0])
    return np.hypot(x[0], x[1]), np.where(angle < -np.pi / 4, angle + 2 * np.pi, angle)


def exact(x: np.ndarray) -> np.ndarray:
    """The solution at places (d, ...)."""
    r, angle = polar(x)
    return np.asarray(np.cbrt(r) ** 2 * np.sin(angle * 2 / 3))


def slope(x: np.ndarray) -> np.ndarray:
    """Its gradient (d, ...)."""
    r, angle = polar(x)
    size = 2 / 3 / np.cbrt(np.maximum(r, 1e-30))
    return np.stack([-size * np.sin(angle / 3), size * np.cos(angle / 3), *0.0 * x[2:]])


def solve(mesh: Mesh, guess: np.ndarray | None = None) -> Solved:
    """Linear elements on a mesh; conjugate gradients start from a guess."""
    points, cells = mesh
    flat = points.shape[1] == 2
    grid = (skfem.MeshTri if flat else skfem.MeshTet)(
        np.ascontiguousarray(points.T), np.ascontiguousarray(cells.T))
    basis = skfem.Basis(grid, skfem.ElementTriP1() if flat else skfem.ElementTetP1(), intorder=6)
    matrix = skfem.BilinearForm(lambda u, v, w: dot(grad(u), grad(v))).assemble(basis).tocsr()
    rim = grid.boundary_nodes()
    inner = np.setdiff1d(np.arange(len(points)), rim)
    values = np.zeros(len(points)) if guess is None else guess.copy()
    values[rim] = exact(points[rim].T)
    steps = 0

    def count(_: np.ndarray) -> None:
        nonlocal steps
        steps += 1

    part = matrix[inner][:, inner]
    right = -matrix[inner][:, rim] @ values[rim]
    scale = 1e-8 * float(np.linalg.norm(right))
    values[inner] = cg(part, right, x0=values[inner], rtol=0.0, atol=scale, callback=count,
                       M=diags(1.0 / part.diagonal()))[0]
    gap = skfem.Functional(lambda w: sum((w["u"].grad - slope(w.x)) ** 2))
    error = math.sqrt(gap.assemble(basis, u=basis.interpolate(values)))
    return Solved(mesh, values, len(inner), error, steps)


def volume(mesh: Mesh) -> np.ndarray:
    """Volume of every cell."""
    points, cells = mesh
    edges = points[cells[:, 1:]] - points[cells[:, :1]]
    return np.abs(np.linalg.det(edges)) / math.factorial(points.shape[1])


def estimate(solved: Solved) -> np.ndarray:
    """Square of the residual estimator of every cell: h times the squared jumps of the gradient."""
    points, cells = solved.mesh
    d = points.shape[1]
    edges = points[cells[:, 1:]] - points[cells[:, :1]]
    rise = solved.values[cells[:, 1:]] - solved.values[cells[:, :1]]
    gradient = np.linalg.solve(edges, rise[..., None])[..., 0]
    facets = np.sort(np.concatenate([np.delete(cells, i, axis=1) for i in range(d + 1)]), axis=1)
    owner = np.tile(np.arange(len(cells)), d + 1)
    order = np.lexsort(facets.T)
    twin = np.flatnonzero((facets[order][1:] == facets[order][:-1]).all(axis=1))
    one, other = owner[order[twin]], owner[order[twin + 1]]
    sides = np.diff(points[facets[order[twin]]], axis=1)
    area = np.sqrt(np.abs(np.linalg.det(sides @ sides.swapaxes(1, 2)))) / (d - 1)
    jump = area ** (d / (d - 1)) * ((gradient[one] - gradient[other]) ** 2).sum(axis=1)
    return np.asarray(np.bincount(one, jump, len(cells)) + np.bincount(other, jump, len(cells))) / 2


def wanted(solved: Solved, count: float) -> np.ndarray:
    """Edge length at every vertex that makes the error least with so many cells.

    Where the squared error of a cell is e h^2 times its volume, the sum over a mesh of sizes h is
    least, for a given number of cells, where h^(d + 2) is in proportion to 1 / e.
    """
    points, cells = solved.mesh
    d, size = points.shape[1], volume(solved.mesh)
    old = (size / REGULAR[d]) ** (1 / d)
    dense = estimate(solved) / (old**2 * size)
    h = np.maximum(dense, 1e-12 * dense.max()) ** (-1 / (d + 2))
    h *= ((size / h**d).sum() / (REGULAR[d] * count)) ** (1 / d)
    h = np.clip(h, old / FINER, old * COARSER)
    corner = np.repeat(h, d + 1)
    return np.asarray(np.bincount(cells.ravel(), corner) / np.bincount(cells.ravel()))


def by_remesh(solved: Solved, size: np.ndarray) -> tuple[Mesh, np.ndarray | None]:
    """The next mesh by this package, and the solution on it."""
    points, cells = solved.mesh
    kind = "triangle" if points.shape[1] == 2 else "tetra"
    mesh = meshio.Mesh(points, [(kind, cells)], point_data={"u": solved.values})
    out = odt_plugins.remesh(mesh, size=size, fields="conserve")
    return (out.points, out.cells[0].data), out.point_data["u"]


def by_mmg(solved: Solved, size: np.ndarray) -> tuple[Mesh, np.ndarray | None]:
    """The next mesh by mmg2d or mmg3d, which carry no solution."""
    import mmgpy

    points, cells = solved.mesh
    flat = points.shape[1] == 2
    mesh = (mmgpy.MmgMesh2D if flat else mmgpy.MmgMesh3D)(points, cells.astype(np.int32))
    mesh.set_field("metric", size[:, None])
    mesh.remesh(verbose=-1)
    new = mesh.get_triangles() if flat else mesh.get_tetrahedra()
    return (mesh.get_vertices(), new.astype(np.int64)), None


def by_halves(solved: Solved, _: np.ndarray) -> tuple[Mesh, np.ndarray | None]:
    """The same mesh with all edges halved."""
    points, cells = solved.mesh
    make = skfem.MeshTri if points.shape[1] == 2 else skfem.MeshTet
    grid = make(np.ascontiguousarray(points.T), np.ascontiguousarray(cells.T)).refined(1)
    return (grid.p.T.copy(), grid.t.T.copy()), None


WAYS: dict[str, Callable[[Solved, np.ndarray], tuple[Mesh, np.ndarray | None]]] = {
    "remesh": by_remesh, "mmg": by_mmg, "halved": by_halves}
"""How the next mesh is made."""


def adapt(d: int, way: str, cells: int) -> list[Solved]:
    """Solve on meshes of more and more cells, up to about so many."""
    done = [solve(start(d))]
    while (count := MORE[d] * len(done[-1].mesh[1])) <= cells:
        if way == "halved":
            count = 2**d * len(done[-1].mesh[1])
            if count > 1.5 * cells:
                break
        done.append(solve(*WAYS[way](done[-1], wanted(done[-1], count))))
    return done


def rate(done: Sequence[Solved], last: int = 4) -> float:
    """Exponent r of the error, N^-r for N unknowns, over the last meshes, by least squares."""
    x, y = np.log([[s.unknowns, s.error] for s in done[-last:]]).T
    return float(-((x - x.mean()) * (y - y.mean())).sum() / ((x - x.mean()) ** 2).sum())


def draw(found: dict[int, dict[str, list[Solved]]], path: Path) -> None:
    """The last meshes seen from above, and all errors over the unknowns."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.2 * len(found) * 2, 4.0), layout="constrained")
    axes = figure.subplots(1, 2 * len(found), squeeze=False)[0]
    for i, (d, ways) in enumerate(found.items()):
        points, cells = ways["remesh"][-1].mesh
        if d == 3:
            facets = np.concatenate([np.delete(cells, j, axis=1) for j in range(4)])
            cells = facets[(points[facets][:, :, 2] > 1.0 - 1e-9).all(axis=1)]
        axes[2 * i].triplot(points[:, 0], points[:, 1], cells, linewidth=0.3, color="0.25")
        axes[2 * i].set(aspect="equal", title="plane" if d == 2 else "space, from above")
        axes[2 * i].axis("off")
        plot = axes[2 * i + 1]
        for (way, done), style in zip(ways.items(), ("o-", "s--", "^:"), strict=False):
            plot.loglog([s.unknowns for s in done], [s.error for s in done], style, label=way)
        last = ways["remesh"][-1]
        x = np.array([last.unknowns / 30, last.unknowns])
        plot.loglog(x, 0.8 * last.error * (x / x[1]) ** (-1 / d), color="0.6", label=f"N^(-1/{d})")
        plot.set(xlabel="unknowns", ylabel="error in the energy norm")
        plot.legend()
    figure.savefig(path, dpi=70)


def main(argv: Iterable[str] | None = None) -> dict[int, dict[str, list[Solved]]]:
    """Run both dimensions, or those that are named; print the table and draw the picture."""
    parser = argparse.ArgumentParser(description="Adaptive finite elements.")
    parser.add_argument("where", nargs="?", choices=["plane", "space", "both"], default="both")
    parser.add_argument("--cells", type=int, default=20_000)
    parser.add_argument("--picture", type=Path)
    given = parser.parse_args(None if argv is None else list(argv))
    ways = [way for way in WAYS if way != "mmg" or find_spec("mmgpy")]
    if "mmg" not in ways:
        print("mmgpy is not installed: no rows of mmg")
    found: dict[int, dict[str, list[Solved]]] = {}
    print("| domain | way | unknowns | error | rate | CG steps |")
    print("|---|---|---|---|---|---|")
    for name in ("plane", "space") if given.where == "both" else (given.where,):
        d = 2 if name == "plane" else 3
        found[d] = {way: adapt(d, way, given.cells) for way in ways}
        for way, done in found[d].items():
            last = done[-1]
            print(f"| {name} | {way} | {last.unknowns} | {last.error:.4f} | {rate(done):.3f} | "
                  f"{last.steps} |")
    if given.picture:
        draw(found, given.picture)
    return found


if __name__ == "__main__":
    main()
