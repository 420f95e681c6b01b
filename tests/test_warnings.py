"""Every warning names the line of the caller, and none is issued in another way."""

from __future__ import annotations

import ast
import contextlib
import warnings
from pathlib import Path

import contract
import meshio
import numpy as np
import pymeshlab
import pytest
import quadratic_meshes
import surface_meshes
from pieces import write_pieces
from scipy import sparse

import odt_plugins
from odt_plugins import tetwild
from odt_plugins.compare.start import ball
from odt_plugins.engine.odt.multigrid import solve_amg
from odt_plugins.engine.run import plan
from odt_plugins.errors import INSIDE, ODTWarning, warn
from odt_plugins.generate import levels

PACKAGE = Path(odt_plugins.__file__).parent

odt_plugins.register("pymeshlab")


def calls(path):
    """Names that are called in a file and end so: "warn" and "warnings.warn"."""
    text = path.read_text(encoding="utf-8")
    tree = ast.parse(text if "warn" in text else "")
    called = [node.func for node in ast.walk(tree) if isinstance(node, ast.Call)]
    return {ast.unparse(name) for name in called
            if "warn" in (getattr(name, "attr", ""), getattr(name, "id", ""))}


def square():
    points, cells, _ = contract.grid(2, 4)
    return np.column_stack([points, np.zeros(len(points))]), cells


def dropped(place, monkeypatch):
    points, cells = square()
    mesh = meshio.Mesh(points, [("triangle", cells)], point_data={"x": points[:, 0]})
    meshio.write(place / "in.vtu", mesh)
    odt_plugins.optimize(place / "in.vtu", target=place / "out.off")


def unknown(place, monkeypatch):
    text = "NDIME= 2\nsomething\nNELEM= 1\n5 0 1 2 0\nNPOIN= 3\n0 0 0\n1 0 1\n0 1 2\nNMARK= 0\n"
    (place / "in.su2").write_text(text)
    odt_plugins.quality(place / "in.su2")


def of_another_mesh(place, monkeypatch):
    points, cells = square()
    meshio.write(place / "in.mesh", meshio.Mesh(points, [("triangle", cells)]))
    text = "MeshVersionFormatted 2\nDimension 3\nSolAtVertices\n1\n1 1\n7\nEnd\n"
    (place / "in.sol").write_text(text)
    odt_plugins.quality(place / "in.mesh")


def edges(place, monkeypatch):
    points, cells, _ = contract.grid(2, 2)
    items = [f'<DataItem Format="XML" Dimensions="{len(rows)} {rows.shape[1]}" NumberType="{kind}">'
             f"{' '.join(map(repr, rows.ravel().tolist()))}</DataItem>"
             for rows, kind in ((cells, "Int"), (points, "Float"), (points[:1], "Float"))]
    (place / "in.xdmf").write_text(
        f'<Xdmf Version="3.0"><Domain><Grid><Topology TopologyType="Triangle" '
        f'NumberOfElements="{len(cells)}">{items[0]}</Topology><Geometry GeometryType="XY">'
        f'{items[1]}</Geometry><Attribute Name="flux" Center="Edge">{items[2]}</Attribute>'
        f"</Grid></Domain></Xdmf>")
    odt_plugins.quality(place / "in.xdmf")


def elsewhere(place, monkeypatch):
    points, cells, _ = contract.grid(3, 1)
    monkeypatch.setattr(tetwild, "run_tetwild", lambda *_: (points, cells.astype(np.int32)))
    faces = np.array(sorted(contract.facets(cells, np.zeros(len(cells), int))))
    odt_plugins.tetrahedralize(points + 9.0, faces)


def link(place, monkeypatch):
    points, cells, _ = contract.grid(3, 4)
    pairs = np.stack([np.flatnonzero(points[:, 0] == x) for x in (0, 1)], axis=1)
    mesh = meshio.Mesh(points, [("tetra", cells)], gmsh_periodic=[[2, (2, 1), None, pairs]])
    odt_plugins.remesh(mesh, scale=2, free="periodic")


def point_data(place, monkeypatch):
    monkeypatch.setattr(plan, "run", contract.churn)
    points, cells, _ = contract.grid(2, 3)
    nodes, rows = quadratic_meshes.widened(points, cells)
    mesh = meshio.Mesh(nodes, [("triangle6", rows)], point_data={"id": np.arange(len(nodes))})
    odt_plugins.optimize(mesh)


def seams(place, monkeypatch):
    points, cells = surface_meshes.sphere(2, 0.2)
    meshes = pymeshlab.MeshSet()
    uv = (points[cells][:, :, :2] + 2.0 * (points[cells][:, :, 2:].mean(1) > 0)[:, None]) / 4.0
    meshes.add_mesh(pymeshlab.Mesh(points, cells, w_tex_coords_matrix=uv.reshape(-1, 2)))
    odt_plugins.optimize(meshes, envelope=0.05)


def curvature(place, monkeypatch):
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(*square()))
    meshes.compute_curvature_principal_directions_per_vertex()
    monkeypatch.setattr(plan, "run", contract.churn)
    odt_plugins.optimize(meshes)


def held(place, monkeypatch):
    points, cells = square()
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(points, cells))
    mesh = meshes.current_mesh()
    mesh.add_face_custom_scalar_attribute(np.arange(len(cells), dtype=float), "stress")
    monkeypatch.setattr(plan, "run", contract.churn)
    meshes.meshing_odt_optimization()
    assert mesh.vertex_number()


def polygons(place, monkeypatch):
    turn = np.arange(12) * np.pi / 6
    rim = np.column_stack([3 * np.cos(turn), np.sin(turn), 0 * turn])
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(rim, [np.arange(12, dtype=np.uint32)]))
    meshes.meshing_odt_optimization(keepquality=False)
    mesh = meshes.current_mesh()
    assert len(mesh.polygonal_face_list()) == mesh.face_number() == 10


def beyond(place, monkeypatch):
    points, cells, _ = contract.grid(3, 3)
    monkeypatch.setattr(levels, "_measured", lambda *_: ((1.0, 1.0), 1.0))
    odt_plugins.refine_with_report((points, cells), 1)


def closed(place, monkeypatch):
    points, cells, _ = contract.grid(3, 1)
    monkeypatch.setattr(tetwild, "run_tetwild", lambda *_: (points, cells.astype(np.int32)))
    faces = np.array(sorted(contract.facets(cells, np.zeros(len(cells), int))))[1:]
    meshio.write(place / "in.vtu", meshio.Mesh(points, [("triangle", faces)],
                                               cell_data={"side": [np.arange(len(faces))]}))
    odt_plugins.tetrahedralize(place / "in.vtu", target=place / "out.vtu")


def bent(place, monkeypatch):
    points, cells, _ = contract.grid(3, 1)
    monkeypatch.setattr(tetwild, "run_tetwild", lambda *_: (points, cells.astype(np.int32)))
    faces = np.array(sorted(contract.facets(cells, np.zeros(len(cells), int))))
    nodes, rows = quadratic_meshes.widened(points, faces)
    nodes[len(points):] += 0.1
    meshio.write(place / "in.vtu", meshio.Mesh(nodes, [("triangle6", rows)]))
    odt_plugins.tetrahedralize(place / "in.vtu", target=place / "out.vtu")


def apart(place, monkeypatch):
    start = ball(150)
    index = write_pieces(place / "in", start.points, start.cells, np.arange(len(start.cells)) % 2)
    mesh = meshio.read(place / "in" / "piece-0.vtu")
    mesh.point_data["extra"] = np.zeros(len(mesh.points))
    mesh.write(place / "in" / "piece-0.vtu")
    odt_plugins.optimize(index, target=place / "out.pvtu", block_rounds=1)


def pictures(place, monkeypatch):
    points, cells = square()
    lines = ["mtllib sub/m.mtl", *("v {} {} {}".format(*p) for p in points.tolist()),
             *("f {} {} {}".format(*row) for row in (cells + 1).tolist()), ""]
    (place / "sub").mkdir()
    (place / "out").mkdir()
    (place / "sub" / "m.mtl").write_text("newmtl m")
    (place / "in.obj").write_text("\n".join(lines))
    odt_plugins.optimize(place / "in.obj", target=place / "out" / "in.obj")


def slow(place, monkeypatch):
    n = 400
    matrix = sparse.diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(n, n), format="csr")
    solve_amg(matrix, np.ones((n, 1)), 1e-30, iterations=1)


def soup(place, monkeypatch):
    start = ball(60)
    cells = np.arange(start.cells.size).reshape(-1, 4)
    odt_plugins.optimize((start.points[start.cells].reshape(-1, 3), cells))


def levels_of_refinement(place, monkeypatch):
    from netgen.csg import unit_cube
    from ngsolve import Mesh

    mesh = Mesh(unit_cube.GenerateMesh(maxh=1.0))
    mesh.Refine()
    odt_plugins.optimize(mesh)


CASES = {
    "adapters/netgen_mesh.py": (levels_of_refinement,),
    "carrying/roundtrip.py": (soup,),
    "tetwild.py": (elsewhere,),
    "adapters/files.py": (dropped, unknown),
    "adapters/formats/medit_solution.py": (of_another_mesh,),
    "adapters/formats/named_files.py": (pictures,),
    "adapters/formats/xdmf.py": (edges,),
    "adapters/higher_order.py": (point_data,),
    "adapters/point_sets.py": (link,),
    "adapters/wedges.py": (seams,),
    "adapters/pymeshlab_copy.py": (curvature,),
    "adapters/pymeshlab_set.py": (held,),
    "adapters/pymeshlab_faces.py": (polygons,),
    "generate/levels.py": (beyond,),
    "generate/fill.py": (closed,),
    "generate/coarse.py": (bent,),
    "distributed/pieces.py": (apart,),
    "engine/odt/multigrid.py": (slow,),
}
"""For the files that warn, what makes them do so."""

ELSEWHERE = {"adapters/open3d_mesh.py": "tests/adapters/test_open3d.py"}
"""Files that warn, and the tests that look at the line."""


def test_there_is_one_way_to_warn_and_a_case_for_every_file_that_does():
    found = {path.relative_to(PACKAGE).as_posix(): calls(path) for path in PACKAGE.rglob("*.py")}
    assert [name for name, names in found.items() if "warnings.warn" in names] == ["errors.py"]
    assert {name for name, names in found.items() if "warn" in names} == {*CASES, *ELSEWHERE}
    for name in ELSEWHERE.values():
        assert "filename == __file__" in (PACKAGE.parent / name).read_text(encoding="utf-8")


@pytest.mark.parametrize("case", [case for found in CASES.values() for case in found],
                         ids=lambda case: case.__name__)
def test_a_warning_names_the_line_of_the_caller(case, tmp_path, monkeypatch):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        case(tmp_path, monkeypatch)
    ours = [w for w in caught if issubclass(w.category, ODTWarning)]
    assert ours
    assert {w.filename for w in ours} == {__file__}
    start = case.__code__.co_firstlineno
    assert all(start < w.lineno <= start + 12 for w in ours)


def test_functions_of_the_package_and_context_managers_between_them_are_passed_over():
    assert contextlib.__file__ in INSIDE
    inner = compile("""
from contextlib import contextmanager
@contextmanager
def within(warn):
    yield
    warn("late")
def outer(warn, deep):
    with within(warn):
        warn("early") if not deep else outer(warn, deep - 1)
""", str(PACKAGE / "engine" / "x.py"), "exec")
    room: dict = {}
    exec(inner, room)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        room["outer"](warn, 5)
    assert [w.filename for w in caught] == [__file__] * 7
