"""Options of a batch that name an array of every input, or a file."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
from scipy.spatial import ConvexHull, Delaunay

from odt_plugins.adapters.files import write_file
from odt_plugins.cli.main import main
from odt_plugins.compare.start import ball
from odt_plugins.distributed.batch import find_inputs, job_key, make_jobs

pyarrow = pytest.importorskip("pyarrow")
pytest.importorskip("pyarrow.parquet")
pytest.importorskip("jinja2")


def written(path: Path, n: int = 80) -> meshio.Mesh:
    """A ball whose vertices of even number are held, with half of its cells picked."""
    start = ball(n)
    mesh = meshio.Mesh(
        start.points, [("tetra", start.cells)],
        {"held": (np.arange(len(start.points)) % 2 == 0) * 1, "rho": 1.0 + start.points[:, 0] ** 2},
        {"pick": [(np.arange(len(start.cells)) % 2) * 1]})
    write_file(path, mesh)
    return mesh


def batch(out: Path, *words: str) -> tuple[int, list[dict[str, str]]]:
    code = main(["batch", "*.vtu", "--out", str(out), "--quiet", *words])
    with (out / "summary.csv").open() as file:
        return code, list(csv.DictReader(file))


@pytest.mark.parametrize(("flags", "apart"), [
    (("--fixed", "held"), ("fixed", "held")),
    (("--fixed", "some.txt"), ("fixed", "some.txt")),
    (("--selection", "pick"), ("selection", "pick")),
    (("--density", "rho"), ("density", "rho")),
    (("--scale", "1.5", "--fixed", "held"), None),
])
def test_a_batch_takes_arrays_and_files_by_their_names(flags, apart, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    meshes = {name: written(tmp_path / name, n) for name, n in (("a.vtu", 80), ("b.vtu", 100))}
    (tmp_path / "some.txt").write_text("3 5 7 11")
    code, rows = batch(tmp_path / "out", *flags)
    assert (code, [row["status"] for row in rows]) == (0, ["ok", "ok"]), rows
    for name, mesh in meshes.items():
        found = meshio.read(tmp_path / "out" / name)
        if apart is not None:
            assert main(["optimize", name, "alone.vtu", "--quiet", *flags]) == 0
            alone = meshio.read("alone.vtu")
            assert np.array_equal(found.points, alone.points)
            assert np.array_equal(found.cells[0].data, alone.cells[0].data)
        if "held" in flags:
            held = mesh.points[mesh.point_data["held"] == 1]
            assert {tuple(x) for x in held} <= {tuple(x) for x in found.points}


@pytest.mark.parametrize(("flags", "said"), [
    (("--fixed", "nosuch"), "fixed: got 'nosuch'; expected the name of a point array of INPUT or a "
                            "file of indices, it has held (point), rho (point)"),
    (("--density", "nosuch"), "density: got 'nosuch'; expected the name of a point or cell array"),
])
def test_an_array_that_an_input_does_not_have_is_told_in_its_row(
        flags, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    written(tmp_path / "a.vtu")
    code, rows = batch(tmp_path / "out", *flags)
    assert (code, rows[0]["status"]) == (1, "failed")
    assert said in rows[0]["message"]


def key(path: str, **options: Any) -> str:
    """What names the one job of a batch."""
    (job,) = make_jobs([path], Path("out"), options)
    return job_key(job)


def test_what_is_done_is_done_anew_when_a_file_that_options_name_changes(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    written(tmp_path / "a.vtu")
    written(tmp_path / "other.vtu", 90)
    (tmp_path / "some.txt").write_text("3 5")
    before = [key("a.vtu", reference="other.vtu"), key("a.vtu", fixed="some.txt")]
    assert before == [key("a.vtu", reference="other.vtu"), key("a.vtu", fixed="some.txt")]
    written(tmp_path / "other.vtu", 100)
    (tmp_path / "some.txt").write_text("3 7")
    after = [key("a.vtu", reference="other.vtu"), key("a.vtu", fixed="some.txt")]
    assert len({*before, *after}) == 4


@pytest.mark.parametrize(("name", "beside"), [("a.xdmf", "a.h5"), ("a.mesh", "a.sol")])
def test_what_is_done_is_done_anew_when_a_file_beside_an_input_changes(
        name, beside, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    start = ball(60)
    write_file(tmp_path / name, meshio.Mesh(start.points, [("tetra", start.cells)]))
    (tmp_path / beside).touch()
    before = key(name)
    with (tmp_path / beside).open("ab") as file:
        file.write(b"more")
    assert key(name) != before


def test_rows_have_the_areas_of_triangles_and_no_column_stays_empty(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    written(tmp_path / "a.vtu")
    points = np.random.default_rng(4).random((60, 2))
    flat = np.pad(points, ((0, 0), (0, 1)))
    write_file(tmp_path / "b.vtu", meshio.Mesh(flat, [("triangle", Delaunay(points).simplices)]))
    code, rows = batch(tmp_path / "out")
    assert code == 0
    for when in ("before", "after"):
        assert [bool(row[f"{when}_volume"]) for row in rows] == [True, False]
        assert float(rows[1][f"{when}_area"]) == pytest.approx(ConvexHull(points).volume)
        assert not [name for name in rows[0] if name.startswith(f"{when}_")
                    and not any(row[name] for row in rows)]
    found = pyarrow.parquet.read_table(tmp_path / "out" / "summary.parquet").to_pylist()
    assert [str(row["after_area"] or "") for row in found] == [row["after_area"] for row in rows]
    assert [type(row["before_turned"]) for row in found] == [int, int]


def test_files_that_are_read_with_another_one_are_no_inputs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    start = ball(60)
    solution = {"sol": np.ones(len(start.points))}
    for name in ("a.mesh", "b.xdmf"):
        write_file(tmp_path / name, meshio.Mesh(start.points, [("tetra", start.cells)], solution))
    (tmp_path / "c.sol").touch()
    assert find_inputs(["*.*"]) == ["a.mesh", "b.xdmf", "c.sol"]
    assert find_inputs(["./a.sol", "c.sol", "a.mesh"]) == ["c.sol", "a.mesh"]
    assert find_inputs(["a.sol"]) == ["a.sol"]
    assert {path.name for path in tmp_path.iterdir()} == {"a.mesh", "a.sol", "b.xdmf", "b.h5",
                                                          "c.sol"}


def test_what_an_earlier_run_wrote_beside_a_result_goes_with_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    start = ball(60)
    mesh = meshio.Mesh(start.points, [("tetra", start.cells)], {"sol": np.ones(len(start.points))})
    write_file(tmp_path / "a.mesh", mesh)
    words = ["batch", "a.mesh", "--out", "out", "--quiet"]
    assert main(words) == 0
    (tmp_path / "out" / "a.txt").touch()
    assert (tmp_path / "out" / "a.sol").is_file()
    assert main([*words, "--metric", "none_of_it"]) == 1
    assert (tmp_path / "out" / "a.sol").is_file()
    assert main(words) == 0
    assert (tmp_path / "out" / "a.sol").is_file()
    (tmp_path / "a.sol").unlink()
    assert main(words) == 0
    assert not (tmp_path / "out" / "a.sol").exists()
    assert (tmp_path / "out" / "a.txt").is_file()
    assert (tmp_path / "out" / "a.mesh").is_file()
