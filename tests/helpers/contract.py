"""What every adapter must keep, for every kind of caller's object, checked by plain slow code."""

from __future__ import annotations

import functools
import itertools
import tempfile
import weakref
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
import quadratic_meshes
import surface_meshes

import odt_plugins
from odt_plugins.adapters import files
from odt_plugins.engine.run.outcome import Outcome
from odt_plugins.figures import radius_ratio

THIRD = 1.0 / 3.0


@dataclass
class View:
    """Arrays and data of any object, read by the host's own means.

    Attributes
    ----------
    points, cells, point_data, cell_data, field_data    of quadratic cells those of the corners
    normals    by name, of vertices or cells, in whatever number
    wedges     (m, 3, 2) texture coordinates, which depend on vertex and region alone
    mid        place of the mid-node of every edge of quadratic cells
    """

    points: np.ndarray
    cells: np.ndarray
    point_data: dict[str, np.ndarray]
    cell_data: dict[str, np.ndarray]
    field_data: dict[str, np.ndarray]
    normals: dict[str, np.ndarray] = field(default_factory=dict)
    wedges: np.ndarray | None = None
    mid: dict[tuple[int, int], np.ndarray] = field(default_factory=dict)


def itself(mesh):
    """What most hosts make is taken as it is."""
    return mesh


@dataclass
class Host:
    """One kind of caller's object.

    Attributes
    ----------
    make      makes one with data of every kind; of given points, cells and labels, or of `grid`
    view      reads one by the host's own means
    dim       2 or 3
    region    name of the cell array whose interfaces stay
    word      what the host calls its cells
    optimize  what a caller of this host does
    fields    whether vertices that moved take the values of fields at their new places
    mesh      gives what `measure` takes
    """

    make: Callable[..., Any]
    view: Callable[[Any], View]
    dim: int
    region: str | None
    word: str = "cells"
    optimize: Callable[..., Any] = odt_plugins.optimize
    fields: bool = False
    mesh: Callable[[Any], Any] = itself


def need(name: str) -> None:
    """Skip a test where the toolkit of a host is missing."""
    toolkit = name.partition("-")[0]
    if toolkit in (
            "pyvista", "pymeshlab", "open3d", "vtk", "gmsh", "trimesh", "skfem",
            "netgen", "ngsolve"):
        pytest.importorskip(toolkit)


def volumes(points, cells):
    """Signed volumes times d!, by numpy's own determinant."""
    x = np.asarray(points, dtype=np.float64)[np.asarray(cells, dtype=np.int64)]
    if x.shape[1] == 3 and x.shape[2] == 3:
        x = x[:, :, :2]
    return np.linalg.det(x[:, 1:] - x[:, :1])


def grid(dim, n, seed=0):
    """Jittered grid of n^dim cubes in [0, 1]^dim cut up by Kuhn: points, cells, labels.

    The plane x = 1/2 is kept and is the interface of the labels 7 and -2. All cells positive.
    """
    return tuple(a.copy() for a in _grid(dim, n, seed))


@functools.cache
def _grid(dim, n, seed):
    axis = np.arange(n + 1)
    lattice = np.stack(np.meshgrid(*[axis] * dim, indexing="ij"), -1).reshape(-1, dim)
    index = {tuple(p): i for i, p in enumerate(lattice.tolist())}
    cells = []
    for corner in itertools.product(range(n), repeat=dim):
        for order in itertools.permutations(range(dim)):
            path = [list(corner)]
            for direction in order:
                path.append([c + (i == direction) for i, c in enumerate(path[-1])])
            cells.append([index[tuple(p)] for p in path])
    points = lattice / n
    inner = ((lattice > 0) & (lattice < n)).all(axis=1) & (2 * lattice[:, 0] != n)
    jitter = np.random.default_rng(seed).uniform(-0.25, 0.25, points.shape) / n
    points[inner] += jitter[inner]
    cells = np.array(cells)
    turned = volumes(points, cells) < 0
    cells[turned, -2:] = cells[turned, :-3:-1]
    labels = np.where(points[cells][:, :, 0].mean(axis=1) < 0.5, 7, -2)
    return points, cells, labels


def negative(cells):
    """The same cells, each turned by exchanging its first two vertices."""
    return cells[:, [1, 0, *range(2, cells.shape[1])]]


def facets(cells, labels):
    """Vertex sets of boundary and interface facets, by counting."""
    owners: dict[tuple[int, ...], list[int]] = {}
    rows = np.asarray(cells, dtype=np.int64).tolist()
    for label, cell in zip(labels.tolist(), rows, strict=True):
        for facet in itertools.combinations(sorted(cell), len(cell) - 1):
            owners.setdefault(facet, []).append(label)
    return {f for f, have in owners.items() if len(have) == 1 or have[0] != have[-1]}


def neighbours(cells):
    """Pairs of cells with a facet in common, in order."""
    owners: dict[tuple[int, ...], list[int]] = {}
    for i, cell in enumerate(np.asarray(cells).tolist()):
        for facet in itertools.combinations(sorted(cell), len(cell) - 1):
            owners.setdefault(facet, []).append(i)
    return sorted({p for have in owners.values() for p in itertools.combinations(have, 2)})


def churn(mesh, options, leaving=None):
    """Stand-in for the engine: moves vertices, flips facets, turns rows round, shuffles cells.

    Every change is allowed by the rules that the engine has to follow, so that the tests see
    whether the way in and the way out keep what they must.
    """
    d = mesh.dim
    cells, regions = mesh.cells.tolist(), mesh.regions.tolist()
    held = mesh.fixed.copy()
    for facet in facets(mesh.cells, mesh.regions):
        held[list(facet)] = True
    held[mesh.cells[mesh.frozen].ravel()] = True
    points = mesh.points.copy()
    step = np.random.default_rng(5).uniform(-1.0, 1.0, points.shape)
    size = (points.max(axis=0) - points.min(axis=0)).max()
    points[~held] += 1e-3 * size * step[~held]

    frozen = mesh.frozen.tolist()
    touched: set[int] = set()
    flips = 0
    for i, j in neighbours(mesh.cells):
        shared = set(cells[i]) & set(cells[j])
        if len(shared) != d or {i, j} & touched or regions[i] != regions[j]:
            continue
        if frozen[i] or frozen[j] or flips == 6:
            continue
        (a,), (b,) = set(cells[i]) - shared, set(cells[j]) - shared
        new = [[a, b, *pair] for pair in itertools.combinations(sorted(shared), d - 1)]
        new = [c if volumes(points, [c])[0] > 0 else [*c[:-2], c[-1], c[-2]] for c in new]
        size_new, size_old = volumes(points, new), volumes(points, [cells[i], cells[j]])
        if (size_new > 0.05 * size_old.min()).all() and np.isclose(size_new.sum(), size_old.sum()):
            cells[i], cells[j] = new[0], new[1]
            cells += new[2:]
            regions += [regions[i]] * len(new[2:])
            touched |= {i, j}
            frozen += [False] * len(new[2:])
            flips += 1
    assert flips
    cells = [c[1:] + c[:1] if d == 2 else [c[1], c[2], c[0], c[3]] for c in cells][::-1]
    return Outcome(points, np.array(cells, dtype=np.int32),
                   np.array(regions[::-1], dtype=np.int32), stop_reason="churned")


def check(host: Host, before: View, after: View) -> None:
    """The contract between an input and its output."""
    assert after.points.dtype == before.points.dtype
    assert after.cells.dtype == before.cells.dtype
    assert after.points.shape == before.points.shape
    sign = np.sign(volumes(before.points, before.cells)[0])
    assert (np.sign(volumes(after.points, after.cells)) == sign).all()

    old = before.cell_data[host.region] if host.region else np.zeros(len(before.cells), int)
    new = after.cell_data[host.region] if host.region else np.zeros(len(after.cells), int)
    stay = facets(before.cells, old)
    assert facets(after.cells, new) == stay
    on_them = np.unique([list(f) for f in stay])
    assert after.points[on_them].tobytes() == before.points[on_them].tobytes()
    for label in np.unique(old):
        whole = volumes(before.points, before.cells)[old == label].sum()
        tolerance = 1e-12 if before.points.dtype.itemsize == 8 else 1e-6
        assert volumes(after.points, after.cells)[new == label].sum() == pytest.approx(
            whole, rel=tolerance)
    assert set(np.unique(new)) == set(np.unique(old))

    check_data(before, after, old, new, fields=host.fields)
    check_wedges(before, after, old, new)
    check_normals(before, after)
    check_mid_nodes(before, after)
    # Cells that are still there keep their rows and their order; those of the same vertices that
    # were turned over have another.
    rows = {tuple(sorted(c)): i for i, c in enumerate(before.cells.tolist())}
    kept = [(rows[tuple(sorted(c))], i) for i, c in enumerate(after.cells.tolist())
            if tuple(sorted(c)) in rows]
    assert kept == sorted(kept)
    for i, j in kept:
        same = np.array_equal(before.cells[i], after.cells[j])
        turned = np.sign(volumes(after.points, before.cells[[i]])[0]) != sign
        assert same != turned


def check_data(before, after, old, new, interpolated=(), *, fields=False):
    """Point and field data are the same, cell data those of the sources; all of the same dtype.

    With fields, floating-point numbers, and texture coordinates ("uv"), are interpolated linearly
    at vertices that moved.
    """
    moved = (before.points != after.points).any(axis=1) & fields
    place = after.points[moved].astype(np.float64)
    corners, weights = surroundings(before.points.astype(np.float64), before.cells, place)
    for kind in ("point_data", "field_data"):
        a, b = getattr(before, kind), getattr(after, kind)
        assert sorted(a) == sorted(b)
        for name in a:
            assert np.asarray(b[name]).dtype == np.asarray(a[name]).dtype, name
            of_points = kind == "point_data" or name == "uv"
            if of_points and a[name].dtype.kind == "f" and fields:
                assert a[name][~moved].tobytes() == b[name][~moved].tobytes(), name
                there = np.einsum("kc,kc...->k...", weights, a[name][corners].astype(np.float64))
                tolerance = 1e-11 if a[name].dtype.itemsize == 8 else 1e-5
                assert b[name][moved] == pytest.approx(there, rel=tolerance, abs=tolerance), name
            elif name not in interpolated:
                assert np.array_equal(a[name], b[name]), name
    assert sorted(before.cell_data) == sorted(after.cell_data)
    source = sources(before, after, old, new)
    for name, values in before.cell_data.items():
        assert after.cell_data[name].dtype == values.dtype, name
        assert np.array_equal(after.cell_data[name], values[source]), name


def surroundings(points, cells, x):
    """Corners and barycentric coordinates of the cell in which every point lies, of all cells."""
    d = cells.shape[1] - 1
    rows = np.concatenate([points[cells][:, :, :d], np.ones((*cells.shape, 1))], axis=2)
    x = np.concatenate([x[:, :d], np.ones((len(x), 1))], axis=1)
    found = np.einsum("kd,mdc->kmc", x, np.linalg.inv(rows))
    best = found.min(axis=2).argmax(axis=1) if len(x) else np.zeros(0, dtype=int)
    return cells[best], found[np.arange(len(x)), best]


def check_wedges(before, after, old, new):
    """Every vertex has the texture coordinates that it had in that region."""
    assert (before.wedges is None) == (after.wedges is None)
    if before.wedges is None:
        return
    place = {(label, v): uv for label, cell, wedges in zip(
        old.tolist(), before.cells.tolist(), before.wedges, strict=True)
        for v, uv in zip(cell, wedges, strict=True)}
    expected = [[place[label, v] for v in cell]
                for label, cell in zip(new.tolist(), after.cells.tolist(), strict=True)]
    assert after.wedges.dtype == before.wedges.dtype
    assert np.array_equal(after.wedges, np.array(expected))


def check_normals(before, after):
    """Normals that were there are those of the result, whatever they were before."""
    assert sorted(before.normals) == sorted(after.normals)
    for name, values in after.normals.items():
        x = after.points[after.cells[0]].astype(np.float64)
        normal = np.cross(x[1] - x[0], x[2] - x[0])
        count = {len(before.points): len(after.points), len(before.cells): len(after.cells)}
        assert len(values) == count[len(before.normals[name])], name
        assert values.dtype == before.normals[name].dtype, name
        assert values == pytest.approx(np.tile(normal / np.linalg.norm(normal),
                                               (len(values), 1)), abs=1e-6), name


def check_mid_nodes(before, after):
    """Every edge has a mid-node, as far off its middle as before; on a new edge there."""
    assert bool(before.mid) == bool(after.mid)
    if not after.mid:
        return
    pairs = {pair for c in after.cells.tolist() for pair in itertools.combinations(sorted(c), 2)}
    assert set(after.mid) == pairs
    for edge, place in after.mid.items():
        new, old = after.points[list(edge)], before.points[list(edge)]
        off = before.mid[edge] - old.mean(axis=0) if edge in before.mid else 0.0
        assert place - new.mean(axis=0) == pytest.approx(np.broadcast_to(off, place.shape),
                                                         abs=1e-14), edge
        if edge in before.mid and new.tobytes() == old.tobytes():
            assert place.tobytes() == before.mid[edge].tobytes(), edge


def sources(before, after, old, new):
    """Same vertices, else the nearest barycentre of the same region: all pairs."""
    rows = {tuple(sorted(c)): i for i, c in enumerate(before.cells.tolist())}
    x = before.points.astype(np.float64)[before.cells].mean(axis=1)
    out = []
    for cell, label in zip(after.cells, new, strict=True):
        same = rows.get(tuple(sorted(cell.tolist())))
        if same is None:
            y = after.points[cell].astype(np.float64).mean(axis=0)
            distance = np.where(old == label, ((x - y) ** 2).sum(axis=1), np.inf)
            same = int(np.argmin(distance))
        out.append(same)
    return np.array(out)


def same_bits(a: Any, b: Any) -> bool:
    """Compare two views byte for byte."""
    pairs = [(a.points, b.points), (a.cells, b.cells), (a.wedges, b.wedges)]
    for kind in ("point_data", "cell_data", "field_data", "normals", "mid"):
        left, right = getattr(a, kind), getattr(b, kind)
        if sorted(left) != sorted(right):
            return False
        pairs += [(left[name], right[name]) for name in left]
    return all(np.asarray(p).dtype == np.asarray(q).dtype
               and np.asarray(p).tobytes() == np.asarray(q).tobytes() for p, q in pairs)


def in_space(points, height=0.0):
    """Points with three coordinates: those of a plane at a height, or as they are."""
    rest = np.full((len(points), 3 - points.shape[1]), height)
    return np.column_stack([points, rest])


def data(points, cells, labels):
    """Point and cell data whose values have no finite decimal form."""
    n, m = len(points), len(cells)
    point = {"temperature": np.arange(n) * THIRD,
             "velocity": np.arange(3 * n, dtype=np.float32).reshape(n, 3) / 7}
    cell = {"stress": (np.arange(m) / 7).astype(np.float32),
            "origin": np.arange(m, dtype=np.int64),
            "axis": np.arange(3 * m).reshape(m, 3) * THIRD,
            "marker": labels.astype(np.int32)}
    return point, cell


def _arrays(dim, turn, dtype, index, container, regions, space=False):
    def make(mesh=None):
        points, cells, labels = mesh or grid(dim, 4)
        cells = negative(cells) if turn else cells
        if space:
            points = in_space(points, THIRD)
        parts = [points.astype(dtype), cells.astype(index)]
        if regions:
            parts.append(labels)
        return container(parts)

    def view(mesh):
        cell_data = {"marker": mesh[2]} if len(mesh) == 3 else {}
        return View(mesh[0], mesh[1], {}, cell_data, {})

    return Host(make, view, dim, "marker" if regions else None)


class Foreign:
    """An array of another library, which numpy knows through `__dlpack__` alone."""

    device = "cpu"

    def __init__(self, values):
        self.values = values

    def __dlpack__(self, **options):
        return self.values.__dlpack__(**options)

    def __dlpack_device__(self):
        return self.values.__dlpack_device__()

    def __array_namespace__(self):
        return Foreign

    @staticmethod
    def asarray(values, device):
        assert device == "cpu"
        return Foreign(np.array(values))


def _foreign(dim, index):
    """Arrays of another library, with labels."""
    own = _arrays(dim, False, np.float32, index, tuple, True)

    def make(mesh=None):
        return tuple(map(Foreign, own.make(mesh)))

    def view(mesh):
        assert {type(part) for part in mesh} == {Foreign}
        return own.view([part.values for part in mesh])

    return Host(make, view, dim, "marker")


def _trimesh(textured):
    """Attributes of every kind, with colours of faces, or a texture and materials of faces."""

    def make(mesh=None):
        import trimesh

        points, cells, labels = mesh or grid(2, 4)
        point, cell = data(points, cells, labels)
        space = in_space(points, THIRD)
        mesh = trimesh.Trimesh(space, cells, process=False, vertex_attributes=point,
                               face_attributes=cell, metadata={"recipe": "steel"})
        if textured:
            mesh.visual = trimesh.visual.TextureVisuals(
                uv=points[:, :2] / 7, material=trimesh.visual.material.PBRMaterial(name="rust"),
                face_materials=(labels == 7).astype(np.int64))
        elif len(cells):
            mesh.visual.face_colors = np.random.default_rng(3).integers(
                0, 256, (len(cells), 4), dtype=np.uint8)
        return mesh

    def view(mesh):
        point, cell = _copy_data(mesh.vertex_attributes), _copy_data(mesh.face_attributes)
        field = {"recipe": np.array(mesh.metadata["recipe"])}
        if textured:
            cell["material"] = np.array(mesh.visual.face_materials)
            field |= {"uv": np.array(mesh.visual.uv),
                      "material": np.array(mesh.visual.material.name)}
        else:
            cell["colour"] = np.array(mesh.visual.face_colors)
            field["kind"] = np.array(mesh.visual.kind)
        normals = {"vertex": np.array(mesh.vertex_normals), "face": np.array(mesh.face_normals)}
        return View(np.array(mesh.vertices), np.array(mesh.faces), point, cell, field, normals)

    return Host(make, view, 2, "marker", "faces", fields=True)


def _skfem(dim):
    """Two subdomains, and a boundary whose facets are told by their vertices."""

    def make(mesh=None):
        import skfem

        points, cells, labels = mesh or grid(dim, 4)
        kind = skfem.MeshTri1 if dim == 2 else skfem.MeshTet1
        out = kind(points.T.copy(), cells.T.astype(np.int32), validate=False, sort_t=False)
        if not len(cells):
            return out
        out = out.with_subdomains({"steel": np.flatnonzero(labels == 7),
                                   "air": np.flatnonzero(labels == -2)})
        differ = labels[out.f2t[0]] != labels[out.f2t[1]]
        inner = np.flatnonzero(differ & (out.f2t[1] >= 0))
        skin = np.flatnonzero(out.f2t[1] < 0)
        from skfem.generic_utils import OrientedBoundary

        sides = np.where(labels[out.f2t[0, inner]] == 7, 0, 1)
        return out.with_boundaries({"skin": skin[::2], "wall": OrientedBoundary(inner, sides)})

    def view(mesh):
        label = np.zeros(mesh.t.shape[1], dtype=np.int64)
        for number, cells in enumerate((mesh.subdomains or {}).values()):
            label[cells] += number + 1
        field = {}
        for name, facets in (mesh.boundaries or {}).items():
            corners = np.sort(mesh.doflocs[:, mesh.facets[:, np.asarray(facets)]], axis=1)
            corners = corners.reshape(dim * dim, corners.shape[2])
            field[name] = corners[:, np.lexsort(corners)]
        if "wall" in field:
            # All are told from the side of the steel.
            wall = mesh.boundaries["wall"]
            field["sides"] = np.unique(label[mesh.f2t[wall.ori, np.asarray(wall)]])
        return View(mesh.doflocs.T.copy(), mesh.t.T.copy(), {}, {"label": label}, field)

    return Host(make, view, dim, "label", "elements")


def _netgen(dim, wrap=False):
    """Two materials and named faces or edges; of triangles in the plane, in space as a surface."""

    def make(mesh=None):
        from netgen.meshing import Element1D, FaceDescriptor, Mesh

        points, cells, labels = mesh or grid(dim, 4)
        solid = cells.shape[1] == 4
        out = Mesh(points.shape[1])
        out.AddPoints(np.ascontiguousarray(points))
        kinds = [label for label in (7, -2) if (labels == label).any()]
        walls: dict[tuple[int, ...], list[int]] = {}
        for label, cell in zip(labels.tolist(), cells.tolist(), strict=True):
            for facet in itertools.combinations(cell, cells.shape[1] - 1):
                walls.setdefault(tuple(sorted(facet)), []).append(label)
        walls = {f: have for f, have in walls.items() if len(have) == 1 or have[0] != have[1]}
        for k in (1, 2):
            out.Add(FaceDescriptor(surfnr=k, domin=1, domout=0 if k == 1 else 2, bc=k))
        for k, label in enumerate((7, -2), 1):
            rows = cells[labels == label].astype(np.int32)
            if len(rows):
                out.AddElements(dim=3 if solid else 2, index=k, data=np.ascontiguousarray(rows),
                                base=0)
            out.SetMaterial(k, f"material {k}")
        for k, part in enumerate(([f for f, have in walls.items() if len(have) == 1],
                                  [f for f, have in walls.items() if len(have) == 2]), 1):
            if part and solid:
                out.AddElements(dim=2, index=k, data=np.array(part, dtype=np.int32), base=0)
            for a, b in part if not solid else ():
                out.Add(Element1D([a + 1, b + 1], index=k))
            out.SetBCName(k - 1, f"wall {k}")
        assert kinds or not len(cells)
        if wrap:
            import ngsolve

            return ngsolve.Mesh(out)
        return out

    def view(mesh):
        inner = mesh.ngmesh if wrap else mesh
        solid = len(inner.Elements3D()) > 0
        table = (inner.Elements3D() if solid else inner.Elements2D()).NumPy()
        own = np.array(inner.Coordinates())
        field = {"names": np.array([inner.GetBCName(i) for i in range(2)]
                                   + [inner.GetMaterial(i) for i in (1, 2)])}
        lower = (inner.Elements2D() if solid else inner.Elements1D()).NumPy()
        corners = lower["nodes"][:, :3 if solid else 2] - 1
        # Numbers of points may be others where some came and went.
        field |= {"walls": own[corners], "of walls": np.array(lower["index"])}
        return View(own, np.array(table["nodes"], dtype=np.int64) - 1, {},
                    {"index": np.array(table["index"])}, field)

    return Host(make, view, dim, "index", "elements")


def _copy_data(data):
    return {name: np.array(data[name]) for name in data.keys()}


def _pyvista(dim, kind, dtype):
    def make(mesh=None):
        import pyvista

        points, cells, labels = mesh or grid(dim, 4)
        space = in_space(points).astype(dtype)
        if kind == "grid":
            mesh = pyvista.UnstructuredGrid({5 if dim == 2 else 10: cells}, space)
        else:
            mesh = pyvista.PolyData.from_regular_faces(space, cells)
        point, cell = data(points, cells, labels)
        mesh.point_data.update(point)
        if not len(cells):
            return mesh
        for name, values in cell.items():
            mesh.cell_data[name] = values
        mesh.cell_data["inside"] = np.arange(len(cells)) % 3 == 0
        mesh.cell_data["name"] = np.array([f"c{i}" for i in range(len(cells))])
        mesh.field_data["recipe"] = np.arange(4) * THIRD
        mesh.set_active_scalars("stress", preference="cell")
        mesh.cell_data.active_vectors_name = "axis"
        mesh.point_data.active_vectors_name = "velocity"
        return mesh

    def view(mesh):
        cells = mesh.cells_dict[5 if dim == 2 else 10] if kind == "grid" else mesh.regular_faces
        return View(np.array(mesh.points), np.array(cells), _copy_data(mesh.point_data),
                    _copy_data(mesh.cell_data), _copy_data(mesh.field_data))

    return Host(make, view, dim, "marker", fields=True)


def _vtk(dim, kind, dtype):
    """The same as of pyvista, as an object of VTK alone, with bits and words and a table."""
    own = _pyvista(dim, kind, dtype)

    def make(mesh=None):
        from vtkmodules.vtkCommonCore import vtkBitArray, vtkLookupTable
        from vtkmodules.vtkCommonDataModel import vtkPolyData, vtkUnstructuredGrid

        out = vtkUnstructuredGrid() if kind == "grid" else vtkPolyData()
        out.DeepCopy(own.make(mesh))
        bits = vtkBitArray()
        bits.SetName("bits")
        for i in range(out.GetNumberOfCells()):
            bits.InsertNextValue(i % 2)
        if out.GetNumberOfCells():
            out.GetCellData().AddArray(bits)
            axis = out.GetCellData().GetArray("axis")
            axis.SetComponentName(1, "northing")
            axis.SetLookupTable(vtkLookupTable())
        return out

    def view(mesh):
        import pyvista

        found = own.view(pyvista.wrap(mesh))
        for where in (mesh.GetPointData(), mesh.GetCellData()):
            for i in range(where.NUM_ATTRIBUTES):
                array = where.GetAbstractAttribute(i)
                found.field_data[f"{where.GetClassName()} {i}"] = np.array(
                    "" if array is None else f"{array.GetName()} {array.GetClassName()}")
        axis = mesh.GetCellData().GetArray("axis")
        found.field_data["northing"] = np.array(
            axis is not None and (axis.GetComponentName(1), axis.GetLookupTable() is not None))
        return found

    return Host(make, view, dim, "marker", fields=True)


def meshio_view(kind):
    def view(mesh):
        chosen = [i for i, block in enumerate(mesh.cells) if block.type == kind]
        cells = np.concatenate([mesh.cells[i].data for i in chosen])
        cell = {name: np.concatenate([values[i] for i in chosen])
                for name, values in mesh.cell_data.items()}
        return View(np.array(mesh.points), cells, _copy_data(mesh.point_data), cell,
                    _copy_data(mesh.field_data))

    return view


def _meshio(dim, blocks=False):
    kind = "triangle" if dim == 2 else "tetra"

    def make(mesh=None):
        points, cells, labels = mesh or grid(dim, 4)
        point, cell = data(points, cells, labels)
        parts = [np.flatnonzero(labels == 7), np.flatnonzero(labels == -2)] if blocks else [
            np.arange(len(cells))]
        return meshio.Mesh(
            points, [(kind, cells[part].astype(np.int32)) for part in parts], point_data=point,
            cell_data={name: [v[part] for part in parts] for name, v in cell.items()},
            field_data={"steel": np.array([7, dim])})

    return Host(make, meshio_view(kind), dim, "marker", fields=True)


def _vtk_file(points, cells, labels):
    point, cell = data(points, cells, labels)
    return {"point_data": point, "cell_data": {name: [values] for name, values in cell.items()}}


def _gmsh_file(points, cells, labels):
    labels = np.where(labels == 7, 1, 2)
    return {"point_data": {"temperature": np.arange(len(points)) / 7},
            "cell_data": {"gmsh:physical": [labels], "gmsh:geometrical": [labels],
                          "stress": [np.arange(len(cells)) / 7]},
            "field_data": {"steel": np.array([1, cells.shape[1] - 1])}}


def _medit_file(points, cells, labels):
    return {"cell_data": {"medit:ref": [np.where(labels == 7, 1, 2)]}}


FILES = {".vtu": (_vtk_file, "vtu", "marker"), ".vtk": (_vtk_file, "vtk", "marker"),
         ".msh": (_gmsh_file, "gmsh22", "gmsh:physical"),
         ".mesh": (_medit_file, "medit", "medit:ref")}
"""Data that a format holds, its name in meshio, and the cell data of the regions."""


def file_mesh(suffix, dim, mesh=None):
    """Make a meshio.Mesh of all that a format holds."""
    points, cells, labels = mesh or grid(dim, 4)
    if not len(cells):
        return meshio.Mesh(in_space(points), [])
    kind = "triangle" if dim == 2 else "tetra"
    return meshio.Mesh(in_space(points), [(kind, cells)],
                       **FILES[suffix][0](points, cells, labels))


def store(path, mesh):
    """Write a file of one of FILES; a legacy one of VTK by VTK, as meshio's is none with int32."""
    if path.suffix == ".vtk" and mesh.cells:
        files.write_file(path, mesh)
    else:
        meshio.write(path, mesh, FILES[path.suffix][1])


def _file(suffix, dim):
    """A file in the working directory, and what `optimize_file` makes of it."""
    region = FILES[suffix][2]

    def make(mesh=None):
        path = Path(f"{len(list(Path().iterdir()))}{suffix}")
        store(path, file_mesh(suffix, dim, mesh))
        return path

    def view(path):
        if suffix == ".vtk":
            import pyvista

            mesh = pyvista.read(path)
            return View(np.array(mesh.points), mesh.cells_dict[5 if dim == 2 else 10],
                        *map(_copy_data, (mesh.point_data, mesh.cell_data, mesh.field_data)))
        mesh = meshio.gmsh.read(path) if suffix == ".msh" else meshio.read(path)
        return meshio_view("triangle" if dim == 2 else "tetra")(mesh)

    def optimize(path, **options):
        target = path.with_stem(f"{path.stem}-better")
        odt_plugins.optimize(path, target=target, **options)
        return target

    return Host(make, view, dim, region, optimize=optimize, fields=True)


def _quadratic(kind, dim, word="cells"):
    """A grid of quadratic cells, corners first, with data that are linear on every edge."""

    def make(mesh=None):
        points, cells, labels = mesh or grid(dim, 4)
        nodes, rows = quadratic_meshes.widened(points, cells)
        linear = np.arange(len(points)) * THIRD
        ends = quadratic_meshes.edges_of(rows, dim)
        middle = {mid: (linear[a] + linear[b]) / 2 for (a, b), mid in ends.items()}
        linear = np.append(linear, [middle[i] for i in range(len(points), len(nodes))])
        return quadratic_meshes.MAKERS[kind](nodes, rows, labels, {"temperature": linear}, dim)

    def view(mesh):
        nodes, rows, point, cell = quadratic_meshes.view(mesh, dim)
        n = rows[:, : dim + 1].max() + 1
        mid = {edge: nodes[i] for edge, i in quadratic_meshes.edges_of(rows, dim).items()}
        return View(nodes[:n], rows[:, : dim + 1], {k: v[:n] for k, v in point.items()}, cell, {},
                    mid=mid)

    return Host(make, view, dim, "marker", word, partial(odt_plugins.optimize, fields="keep"))


def add_pymeshlab_attributes(mesh, labels):
    """Custom attributes of every kind, the labels among them as "marker", and a name."""
    n, m = mesh.vertex_number(), mesh.face_number()
    mesh.add_vertex_custom_scalar_attribute(np.arange(n) / 11, "temperature")
    mesh.add_vertex_custom_point_attribute(np.arange(3 * n).reshape(n, 3) / 13, "velocity")
    mesh.add_face_custom_scalar_attribute(np.arange(m) / 17, "stress")
    mesh.add_face_custom_point_attribute(np.arange(3 * m).reshape(m, 3) / 19, "axis")
    mesh.add_face_custom_scalar_attribute(labels.astype(float), "marker")
    mesh.set_label("plate of steel")


def _pymeshlab(whole):
    """A labelled grid with data of every kind, as a Mesh or as the middle one of three meshes."""

    def make(mesh=None):
        import pymeshlab

        points, cells, labels = mesh or grid(2, 4)
        n, m = len(points), len(cells)
        space = in_space(points, THIRD)
        byte = np.random.default_rng(2).integers(0, 256, (n + m, 4)) / 255.0
        single = (np.arange(6 * m + 2 * n) / 7).astype(np.float32).astype(float).reshape(-1, 2)
        uv = np.round(space[cells][:, :, :2] * 64 + labels[:, None, None]) / 64
        alone = pymeshlab.MeshSet()
        alone.add_mesh(pymeshlab.Mesh(
            space, cells.astype(np.int32), v_scalar_array=np.arange(n) * THIRD,
            f_scalar_array=np.arange(m) / 7, v_color_matrix=byte[:n], f_color_matrix=byte[n:],
            v_tex_coords_matrix=single[3 * m:], w_tex_coords_matrix=uv.reshape(-1, 2)))
        if m:
            alone.compute_selection_by_condition_per_vertex(condselect="y < 0.4")
            alone.compute_selection_by_condition_per_face(condselect="x0 + x1 + x2 < 1.2")
        mesh = alone.current_mesh()
        weakref.finalize(mesh, alone.mesh_number).atexit = False
        add_pymeshlab_attributes(mesh, labels)
        if not whole:
            return mesh
        meshes = pymeshlab.MeshSet()
        for other in (pymeshlab.Mesh(space[[0, 1, -1]], np.array([[0, 1, 2]])), mesh,
                      pymeshlab.Mesh(space)):
            meshes.add_mesh(other, other.label())
        meshes.set_current_mesh(1)
        meshes.apply_filter("set_matrix", transformmatrix=np.diag([2.0, 3.0, 4.0, 1.0]),
                            freeze=False)
        return meshes

    def view(mesh):
        field = {}
        if whole:
            meshes, mesh = mesh, mesh.current_mesh()
            field = {"current": np.array(meshes.current_mesh_id()),
                     "transform": np.array(mesh.transform_matrix())}
            for i in (0, 2):
                field[f"points of {i}"] = np.array(meshes.mesh(i).vertex_matrix())
        point = {"scalar": mesh.vertex_scalar_array(), "colour": mesh.vertex_color_array(),
                 "selected": mesh.vertex_selection_array(), "uv": mesh.vertex_tex_coord_matrix(),
                 "temperature": mesh.vertex_custom_scalar_attribute_array("temperature"),
                 "velocity": mesh.vertex_custom_point_attribute_matrix("velocity")}
        cell = {"scalar": mesh.face_scalar_array(), "colour": mesh.face_color_array(),
                "selected": mesh.face_selection_array(),
                "stress": mesh.face_custom_scalar_attribute_array("stress"),
                "marker": mesh.face_custom_scalar_attribute_array("marker"),
                "axis": mesh.face_custom_point_attribute_matrix("axis")}
        field |= {"label": np.array(mesh.label())}
        # MeshLab weighs the normals of vertices and scales those of faces by the transform.
        normals = {kind: values / np.linalg.norm(values, axis=1, keepdims=True) for kind, values
                   in (("vertex", mesh.vertex_normal_matrix()),
                       ("face", mesh.face_normal_matrix()))}
        return View(mesh.vertex_matrix(), mesh.face_matrix(), _copy_data(point), _copy_data(cell),
                    field, normals, mesh.wedge_tex_coord_matrix().reshape(-1, 3, 2))

    return Host(make, view, 2, "marker", "faces")


def _open3d(kind, real=np.float32, index=np.int64):
    """A legacy TriangleMesh or TetraMesh, or a tensor mesh of given dtypes; normals are wrong."""
    dim = 3 if kind == "tetra" else 2

    def make(mesh=None):
        import open3d

        points, cells, labels = mesh or grid(dim, 4)
        n, m = len(points), len(cells)
        space = in_space(points, THIRD)
        random = np.random.default_rng(4)
        colours, wrong, flat = random.random((n, 3)), random.random((n, 3)), random.random((m, 3))
        uv = np.round(in_space(points)[cells][:, :, :2] * 64 + labels[:, None, None]) / 64
        if kind == "tensor":
            mesh = open3d.t.geometry.TriangleMesh(space.astype(real), cells.astype(index))
            point, cell = data(points, cells, labels)
            point |= {"colors": colours.astype(np.float32), "normals": wrong.astype(real)}
            cell |= {"inside": np.arange(m) % 3 == 0, "normals": flat.astype(real),
                     "texture_uvs": uv.astype(np.float32)}
            for name, values in point.items():
                mesh.vertex[name] = values
            for name, values in cell.items():
                mesh.triangle[name] = values
            mesh.material.set_default_properties()
            mesh.material.material_name = "defaultLit"
            mesh.material.texture_maps["albedo"] = open3d.t.geometry.Image(PICTURE)
            return mesh
        corners = open3d.utility.Vector3dVector(space)
        if dim == 3:
            mesh = open3d.geometry.TetraMesh(corners, open3d.utility.Vector4iVector(cells))
        else:
            mesh = open3d.geometry.TriangleMesh(corners, open3d.utility.Vector3iVector(cells))
            mesh.triangle_material_ids = open3d.utility.IntVector((labels == 7).astype(np.int32))
            mesh.textures = [open3d.geometry.Image(PICTURE)]
            mesh.triangle_uvs = open3d.utility.Vector2dVector(uv.reshape(-1, 2))
            mesh.vertex_normals = open3d.utility.Vector3dVector(wrong)
            mesh.triangle_normals = open3d.utility.Vector3dVector(flat)
        mesh.vertex_colors = open3d.utility.Vector3dVector(colours)
        return mesh

    def view(mesh):
        if kind == "tensor":
            point = {name: np.array(v.numpy()) for name, v in mesh.vertex.items()}
            cell = {name: np.array(v.numpy()) for name, v in mesh.triangle.items()}
            picture = mesh.material.texture_maps["albedo"].as_tensor().numpy()
            field = {"material": np.array(mesh.material.material_name), "texture": picture.copy(),
                     "device": np.array(str(mesh.device))}
            normals = {"vertex": point.pop("normals"), "triangle": cell.pop("normals")}
            return View(point.pop("positions"), cell.pop("indices"), point, cell, field, normals,
                        cell.pop("texture_uvs"))
        point = {"colour": np.array(mesh.vertex_colors)}
        if dim == 3:
            return View(np.array(mesh.vertices), np.array(mesh.tetras), point, {}, {})
        cell = {"material": np.array(mesh.triangle_material_ids)}
        field = {"texture": np.array(mesh.textures[0])}
        normals = {"vertex": np.array(mesh.vertex_normals),
                   "triangle": np.array(mesh.triangle_normals)}
        return View(np.array(mesh.vertices), np.array(mesh.triangles), point, cell, field, normals,
                    np.array(mesh.triangle_uvs).reshape(-1, 3, 2))

    region = {"tetra": None, "triangle": "material", "tensor": "marker"}[kind]
    return Host(make, view, dim, region, "tetrahedra" if dim == 3 else "triangles")


NUMBERS = itertools.count()


class GmshModel:
    """A model of Gmsh by its name; what is done with it is done while it is the current one."""

    def __init__(self):
        import gmsh

        if not gmsh.isInitialized():
            gmsh.initialize(interruptible=False)
            gmsh.option.setNumber("General.Terminal", 0)
        self.name, self.last = f"model {next(NUMBERS)}", 0
        gmsh.model.add(self.name)

    def current(self):
        import gmsh

        gmsh.model.setCurrent(self.name)
        return gmsh.model

    def copied(self):
        """The same in another model, by a file."""
        import gmsh

        self.current()
        gmsh.option.setNumber("Mesh.SaveAll", 1)
        gmsh.option.setNumber("Mesh.Binary", 1)
        with tempfile.TemporaryDirectory() as folder:
            gmsh.write(f"{folder}/mesh.msh")
            other = GmshModel()
            gmsh.merge(f"{folder}/mesh.msh")
        other.last = self.last
        return other


def _gmsh(dim):
    """Two entities with a group each, facets beside them, tags with gaps; of a model in memory."""
    kinds = (1, 2, 4)[dim - 2:dim]

    def make(mesh=None):
        points, cells, labels = mesh or grid(dim, 4)
        out = GmshModel()
        model = out.current()
        owners: dict[tuple[int, ...], list[int]] = {}
        for label, cell in zip(labels.tolist(), cells.tolist(), strict=True):
            for facet in itertools.combinations(sorted(cell), dim):
                owners.setdefault(facet, []).append(label)
        skin = [list(f) for f, have in owners.items() if len(have) == 1]
        inner = [list(f) for f, have in owners.items() if len(set(have)) == 2]
        free, first = np.ones(len(points), dtype=bool), 1
        for d, tag, rows in ((dim - 1, 1, skin), (dim - 1, 2, inner), (dim, 1, cells[labels == 7]),
                             (dim, 2, cells[labels == -2])):
            rows = np.array(rows, dtype=np.int64).reshape(-1, d + 1)
            model.addDiscreteEntity(d, tag)
            new = np.unique(rows)
            new = new[free[new]]
            free[new] = False
            model.mesh.addNodes(d, tag, 3 * new + 5, in_space(points)[new].ravel())
            if len(rows):
                model.mesh.addElementsByType(tag, kinds[d - dim + 1], first + np.arange(len(rows)),
                                             (3 * rows + 5).ravel())
            first += 2 * len(rows)
        out.last = 3 * len(points) + 2
        model.addPhysicalGroup(dim, [2], 9, name="steel")
        model.addPhysicalGroup(dim - 1, [1, 2], 4, name="walls")
        return out

    def view(mesh):
        """Field data without the tags of nodes that may come or go, those inside."""
        model = mesh.current()
        tags, flat, _ = model.mesh.getNodes()
        # New ones come last.
        order = np.argsort(tags > mesh.last, kind="stable")
        rank = np.argsort(tags[order])
        parts = [model.mesh.getElementsByType(kinds[1], tag)[1].reshape(-1, dim + 1)
                 for tag in (1, 2)]
        cells = rank[np.searchsorted(tags[order], np.concatenate(parts), sorter=rank)]
        field = {"groups": np.array(model.getPhysicalGroups()),
                 "steel": np.array(model.getPhysicalName(dim, 9))}
        for d, tag in model.getEntities():
            if d < dim:
                field[f"nodes {d} {tag}"] = model.mesh.getNodes(d, tag)[0]
                field[f"facets {d} {tag}"] = model.mesh.getElementsByType(kinds[0], tag)[1]
        return View(flat.reshape(-1, 3)[order], cells, {},
                    {"entity": np.repeat([1, 2], [len(part) for part in parts])}, field)

    def optimize(mesh, **options):
        out = mesh.copied()
        assert odt_plugins.optimize(out.current(), **options) is out.current()
        return out

    return Host(make, view, dim, "entity", "elements", optimize, mesh=GmshModel.current)


PICTURE = np.arange(48, dtype=np.uint8).reshape(4, 4, 3)

HOSTS = {
    "arrays-tet": _arrays(3, False, np.float64, np.int64, tuple, False),
    "arrays-tet-regions": _arrays(3, False, np.float64, np.uint16, list, True),
    "arrays-tet-float32": _arrays(3, True, np.float32, np.uint64, list, False),
    "arrays-tri": _arrays(2, False, np.float64, np.int32, tuple, True),
    "arrays-tri-space": _arrays(2, True, np.float32, np.int64, tuple, True, space=True),
    "pytetwild": _arrays(3, True, np.float64, np.int32, tuple, False),
    "pyvista-tet": _pyvista(3, "grid", np.float64),
    "pyvista-tet-float32": _pyvista(3, "grid", np.float32),
    "pyvista-tri": _pyvista(2, "grid", np.float64),
    "pyvista-polydata": _pyvista(2, "poly", np.float32),
    "vtk-tet": _vtk(3, "grid", np.float64),
    "vtk-polydata": _vtk(2, "poly", np.float32),
    "meshio-tet": _meshio(3),
    "meshio-tet-blocks": _meshio(3, blocks=True),
    "meshio-tri": _meshio(2),
    "meshio-tri-blocks": _meshio(2, blocks=True),
    "pymeshlab-mesh": _pymeshlab(whole=False),
    "pymeshlab-meshset": _pymeshlab(whole=True),
    "open3d-triangle": _open3d("triangle"),
    "open3d-tetra": _open3d("tetra"),
    "open3d-tensor": _open3d("tensor"),
    "open3d-tensor-float64-int32": _open3d("tensor", np.float64, np.int32),
    "dlpack-tet": _foreign(3, np.int64),
    "dlpack-tri": _foreign(2, np.int32),
    "trimesh": _trimesh(textured=False),
    "trimesh-texture": _trimesh(textured=True),
    "skfem-tet": _skfem(3),
    "skfem-tri": _skfem(2),
    "netgen-tet": _netgen(3),
    "netgen-tri": _netgen(2),
    "ngsolve-tet": _netgen(3, wrap=True),
    "gmsh-tet": _gmsh(3),
    "gmsh-tri": _gmsh(2),
    "pyvista-quadratic-tet": _quadratic("pyvista", 3),
    "pyvista-quadratic-tri": _quadratic("pyvista", 2),
    "meshio-quadratic-tet": _quadratic("meshio", 3),
    "meshio-quadratic-tri": _quadratic("meshio", 2),
    "skfem-quadratic-tet": _quadratic("skfem", 3, "elements"),
    "skfem-quadratic-tri": _quadratic("skfem", 2, "elements"),
    **{f"file{suffix}-{dim}d": _file(suffix, dim) for suffix in FILES for dim in (2, 3)},
}

CURVED = [name for name, host in HOSTS.items()
          if host.dim == 2 and name not in (
              "arrays-tri", "dlpack-tri", "skfem-tri", "skfem-quadratic-tri")]
"""Hosts that hold triangles in space."""


def bowl(n=10):
    """The labelled grid on a paraboloid: points, cells, labels."""
    points, cells, labels = grid(2, n)
    points[:, 0] = np.where(points[:, 0] == 0.5, 0.5, points[:, 0])
    return np.column_stack([points, 0.4 * ((points - 0.5) ** 2).sum(axis=1)]), cells, labels


def check_curved(host: Host, before: View, after: View, envelope: float) -> None:
    """The contract between a curved surface and the result: all data, the envelope, the borders."""
    assert after.points.dtype == before.points.dtype
    assert after.cells.dtype == before.cells.dtype
    assert after.points.shape == before.points.shape
    assert not same_bits(before, after)
    old = before.cell_data[host.region] if host.region else np.zeros(len(before.cells), int)
    new = after.cell_data[host.region] if host.region else np.zeros(len(after.cells), int)
    assert facets(after.cells, new) == facets(before.cells, old)
    assert surface_meshes.topology(after.cells) == surface_meshes.topology(before.cells)
    p, q = (v.points.astype(np.float64) for v in (before, after))
    limit = envelope * surface_meshes.diagonal(p)
    assert max(surface_meshes.two_sided(p, before.cells, q, after.cells, 3)) <= limit
    assert radius_ratio(q, after.cells).mean() > radius_ratio(p, before.cells).mean()
    check_data(before, after, old, new, interpolated=("uv",))
    assert (before.wedges is None) == (after.wedges is None)
    check_curved_normals(before, after)


def check_curved_normals(before, after):
    """Normals that were there are those of the result, of its own orientation or the other."""
    x = after.points.astype(np.float64)[after.cells]
    area = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    summed = np.zeros(after.points.shape)
    np.add.at(summed, after.cells.ravel(), np.repeat(area, 3, axis=0))
    assert sorted(before.normals) == sorted(after.normals)
    for name, values in after.normals.items():
        assert values.dtype == before.normals[name].dtype, name
        exact = summed if len(values) == len(summed) else area
        cosine = (values * exact).sum(axis=1) / np.linalg.norm(exact, axis=1)
        assert np.abs(cosine).min() > 0.97, name
