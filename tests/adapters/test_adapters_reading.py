"""Damaged mesh files: every reading comes to an end, and says in one sentence what is wrong."""

from __future__ import annotations

import os
import re
import sys
import threading
import time
import warnings

import contract
import meshio
import numpy as np
import pytest
from attack import damage
from processes import wait_until

from odt_plugins.adapters import apart, files, reading, stated
from odt_plugins.adapters.formats.readers import MODULES, reader_of
from odt_plugins.errors import DataNotKeptWarning, MeshFileError, ODTError

NO_DATA = ("h5m", "su2", "ugrid", "ugrid text")
"""Formats whose writers fail on cell data."""

UNCOUNTED = ("ansys", "ansys text", "mdpa", "tetgen cells", "tetgen points")
"""Formats that are whole without some last lines, or read as much as there is."""

KIND = {"gmsh22": "gmsh", "vtk42": "vtk", "vtk51": "vtk"}
"""Names of readers that are not those of the writers."""


def reads(monkeypatch, name, reader):
    """Let a reader take the place of that of meshio."""
    monkeypatch.setattr(getattr(meshio, MODULES.get(name, name)), "read", reader)


def _mesh(name, size=2):
    dim = 2 if name in damage.TRIANGLES else 3
    points, cells, labels = contract.grid(dim, size)
    data = {} if name in NO_DATA else {"marker": [labels]}
    return meshio.Mesh(contract.in_space(points), [("triangle" if dim == 2 else "tetra", cells)],
                       cell_data=data)


def _stored(name, folder):
    """Write the files of a format, and give the path of the one that is read."""
    parts = damage.written(name, _mesh(name))
    for part, data in parts.items():
        (folder / part).write_bytes(data)
    return folder / next(iter(parts))


def _refused(path):
    with pytest.raises(ODTError) as caught:
        files.read_file(path)
    said = str(caught.value)
    assert "\n" not in said
    assert "takes longer" not in said
    return said


@pytest.mark.parametrize("name", damage.FORMATS)
def test_whole_files_are_read_as_meshio_reads_them(name, tmp_path, capsys):
    path = _stored(name, tmp_path)
    kind = KIND.get(damage.FORMATS[name][1], damage.FORMATS[name][1])
    with np.errstate(all="ignore"):
        plain = reader_of(kind)(str(path))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataNotKeptWarning)
        mesh = files.read_file(path)
    assert np.array_equal(mesh.points, plain.points)
    assert [block.type for block in mesh.cells] == [block.type for block in plain.cells]
    for block, other in zip(mesh.cells, plain.cells, strict=True):
        assert np.array_equal(block.data, other.data)


@pytest.mark.parametrize("name", ["tetgen cells", "tetgen points", "tecplot", "off", "wkt", "ply",
                                  "ply text", "ansys", "ansys text", "mdpa", "nastran"])
def test_cut_files_are_refused_at_once(name, tmp_path):
    path = _stored(name, tmp_path)
    whole = path.read_bytes()
    ends = {int(share * len(whole)) for share in np.linspace(0, 0.99, 40)}
    ends |= set(np.cumsum([len(line) for line in whole.splitlines(True)[:12]]).tolist())
    refused = []
    for end in sorted(ends - {len(whole)}):
        path.write_bytes(whole[:end])
        try:
            files.read_file(path)
        except ODTError as exc:
            refused.append(str(exc))
    assert len(refused) > (15 if name in UNCOUNTED else len(ends) - 2)
    assert not [said for said in refused if "\n" in said or "takes longer" in said]


def test_the_suffixes_of_tecplot_are_one_format(tmp_path):
    path = tmp_path / "mesh.tec"
    path.write_bytes(damage.written("tecplot", _mesh("tecplot"))["mesh.dat"][:-100])
    assert "ends too early" in _refused(path)


@pytest.mark.parametrize("text", [
    "TIN (((0 0 0, 1 0 0, 0 1 0, 0 0 0))" + 40 * ", ((0 0 0, 1 0 0, 0 1 0, 0 0 0))",
    "TIN (((0.125 0.5 0.25, 1.125 0.5 0.25, 0.5 1.125 0.125, 0.125 0.5 0.25x)))",
    "TIN (((0 0 0, 1 0 0, 0 1e400 0, 0 0 0)))",
])
def test_broken_well_known_text_is_refused(text, tmp_path):
    path = tmp_path / "mesh.wkt"
    path.write_text(text)
    assert "it has the coordinate 1e400" in _refused(path) or "is not TIN" in _refused(path)


def test_well_known_text_may_have_exponents(tmp_path):
    points, cells, _ = contract.grid(2, 3)
    points = contract.in_space(points) / 3e7 - 1e-9
    files.write_arrays(tmp_path / "mesh.wkt", points, cells)
    assert "e-0" in (tmp_path / "mesh.wkt").read_text()
    mesh = files.read_file(tmp_path / "mesh.wkt")
    assert np.array_equal(mesh.points[mesh.cells[0].data], points[cells])


@pytest.mark.parametrize("name", ["ansys", "avs", "dolfin", "gmsh 2.2", "gmsh 2.2 text",
                                  "gmsh 4.1 text", "netgen", "off", "ply",
                                  "ply text", "ugrid text",
                                  "vtk 4.2", "vtk 5.1 text"])
def test_counts_beyond_the_size_of_the_file_are_refused_before_it_is_read(
    name, tmp_path, monkeypatch
):
    path = _stored(name, tmp_path)
    kind = KIND.get(damage.FORMATS[name][1], damage.FORMATS[name][1])
    whole = path.read_bytes()
    reads(monkeypatch, kind, lambda path: pytest.fail("it was read"))
    found = next(stated.re.finditer(stated.COUNTS[kind], whole))
    for group in range(1, len(found.groups()) + 1):
        if found[group] is None:
            continue
        start, end = found.span(group)
        path.write_bytes(whole[:start] + b"1000000000000" + whole[end:])
        with pytest.raises(MeshFileError) as caught:
            reading.read(path, kind)
        assert "1000000000000" in str(caught.value)
        assert f"has {path.stat().st_size} bytes" in str(caught.value)


def test_files_that_belong_to_a_file_count_in_its_limit(tmp_path):
    (tmp_path / "part.inp").write_text("*NODE\n" + 200 * "1, 0., 0., 0.\n")
    main = tmp_path / "main.inp"
    main.write_text("*INCLUDE, INPUT=part.inp\n*INCLUDE, INPUT=main.inp\n")
    both = main.stat().st_size + (tmp_path / "part.inp").stat().st_size
    assert stated.expect_counts(main, "abaqus") == both
    path = _stored("xdmf", tmp_path)
    assert stated.expect_counts(path, "xdmf") == sum(
        part.stat().st_size for part in tmp_path.glob("mesh.*"))


def _endless(_path):
    while True:
        time.sleep(0)


@pytest.mark.parametrize("main", [True, False], ids=["main thread", "other thread"])
def test_a_reader_that_does_not_end_is_broken_off(main, tmp_path, monkeypatch):
    monkeypatch.setattr(apart, "vtk_installed", lambda: False)
    reads(monkeypatch, "vtu", _endless)
    monkeypatch.setattr(reading, "LEAST", 0.2)
    path = tmp_path / "mesh.vtu"
    path.write_bytes(b"x" * 5000)
    said, before = [], set(threading.enumerate())

    def read():
        with pytest.raises(MeshFileError) as caught:
            files.read_file(path)
        said.append(str(caught.value))

    if main:
        read()
    else:
        thread = threading.Thread(target=read)
        thread.start()
        thread.join(60)
    assert said == [f"cannot read {path} as vtu: it takes longer than 0.3 s, the limit for 5000 "
                    "bytes; expected a complete file"]
    for thread in set(threading.enumerate()) - before:
        thread.join(60)
        assert not thread.is_alive()


def test_work_that_lets_no_other_thread_run_is_ended():
    with pytest.raises(TimeoutError):
        apart.call(re.match, "(a+)+$", 64 * "a" + "b", seconds=0.5, modules=())
    assert apart.call(divmod, 7, 2, modules=()) == (3, 1)
    with pytest.raises(ZeroDivisionError):
        apart.call(divmod, 7, 0, modules=())


def test_a_process_that_stays_is_the_same_until_it_crashes():
    first = apart.call(os.getpid)
    with pytest.raises(ZeroDivisionError):
        apart.call(divmod, 7, 0)
    assert apart.call(os.getpid) == first != os.getpid()
    with pytest.raises(ChildProcessError, match="SIGABRT"):
        apart.call(os.abort)
    with pytest.raises(TimeoutError):
        apart.call(re.match, "(a+)+$", 64 * "a" + "b", seconds=0.5)
    assert apart.call(os.getpid) != first


def test_a_process_for_hdf5_is_another_one_and_ends_when_a_task_fails():
    first = apart.call(os.getpid, modules=())
    assert apart.call(os.getpid, modules=()) == first != apart.call(os.getpid)
    with pytest.raises(ZeroDivisionError):
        apart.call(divmod, 7, 0, modules=())
    assert apart.call(os.getpid, modules=()) != first


def test_vtk_is_loaded_beforehand_where_a_file_will_need_it(monkeypatch):
    started = []
    monkeypatch.setattr(apart, "_ready", started.append)
    apart.make_ready_for(["optimize", "in.msh", "vtu", "vtu.msh"])
    assert not started
    apart.make_ready_for(["optimize", "IN.VTU", "out.msh"])
    assert started
    process = apart._Process("nowhere", "colorsys", "stringprep")
    try:
        for module in ("colorsys", "stringprep"):
            known = f"{module!r} in __import__('sys').modules"
            wait_until(lambda asked=known: process.ask(eval, (asked,), 60.0), 60.0)
    finally:
        process.end()


class Holding(ZeroDivisionError):
    """An error that only the collection of garbage ends."""

    def __init__(self, number):
        super().__init__(number)
        self.own = self


def _fail_with(number):
    raise Holding(number)


def test_the_process_that_stays_keeps_nothing_of_what_a_task_made():
    held = ("(lambda gc: [gc.unfreeze(), sum(type(x).__name__ == 'Holding' "
            "for x in gc.get_objects())][1])(__import__('gc'))")
    for number in range(3):
        with pytest.raises(Holding, match=str(number)):
            apart.call(_fail_with, number)
    assert apart.call(eval, held) == 0


def test_an_hdf5_file_that_is_read_for_ever_is_broken_off(tmp_path, monkeypatch):
    path = _stored("hmf", tmp_path)
    # The global heap of the file is shifted by a byte: HDF5 walks through it for ever.
    path.write_bytes(path.read_bytes().replace(b"0.1-alpha", b"0.1-alphaa", 1))
    monkeypatch.setattr(reading, "LEAST", 0.8)
    with pytest.raises(MeshFileError, match=r"cannot read .*mesh\.hmf as hmf"):
        files.read_file(path)


@pytest.mark.parametrize("count", ["100000", "1000000000000"])
def test_tags_of_gmsh_data_that_are_not_there_end_with_the_file(count, tmp_path):
    path = _stored("gmsh 2.2 text", tmp_path)
    whole = path.read_text()
    path.write_text(f'{whole}$NodeData\n1\n"t"\n{count}\n0.0\n')
    assert "it ends too early" in _refused(path)


def test_readings_in_threads_leave_the_streams_as_they_were(tmp_path, monkeypatch):
    path = tmp_path / "mesh.vtu"
    contract.file_mesh(".vtu", 2).write(path)
    second_in, first_out = threading.Event(), threading.Event()
    calls, reader = [], reader_of("vtu")

    def slow(path):
        calls.append(path)
        if len(calls) == 1:
            second_in.wait(1)
        else:
            second_in.set()
            first_out.wait(1)
        return reader(path)

    monkeypatch.setattr(apart, "vtk_installed", lambda: False)
    reads(monkeypatch, "vtu", slow)
    streams, filters = (sys.stdout, sys.stderr), warnings.filters

    def first():
        files.read_file(path)
        first_out.set()

    threads = [threading.Thread(target=first),
               threading.Thread(target=files.read_file, args=[path])]
    threads[0].start()
    while not calls:
        time.sleep(0.01)
    threads[1].start()
    for thread in threads:
        thread.join(60)
    assert (sys.stdout, sys.stderr) == streams
    assert warnings.filters is filters


def test_what_a_reader_warns_of_becomes_one_sentence(tmp_path, monkeypatch):
    path, known = _stored("netgen", tmp_path), reader_of("netgen")

    def reader(path):
        warnings.warn("Input line 1 contained no data", stacklevel=1)
        return known(path)

    reads(monkeypatch, "netgen", reader)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        mesh = files.read_file(path)
    assert len(mesh.points) == 27
    assert [w.category for w in caught] == [DataNotKeptWarning]
    assert str(caught[0].message) == (
        f"{path}: Input line 1 contained no data")


def test_numbers_that_are_none_are_refused(tmp_path):
    path = _stored("gmsh 2.2 text", tmp_path)
    whole = path.read_bytes()
    path.write_bytes(whole.replace(b"\n27 ", b"\nnan ", 1))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert "invalid value encountered in cast" in _refused(path)


def test_data_that_end_before_their_count_are_refused(tmp_path, monkeypatch):
    def reader(_path):
        warnings.warn("string or file could not be read to its end due to unmatched data; this "
                      "will raise a ValueError in the future.", DeprecationWarning, stacklevel=1)

    monkeypatch.setattr(apart, "vtk_installed", lambda: False)
    reads(monkeypatch, "vtu", reader)
    (tmp_path / "mesh.vtu").write_text("")
    assert "could not be read to its end" in _refused(tmp_path / "mesh.vtu")


def test_what_other_threads_say_is_theirs(tmp_path, monkeypatch, capsys):
    path = _stored("mdpa", tmp_path)
    begun, said, known = threading.Event(), threading.Event(), files.read_file(path)

    def reader(_path, _name):
        begun.set()
        assert said.wait(20)
        sys.stdout.write("Warning: of the file\n")
        warnings.warn("of a number", UserWarning, stacklevel=1)
        return known

    def read():
        files.read_file(path)

    monkeypatch.setattr(reading, "_read", reader)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        other = threading.Thread(target=read)
        other.start()
        assert begun.wait(20)
        sys.stdout.write("of mine\n")
        sys.stderr.write("an error of mine\n")
        warnings.warn("a warning of mine", UserWarning, stacklevel=1)
        said.set()
        other.join()
    assert capsys.readouterr() == ("of mine\n", "an error of mine\n")
    assert [str(w.message) for w in caught] == [
        "a warning of mine", f"{path}: of the file", f"{path}: of a number"]
