"""Mesh files: every format keeps what the contract asks for, and no half file is ever seen."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import contract
import meshio
import numpy as np
import pytest
from processes import end_hdf5, full_disk

import odt_plugins
from odt_plugins.adapters import files
from odt_plugins.engine.run import plan
from odt_plugins.errors import (
    DataNotKeptWarning,
    InvalidMeshError,
    MeshFileError,
    MissingDependencyError,
)

DATA = Path(__file__).parents[1] / "data"


def _stored(path, dim):
    """Write a mesh with all that its format holds."""
    contract.store(path, contract.file_mesh(path.suffix, dim))


def _mesh(dim, names):
    """A mesh of two materials with the named integer cell data."""
    mesh = contract.file_mesh(".mesh", dim)
    labels = mesh.cell_data.pop("medit:ref")
    mesh.cell_data |= dict.fromkeys(names, labels)
    return mesh


@pytest.mark.parametrize("suffix", contract.FILES)
def test_a_file_and_its_result_are_all_there_is(suffix, d, tmp_path):
    source, target = tmp_path / f"in{suffix}", tmp_path / f"out{suffix}"
    _stored(source, d)
    old = source.read_bytes()
    _, report = odt_plugins.optimize_with_report(source, target=target, keep=())
    assert sorted(tmp_path.iterdir()) == [source, target]
    assert source.read_bytes() == old
    assert report.after.n_cells == len(files.read_file(target).cells[0].data)


def test_a_path_gives_a_meshio_mesh_and_leaves_the_file(tmp_path):
    source = shutil.copy(DATA / "tetwild_bunny.vtu", tmp_path / "mesh.vtu")
    old = Path(source).read_bytes()
    for path in (str(source), Path(source)):
        out = odt_plugins.optimize(path, smoothing={"rounds": 1, "cycles": 1})
        assert type(out) is meshio.Mesh
    assert Path(source).read_bytes() == old
    assert [p.name for p in tmp_path.iterdir()] == ["mesh.vtu"]


def test_a_file_may_be_replaced_by_its_result(tmp_path, monkeypatch):
    monkeypatch.setattr(plan, "run", contract.churn)
    source = tmp_path / "mesh.vtu"
    contract.file_mesh(".vtu", 2).write(source)
    old = meshio.read(source)
    odt_plugins.optimize(source, target=source)
    assert not np.array_equal(meshio.read(source).points, old.points)
    assert [p.name for p in tmp_path.iterdir()] == ["mesh.vtu"]


@pytest.mark.parametrize("version", ["gmsh", "gmsh22"])
def test_gmsh_files_of_both_versions_come_back(version, tmp_path):
    mesh = contract.file_mesh(".msh", 3)
    if version == "gmsh":
        n, m = len(mesh.points), len(mesh.cells[0].data)
        mesh.point_data["gmsh:dim_tags"] = np.tile(np.array([3, 1], dtype=np.int32), (n, 1))
        mesh.cell_data["gmsh:geometrical"] = [np.ones(m, dtype=np.int32)]
        mesh.cell_data["gmsh:physical"] = [np.full(m, 4)]
    meshio.write(tmp_path / "in.msh", mesh, file_format=version)
    odt_plugins.optimize(tmp_path / "in.msh", target=tmp_path / "out.msh")
    head = [(tmp_path / name).read_bytes().split(b"\n")[1].split()[0]
            for name in ("in.msh", "out.msh")]
    assert head == [b"4.1" if version == "gmsh" else b"2.2"] * 2


@pytest.mark.parametrize("suffix", [".vtu", ".vtk", ".msh", ".mesh"])
@pytest.mark.parametrize("share", [0.0, 0.02, 0.5, 0.9])
def test_truncated_files_are_refused(suffix, share, tmp_path):
    source, target = tmp_path / f"in{suffix}", tmp_path / f"out{suffix}"
    _stored(source, 3)
    whole = source.read_bytes()
    source.write_bytes(whole[: int(share * len(whole))])
    names = sorted(p.name for p in tmp_path.iterdir())
    with pytest.raises((MeshFileError, InvalidMeshError)) as caught:
        odt_plugins.optimize(source, target=target)
    assert "\n" not in str(caught.value)
    assert sorted(p.name for p in tmp_path.iterdir()) == names


@pytest.mark.parametrize("dim", [2, 3])
def test_su2_files_that_hold_less_than_they_declare_are_refused(dim, tmp_path, capfd):
    points, cells, _ = contract.grid(dim, 2)
    rim = sorted(contract.facets(cells, np.zeros(len(cells), int)))
    rows = {
        f"NDIME= {dim}": [],
        f"NPOIN= {len(points)}": points.tolist(),
        f"NELEM= {len(cells)}": [[5 if dim == 2 else 10, *cell] for cell in cells.tolist()],
        "NMARK= 2": [],
    }
    for tag, part in ((1, rim[::2]), (2, rim[1::2])):
        rows[f"MARKER_TAG= {tag}"] = []
        rows[f"MARKER_ELEMS= {len(part)}" + tag * " "] = [[3 if dim == 2 else 5, *f] for f in part]
    lines = [line for head, block in rows.items()
             for line in (f"{head}\n", *(" ".join(map(str, row)) + "\n" for row in block))]
    source = tmp_path / "in.su2"
    source.write_text("".join(lines))
    assert [len(block.data) for block in files.read_file(source).cells] == [len(cells), len(rim)]
    refused = 0
    for end in set(range(3, len(lines))) - {lines.index("NMARK= 2\n")}:
        source.write_text("".join(lines[:end]))
        with pytest.raises((MeshFileError, InvalidMeshError)) as caught:
            odt_plugins.optimize(source, smoothing={"rounds": 0}, finish=False)
        refused += " declares " in str(caught.value)
    assert refused > len(cells)
    assert "could not parse" not in capfd.readouterr().err


def test_files_that_end_too_early_or_have_no_cells_say_so(tmp_path):
    source = tmp_path / "in.vtu"
    contract.file_mesh(".vtu", 3).write(source)
    whole = source.read_bytes()
    source.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(MeshFileError, match=r"in\.vtu as vtu: Error parsing XML"):
        odt_plugins.optimize(source)
    text = (
        '<VTKFile type="UnstructuredGrid" version="0.1" byte_order="LittleEndian">'
        '<UnstructuredGrid><Piece NumberOfPoints="0" NumberOfCells="0">'
        "</Piece></UnstructuredGrid></VTKFile>"
    )
    source.write_text(text)
    with pytest.raises(InvalidMeshError, match=r"the mesh has no cells in .*in\.vtu"):
        odt_plugins.optimize(source)
    legacy = tmp_path / "in.vtk"
    meshio.write(legacy, meshio.Mesh(np.eye(3), []))
    with pytest.raises(InvalidMeshError, match=r"the mesh has no cells in .*in\.vtk"):
        odt_plugins.optimize(legacy)
    node = tmp_path / "in.inp"
    node.write_text("*NODE\n1, 0.0, 0.0\n2, 1.0, 0.0\n*ELEMENT, TYPE=CPS3\n1, 1, 2, 3\n")
    with pytest.raises(MeshFileError, match="it refers to 3, which is not there"):
        odt_plugins.optimize(node)


def test_a_block_of_no_cells_needs_no_columns():
    mesh = meshio.Mesh(np.eye(3), [("triangle", np.zeros(0, int))])
    with pytest.raises(InvalidMeshError, match=r"the mesh has no cells \(3 vertices\)"):
        odt_plugins.optimize(mesh)


def test_what_meshio_prints_becomes_one_warning_or_none(tmp_path, capfd):
    mesh = _mesh(3, ["marker"])
    files.write_file(tmp_path / "out.msh", mesh)
    with pytest.warns(DataNotKeptWarning) as caught:
        files.write_file(tmp_path / "out.xml", mesh)
    said = [str(w.message) for w in caught]
    assert len(said) == 1
    assert "out.xml: DOLFIN XML is a legacy format" in said[0]
    with pytest.raises(MeshFileError, match="holds no cells of type tetra"):
        files.write_file(tmp_path / "out.stl", mesh)
    (tmp_path / "in.su2").write_text(
        "NDIME= 2\nNELEM= 1\n5 0 1 2\nNPOIN= 3\n0 0\n1 0\n0 1\nNMARK= 0\nsomething\n")
    with pytest.warns(DataNotKeptWarning, match=r"in\.su2: could not parse line something"):
        files.read_file(tmp_path / "in.su2")
    assert capfd.readouterr() == ("", "")


def test_ascii_stl_and_flat_triangles_pass_where_warnings_are_errors(tmp_path):
    points = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 1], [2, 2, 0]])
    cells = np.array([[0, 1, 2], [0, 2, 3], [1, 4, 2]])
    path = tmp_path / "mesh.stl"
    with np.errstate(all="raise"):
        files.write_arrays(path, points, cells)
        mesh = files.read_file(path)
    assert path.read_bytes().startswith(b"solid")
    assert np.array_equal(mesh.points[mesh.cells[0].data], points[cells])


def test_data_that_come_back_under_another_name_are_not_called_lost(tmp_path):
    mesh = _mesh(3, ["mat"])
    mesh.cell_data["other"] = [np.arange(len(mesh.cells[0].data))]
    message = r"keep cell data 'other', the name of cell data 'mat' \(there 'medit:ref'\); try"
    with pytest.warns(DataNotKeptWarning, match=message) as caught:
        files.write_file(tmp_path / "out.mesh", mesh)
    assert len(caught) == 1
    back = files.read_file(tmp_path / "out.mesh")
    assert np.array_equal(back.cell_data["medit:ref"][0], mesh.cell_data["mat"][0])


def test_unreadable_files_are_named(tmp_path, capsys):
    (tmp_path / "noise.vtu").write_bytes(bytes(range(256)) * 20)
    (tmp_path / "noise.msh").write_text("hello\n")
    cases = {"missing.vtu": "is missing", "noise.vtu": "cannot read .*noise.vtu as vtu",
             "noise.msh": "cannot read .*noise.msh as gmsh or ansys", "mesh": "no suffix of a mesh",
             "mesh.docx": r"expected one of .*\.vtu",
             "blank.off": "it begins with nothing; expected OFF"}
    (tmp_path / "blank.off").write_text("\n")
    for name, message in cases.items():
        with pytest.raises(MeshFileError, match=message) as caught:
            odt_plugins.optimize(tmp_path / name)
        assert "\n" not in str(caught.value)
    (tmp_path / "folder.vtu").mkdir()
    with pytest.raises(MeshFileError, match="is a directory"):
        odt_plugins.optimize(tmp_path / "folder.vtu")
    assert capsys.readouterr().out == ""


def test_outputs_that_cannot_be_written_are_named_before_any_work(tmp_path, monkeypatch):
    monkeypatch.setattr(plan, "run", lambda *_: pytest.fail("the engine ran"))
    (tmp_path / "file").write_text("")
    (tmp_path / "folder.vtu").mkdir()
    monkeypatch.setattr(files.os, "access", lambda path, mode: Path(path).name != "locked")
    (tmp_path / "locked").mkdir()
    cases = {"none/out.vtu": "is not a directory", "file/out.vtu": "is not a directory",
             "folder.vtu": "is a directory", "out.docx": "no suffix", "locked/out.vtu": "writable"}
    names = sorted(tmp_path.rglob("*"))
    for name, message in cases.items():
        with pytest.raises(MeshFileError, match=message):
            odt_plugins.optimize(DATA / "tetwild_bunny.vtu", target=tmp_path / name)
        with pytest.raises(MeshFileError, match=message):
            files.write_file(tmp_path / name, contract.file_mesh(".vtu", 2))
    assert sorted(tmp_path.rglob("*")) == names


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError("disk full"), ValueError("what")])
def test_an_interrupted_write_leaves_the_old_file(error, tmp_path, monkeypatch):
    target = tmp_path / "out.mesh"
    target.write_text("old")

    def write(path, mesh, file_format):
        Path(path).write_text("half")
        raise error

    monkeypatch.setattr(meshio, "write", write)
    expected = KeyboardInterrupt if error is KeyboardInterrupt else MeshFileError
    with pytest.raises(expected):
        files.write_file(target, contract.file_mesh(".vtu", 2))
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("out.mesh", "old")]


FULL = """
import os, resource, sys, warnings
import meshio, numpy as np
from odt_plugins.adapters import files
from odt_plugins.errors import MeshFileError
from processes import end_hdf5
warnings.simplefilter("ignore")
with np.load(sys.argv[1]) as grid:
    mesh = meshio.Mesh(grid["points"], [("tetra", grid["cells"])])
for name in sys.argv[2:]:
    for limit in (2_000, 20_000):
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
        try:
            files.write_file(name, mesh)
        except MeshFileError as exc:
            print(exc)
    resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY,) * 2)
    print(sorted(os.listdir()), open(name).read())
    files.write_file(name, mesh)
    again = files.read_file(name)
    print(len(again.points))
    again.points[0] += 1e-3
    end_hdf5()
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, resource.RLIM_INFINITY))
    try:
        files.write_file("again" + name, again)
    except MeshFileError as exc:
        print(str(exc).split(":")[0].split(" as ")[0], os.path.exists("again" + name))
    resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY,) * 2)
    for path in (name, "out.h5"):
        if os.path.exists(path):
            os.remove(path)
"""


def test_a_full_disk_leaves_the_old_file_and_no_open_handle(tmp_path, tmp_path_factory):
    points, cells, _ = contract.grid(3, 9)
    grid = tmp_path_factory.mktemp("grid") / "grid.npz"
    np.savez(grid, points=points, cells=cells)
    names = [f"out{suffix}" for suffix in (".xdmf", ".med", ".h5m", ".cgns", ".hmf", ".e", ".msh")]
    for name in names:
        (tmp_path / name).write_text("old")
    paths = os.pathsep.join([str(Path(__file__).parent), *sys.path])
    done = subprocess.run(
        [sys.executable, "-c", FULL, str(grid), *names], cwd=tmp_path, capture_output=True,
        text=True, check=False, timeout=200, env=full_disk(PYTHONPATH=paths))
    assert (done.returncode, done.stderr) == (0, "")
    told = done.stdout.splitlines()
    for k, name in enumerate(names):
        said = f"cannot write {name}: File too large; try another path"
        there = sorted(names[k:])
        assert told[5 * k:5 * k + 5] == [
            said, said, f"{there} old", "1000", f"cannot write again{name} False"]


CUT = """
import os, resource, sys
import meshio
from odt_plugins import errors
from odt_plugins.adapters import files
mesh = meshio.read(sys.argv[1])
resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, resource.RLIM_INFINITY))
try:
    files.write_file("out.vtk", mesh)
except errors.MeshFileError as exc:
    print(exc, os.listdir())
"""


def test_a_full_disk_is_named_where_vtk_deletes_what_it_wrote(tmp_path, tmp_path_factory):
    points, cells, _ = contract.grid(3, 9)
    source = tmp_path_factory.mktemp("source") / "in.vtu"
    meshio.Mesh(points, [("tetra", cells)]).write(source)
    done = subprocess.run(
        [sys.executable, "-c", CUT, str(source)], cwd=tmp_path, capture_output=True, text=True,
        check=False, timeout=200, env=full_disk(PYTHONPATH=os.pathsep.join(sys.path)))
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == "cannot write out.vtk: File too large; try another path []\n"


def test_a_writer_that_dies_is_an_error(tmp_path, monkeypatch):
    end_hdf5()
    (tmp_path / "h5py.py").write_text("import os\nos.kill(os.getpid(), 9)\n")
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "out").mkdir()
    with pytest.raises(MeshFileError, match=r"out\.med: its process was ended by SIGKILL"):
        files.write_file(tmp_path / "out" / "out.med", contract.file_mesh(".vtu", 3))
    assert not list((tmp_path / "out").iterdir())


@pytest.mark.parametrize("suffix", [".xdmf", ".med", ".e"])
def test_what_is_said_in_another_process_is_told(suffix, tmp_path, capfd):
    mesh = _mesh(3, ["marker"])
    mesh.cells[0].type = "tetra_of_mine"
    with pytest.raises(MeshFileError, match="tetra_of_mine"):
        files.write_file(tmp_path / f"out{suffix}", mesh)
    with pytest.warns(DataNotKeptWarning, match=r"out\.hmf: Experimental file format"):
        files.write_file(tmp_path / "out.hmf", _mesh(3, ["marker"]))
    assert [p.name for p in tmp_path.iterdir()] == ["out.hmf"]
    assert capfd.readouterr() == ("", "")


def test_formats_that_hold_less_say_so(tmp_path):
    mesh = contract.file_mesh(".vtu", 3)
    mesh.field_data["recipe"] = np.arange(3.0)
    with pytest.warns(DataNotKeptWarning, match=r"cell data .*'stress', field data 'recipe', "):
        files.write_file(tmp_path / "out.mesh", mesh)
    assert (tmp_path / "out.mesh").exists()
    mesh = _mesh(3, [])
    mesh.points = mesh.points / 3.0
    with pytest.warns(DataNotKeptWarning, match="does not keep the last digits of the coord"):
        files.write_file(tmp_path / "out.bdf", mesh)
    for name, message in {"out.stl": r"holds no cells of type tetra.*\.vtu",
                          "out.off": r"holds no cells of type tetra.*\.vtu"}.items():
        with pytest.raises(MeshFileError, match=message):
            files.write_file(tmp_path / name, mesh)
        assert not (tmp_path / name).exists()


def test_what_cannot_be_read_again_is_not_written(tmp_path, monkeypatch):
    monkeypatch.setattr(meshio, "write", lambda path, mesh, file_format: path.write_text("half"))
    with pytest.raises(MeshFileError, match="what meshio writes cannot be read again"):
        files.write_file(tmp_path / "out.mesh", _mesh(3, []))
    assert not list(tmp_path.iterdir())


def test_formats_of_two_files_are_written_whole(tmp_path):
    mesh = _mesh(3, [])
    files.write_file(tmp_path / "out.ele", mesh)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out.ele", "out.node"]
    back = files.read_file(tmp_path / "out.node")
    assert np.array_equal(back.points, mesh.points)
    assert np.array_equal(back.cells[0].data, mesh.cells[0].data)


def test_formats_that_need_another_package_name_it(tmp_path, monkeypatch):
    end_hdf5()
    (tmp_path / "h5py.py").write_text("raise ModuleNotFoundError(name='h5py')\n")
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "out").mkdir()
    with pytest.raises(MissingDependencyError, match=r"\.xdmf files need the package h5py.*pip"):
        files.write_file(tmp_path / "out" / "out.xdmf", contract.file_mesh(".vtu", 2))
    assert not list((tmp_path / "out").iterdir())


def test_writing_does_not_change_the_mesh(tmp_path):
    mesh = contract.file_mesh(".vtu", 2)
    mesh.cell_sets["some"] = [np.arange(3)]
    mesh.point_sets["top"] = np.arange(2)
    old = mesh.copy()
    with pytest.warns(DataNotKeptWarning, match="cell sets 'some'"):
        files.write_file(tmp_path / "out.vtu", mesh)
    assert sorted(mesh.cell_sets) == ["some"]
    assert sorted(mesh.cell_data) == sorted(old.cell_data)
    assert np.array_equal(mesh.points, old.points)


@pytest.mark.parametrize("suffix", [".vtu", ".msh", ".inp", ".med"])
def test_cells_of_many_faces_are_refused_by_a_sentence(tmp_path, suffix):
    points, faces = np.eye(4, 3), [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
    mesh = meshio.Mesh(points, [("tetra", np.array([[0, 1, 2, 3]])), ("polyhedron4", [faces])])
    with pytest.raises(MeshFileError, match="cannot write out"):
        files.write_file(tmp_path / f"out{suffix}", mesh)
    assert not [*tmp_path.iterdir()]
