"""The command line: flags are those of Options, errors are one sentence, nothing half-written."""

from __future__ import annotations

import errno
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import textwrap
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

import meshio
import numba
import numpy as np
import pytest
import tet_meshes
from tangled_meshes import schoenhardt

from odt_plugins.cli import main as cli
from odt_plugins.cli import terminal
from odt_plugins.engine.run import plan
from odt_plugins.options import COMPILING, KEPT, OPTIONS, Options
from odt_plugins.progress import compiling_told

SQUARE = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1], [0.7, 0.8]])
FAN = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])


def square(**changes: Any) -> meshio.Mesh:
    points = np.column_stack([SQUARE, np.zeros(5)])
    data: dict[str, Any] = {
        "point_data": {"rho": np.linspace(1.0, 2.0, 5), "held": np.array([0, 0, 0, 0, 1]),
                       "flow": np.ones((5, 3))},
        "cell_data": {"size": [np.array([1.0, 2.0, 3.0, 4.0])], "pick": [np.array([1, 1, 0, 0])],
                      "part": [np.array([3, 3, 3, 3])]},
    }
    return meshio.Mesh(points, [("triangle", FAN)], **(data | changes))


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working directory with a square of four triangles in it."""
    square().write(tmp_path / "in.vtu")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def still(monkeypatch: pytest.MonkeyPatch) -> list[Options]:
    """An engine that moves nothing and notes what it was asked for."""
    asked: list[Options] = []

    def run(mesh: Any, options: Options, leaving: Any) -> plan.Outcome:
        asked.append(options)
        if options.progress:
            options.progress("smoothing", 0.5)
        return plan.Outcome(mesh.points.copy(), mesh.cells.copy(), mesh.regions.copy())

    monkeypatch.setattr(plan, "run", run)
    return asked


def flags() -> dict[str, Any]:
    return {p.name: p for p in cli.optimize.params}


def test_flags_are_the_fields_of_options_with_their_defaults() -> None:
    found = flags()
    named = {f.name for f in fields(Options)} - {"progress"}
    own = {"source", "target", "report_file", "plot_file", "quiet", "blocks", "block_rounds",
           "scheduler", "workers", "file_format", "text", "worth"}
    assert set(found) == named | own
    for field in fields(Options):
        if field.name == "progress":
            continue
        flag = found[field.name]
        assert flag.opts == ["--" + field.name.replace("_", "-")]
        other = {"keep": ",".join(KEPT), "free": "", "smoothing": ()}
        assert flag.default == other.get(field.name, field.default)
        assert flag.help


def test_choices_are_those_of_options() -> None:
    hints = get_type_hints(Options)
    choices = {name for name, hint in hints.items() if get_origin(hint) is Literal}
    assert choices == {"method", "objective", "boundary", "fields", "repair"}
    for name in choices:
        assert tuple(flags()[name].type.choices) == get_args(hints[name])
    assert choices == {name for name, about in OPTIONS.items() if about.metadata["choices"]}


def test_flags_say_what_the_options_mean(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["optimize", "--help"]) == 0
    text = "".join(capsys.readouterr().out.split())
    for about in OPTIONS.values():
        flag = about.metadata["flag"]
        said = "".join(f"{about.metadata['help']} {flag or ''}".split())
        assert (said in text) == (flag is not None) == (about.name != "progress"), about.name


def test_no_flag_given_means_the_defaults_of_options(place: Path, still: list[Options]) -> None:
    assert cli.main(["optimize", "in.vtu", "out.vtu"]) == 0
    assert [Options(**{**vars(o), "progress": None}) for o in still] == [Options()]


def test_every_flag_reaches_the_engine(place: Path, still: list[Options]) -> None:
    words = ("--method cpt --smoothing solver=global --smoothing linear_solver=direct "
             "--smoothing connectivity=flips --density keep --smoothing exponent=3.5 "
             "--smoothing rounds=7 --no-finish --boundary fixed --regions part "
             "--keep min_quality,max_angle --repair orient --threads 2")
    assert cli.main(["optimize", "in.vtu", "out.vtu", *words.split()]) == 0
    asked = still[0]
    assert asked == Options(
        method="cpt", finish=False, regions="part",
        smoothing={"solver": "global", "connectivity": "flips", "linear_solver": "direct",
                   "exponent": 3.5, "rounds": 7},
        keep=("min_quality", "max_angle"), repair="orient", threads=2)
    assert cli.main(["optimize", "in.vtu", "out.vtu", "--keep", "none", "--regions", "none"]) == 0
    assert still[1].keep == ()
    assert still[1].regions is None


def test_the_command_says_which_array_holds_the_regions(
    place: Path, still: list[Options], capsys: pytest.CaptureFixture[str]
) -> None:
    square(cell_data={"Material": [np.array([1, 1, 0, 0])]}).write("two.vtu")
    runs = (((), True), (("--regions", "Material"), True), (("--regions", "none"), False))
    for words, said in runs:
        assert cli.main(["optimize", "two.vtu", "out.vtu", *words]) == 0
        assert ("regions are those of 'Material'" in capsys.readouterr().out) == said


def test_names_of_arrays_and_files_of_indices(place: Path, still: list[Options]) -> None:
    Path("two.txt").write_text("4  # the inner vertex\n\n0\n")
    Path("marked.txt").write_text("4\r\n0\r\n", encoding="utf-8-sig", newline="")
    np.save("cells.npy", np.array([0, 3]))
    runs = (("--density", "rho"), ("--density", "size"), ("--fixed", "held"),
            ("--fixed", "two.txt"), ("--fixed", "marked.txt"), ("--selection", "pick"),
            ("--selection", "cells.npy"))
    for words in runs:
        assert cli.main(["optimize", "in.vtu", "out.vtu", *words]) == 0, words
    values = [o.density for o in still[:2]] + [o.fixed for o in still[2:5]] + \
        [o.selection for o in still[5:]]
    expected = [np.linspace(1, 2, 5), [1, 2, 3, 4], [False] * 4 + [True], [4, 0], [4, 0],
                [True, True, False, False], [0, 3]]
    for value, right in zip(values, expected, strict=True):
        assert np.array_equal(value, right)


def test_optimize_improves_a_file_keeps_its_data_and_reports(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = cli.main(["optimize", "in.vtu", "out.vtu", "--report", "r.json"])
    out, err = capsys.readouterr()
    assert (code, err) == (0, "")
    before, after = meshio.read("in.vtu"), meshio.read("out.vtu")
    assert np.array_equal(after.points[:4], before.points[:4])
    assert set(after.point_data) == set(before.point_data)
    assert set(after.cell_data) == set(before.cell_data)
    report = json.loads(Path("r.json").read_text())
    assert report["after"]["min_quality"] > report["before"]["min_quality"] + 0.1
    assert f"{report['after']['min_quality']:.4f}" in out


def test_plot_and_quiet(place: Path, still: list[Options],
                        capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("matplotlib")
    assert cli.main(["optimize", "in.vtu", "out.vtu", "--plot", "p.png", "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")
    assert Path("p.png").read_bytes().startswith(b"\x89PNG")
    assert sorted(p.name for p in place.iterdir()) == ["in.vtu", "out.vtu", "p.png"]


def test_a_figure_that_cannot_be_written_is_named_by_the_callers_path(
    place: Path, still: list[Options], capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    figure = pytest.importorskip("matplotlib.figure")

    def full(self: Any, path: str, **_: Any) -> None:
        raise OSError(28, "No space left on device", path)

    monkeypatch.setattr(figure.Figure, "savefig", full)
    words = ["optimize", "in.vtu", "out.vtu", "--quiet", "--plot", "p.png"]
    assert cli.main(words) == 1
    assert capsys.readouterr().err == \
        "odt-plugins: cannot write p.png: No space left on device; try another path\n"


def test_help_says_how_to_get_a_mesh_without_finishing(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert cli.main(["optimize", "--help"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "usually comes back unchanged" in text
    assert "--no-finish --keep none" in text


def test_a_file_may_be_improved_in_its_place(place: Path, still: list[Options]) -> None:
    assert cli.main(["optimize", "in.vtu", "in.vtu", "--quiet"]) == 0
    assert len(meshio.read("in.vtu").points) == 5


def test_what_a_format_drops_is_told_in_one_line(
    place: Path, still: list[Options], capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["optimize", "in.vtu", "out.off"]) == 0
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("odt-plugins: warning: out.off does not keep")
    assert cli.main(["optimize", "in.vtu", "out.off", "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")


def test_quality_prints_a_column_for_every_file(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    meshio.Mesh(
        np.eye(4, 3, k=-1), [("tetra", np.array([[0, 2, 1, 3]]))]).write("tet.vtu")
    assert cli.main(["quality", "in.vtu", "tet.vtu"]) == 0
    head = capsys.readouterr().out.splitlines()[0]
    assert head.split() == ["in.vtu", "tet.vtu"]
    assert cli.main(["quality", "in.vtu", "tet.vtu", "--json"]) == 0
    flat, solid = json.loads(capsys.readouterr().out)
    assert (flat["dim"], flat["n_cells"], flat["area"]) == (2, 4, pytest.approx(1.0))
    assert (solid["dim"], solid["inverted"]) == (3, 0)
    assert solid["min_quality"] == pytest.approx(3 / (3 + 3**0.5) / (3**0.5 / 2))


def test_turned_cells_are_counted_in_what_is_printed(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flipped = np.vstack([FAN[:3], FAN[3:, ::-1]])
    meshio.Mesh(SQUARE, [("triangle", flipped)]).write("flipped.vtu")
    assert cli.main(["optimize", "flipped.vtu", "out.vtu", "--report", "report.json"]) == 0
    assert re.search(r"(?m)^cells turned +1 +0$", capsys.readouterr().out)
    assert json.loads(Path("report.json").read_text())["before"]["turned"] == 1
    assert cli.main(["quality", "flipped.vtu", "out.vtu"]) == 0
    assert re.search(r"(?m)^cells turned +1 +0$", capsys.readouterr().out)
    assert cli.main(["quality", "out.vtu"]) == 0
    assert "turned" not in capsys.readouterr().out


def test_inverted_cells_are_untangled_alone_or_first_or_refused(
    place: Path, still: list[Options], capsys: pytest.CaptureFixture[str],
) -> None:
    square().write("rest.vtu")
    points = square().points.copy()
    points[4, 0] = 1.5
    meshio.Mesh(points, [("triangle", FAN)], cell_data={"size": [np.arange(4.0)]}).write("bad.vtu")
    for words in ("untangle bad.vtu out.vtu", "untangle bad.vtu out.vtu --rest rest.vtu",
                  "optimize bad.vtu out.vtu"):
        assert cli.main(words.split()) == 0
        assert re.search(r"(?m)^cells not positive +1 +0$", capsys.readouterr().out)
        out = meshio.read("out.vtu")
        assert np.array_equal(out.points[:4], points[:4])
        assert 0 < out.points[4, 0] < 1
        assert np.array_equal(out.cell_data["size"][0], np.arange(4.0))
    Path("out.vtu").unlink()
    assert cli.main("optimize bad.vtu out.vtu --repair none".split()) == 1
    assert "overlapping a neighbour" in capsys.readouterr().err
    points[[0, 1]] = points[[1, 0]]
    meshio.Mesh(points, [("triangle", FAN)]).write("bad.vtu")
    assert cli.main("untangle bad.vtu out.vtu".split()) == 1
    assert "inverted or flat cell" in capsys.readouterr().err
    assert not Path("out.vtu").exists()
    assert cli.main("untangle bad.vtu out.vtu --partial --quiet --report out.json".split()) == 0
    assert capsys.readouterr().out == ""
    assert Path("out.vtu").exists()
    told = json.loads(Path("out.json").read_text())["untangled"]
    assert told["left"] > 0


def test_untangling_inserts_vertices_when_told_and_shows_its_progress(
    place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:
    told: list[tuple[str, float]] = []

    @contextmanager
    def bar(quiet: bool) -> Iterator[Callable[[str, float], None]]:
        yield lambda stage, share: told.append((stage, share))

    monkeypatch.setattr(cli, "progress_bar", bar)
    points, cells = schoenhardt()
    meshio.Mesh(points, [("tetra", cells)]).write("bad.vtu")
    assert cli.main("untangle bad.vtu out.vtu".split()) == 1
    assert "try --insert, moving what holds them" in capsys.readouterr().err
    for words in ("out.vtu --insert 0.2", "--insert=0.2 out.vtu", "--no-insert out.vtu --insert"):
        assert cli.main(f"untangle bad.vtu {words}".split()) == 0
        assert "0 vertices moved, 1 added" in capsys.readouterr().out
        assert len(meshio.read("out.vtu").points) == 7
    assert cli.main("untangle bad.vtu --insert 0.2 7 out.vtu".split()) == 2
    assert "Got unexpected extra argument (out.vtu)" in capsys.readouterr().err
    assert told[-1][1] == 1.0
    assert any(stage == "untangling" for stage, _ in told)

    @contextmanager
    def stopped(quiet: bool) -> Iterator[Callable[[str, float], None]]:
        def stop(stage: str, share: float) -> None:
            if stage == "untangling":
                raise KeyboardInterrupt

        yield stop

    monkeypatch.setattr(cli, "progress_bar", stopped)
    Path("out.vtu").unlink()
    assert cli.main("untangle bad.vtu out.vtu --insert".split()) == 1
    assert "stopped before the end" in capsys.readouterr().err
    assert [path.name for path in Path().iterdir() if "out" in path.name] == []


def test_quality_goes_on_after_a_file_that_it_cannot_read(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    points = np.array([[0.0, 0, 0], [1, 0, 0], [np.nan, 1, 0]])
    meshio.Mesh(points, [("triangle", [[0, 1, 2]])]).write("nan.vtu")
    assert cli.main(["quality", "none.vtu", "nan.vtu", "in.vtu"]) == 1
    out, err = capsys.readouterr()
    assert "in.vtu" in out
    assert err.startswith("odt-plugins: cannot read none.vtu")
    assert "\nodt-plugins: nan.vtu: got 1 point (first: point 2) with NaN" in err


def broken_files(place: Path) -> None:
    """Files that every kind of bad input is read from."""
    whole = Path("in.vtu").read_bytes()
    Path("cut.vtu").write_bytes(whole[: len(whole) // 2])
    Path("text.vtu").write_text("no mesh at all\n")
    Path("folder.vtu").mkdir()
    inner = np.column_stack([SQUARE, np.zeros(5)])
    bent = np.vstack([inner, [[0.5, 0.5, 1.0]]])
    meshio.Mesh(bent, [("triangle", [[0, 1, 5], [1, 2, 5], [5, 3, 2]])]).write("mixed.vtu")
    meshio.Mesh(inner, [("triangle", np.vstack([FAN, [[0, 1, 1]]]))]).write("twice.vtu")
    meshio.Mesh(inner, [("triangle", np.vstack([FAN, FAN[:1]]))]).write("double.vtu")
    nan = inner.copy()
    nan[1, 0] = np.nan
    meshio.Mesh(nan, [("triangle", FAN)]).write("nan.vtu")
    meshio.Mesh(inner, [("quad", np.array([[0, 1, 2, 3]]))]).write("quad.vtu")
    square(point_data={"rho": np.array([1.0, 0, 1, 1, 1])}).write("zero.vtu")
    Path("words.txt").write_text("one two\n")
    Path("far.txt").write_text("77\n")
    Path("empty.txt").write_text("# none\n")
    Path("broken.npy").write_bytes(b"\x93NUMPY")


def contents(place: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() if p.is_file() else b"" for p in place.iterdir()}


@pytest.mark.parametrize(("text", "words"), [
    ("got 1 cell turned; try repair='orient'", "got 1 cell turned; try --repair orient"),
    ("got insert=False, finish=True", "got --no-insert, --finish"),
    ("got feature_angle=200.0; expected less", "got --feature-angle 200.0; expected less"),
    ("got boundary='slide' in the plane", "got --boundary slide in the plane"),
    ("no flag: axis=True, points.fixed=3, rho = h^-r",) * 2,
])
def test_errors_name_options_by_their_flags(text: str, words: str) -> None:
    assert cli.in_flags(text) == words


def test_every_command_says_what_it_is_for_in_one_whole_line(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert cli.main(["--help"]) == 0
    lines = capsys.readouterr().out.split("Commands:")[1].splitlines()
    assert len([line for line in lines if line.strip()]) == len(cli.cli.list_commands(None))
    assert all(line.endswith(".") and "..." not in line for line in lines if line.strip())


BAD = [
    # (words after odt-plugins, exit code, what the sentence says)
    ("frobnicate", 2, "No such command 'frobnicate'"),
    ("measure in.vtu", 2, "No such command 'measure'. Did you mean 'quality'?"),
    ("optimise in.vtu", 2, "No such command 'optimise'. Did you mean 'optimize'?"),
    ("optimize", 2, "Missing argument 'INPUT'"),
    ("optimize in.vtu", 2, "Missing argument 'OUTPUT'"),
    ("optimize in.vtu out.vtu --frob", 2, "No such option"),
    ("optimize in.vtu out.vtu --solver global", 2,
     r"'--solver', try --smoothing solver=\.\.\. \(see"),
    ("remesh in.vtu out.vtu --layers", 2,
     r"'--layers', try --free layers \(see odt-plugins remesh"),
    ("quality in.vtu --solver global", 2, r"'--solver' \(see"),
    ("optimize in.vtu out.vtu --boundry fixed", 2,
     r"'--boundry', did you mean --boundary\? \(see odt-plugins optimize"),
    ("optimize in.vtu out.vtu --envelop 1", 2, r"'--envelop', did you mean --envelope\? \("),
    ("optimize in.vtu out.vtu --selction x", 2, r"'--selction', did you mean --selection\? \("),
    ("optimize in.vtu out.vtu --feilds keep", 2, r"'--feilds', did you mean --fields\? \("),
    ("optimize in.vtu out.vtu --theads 1", 2, r"'--theads', did you mean --threads\? \("),
    ("optimize in.vtu out.vtu --no-finsh", 2, r"'--no-finsh', did you mean --no-finish\? \("),
    ("optimize in.vtu out.vtu --rounds 3", 2, r"'--rounds', try --smoothing rounds=\.\.\. \("),
    ("optimize in.vtu out.vtu --iterations 3", 2,
     r"'--iterations', try --smoothing rounds=\.\.\. \("),
    ("optimize in.vtu out.vtu --hsiz 3", 2, r"'--hsiz', try remesh \("),
    ("optimize in.vtu out.vtu --nr", 2, r"'--nr' \(see"),
    ("remesh in.vtu out.vtu --hsiz 3", 2, r"'--hsiz', did you mean --size\? \("),
    ("remesh in.vtu out.vtu --targetlen 3", 2, r"'--targetlen', did you mean --size\? \("),
    ("remesh in.vtu out.vtu --inside", 2,
     r"'--inside', and --free inside is for optimize alone \(see"),
    ("untangle in.vtu out.vtu --rounds 3", 2, r"'--rounds' \(see"),
    ("optimize in.vtu out.vtu --method best", 2, "'best' is not one of 'odt', 'cpt'"),
    ("optimize in.vtu out.vtu --smoothing rounds=many", 2,
     "got --smoothing rounds=many; expected an int"),
    ("optimize in.vtu out.vtu --smoothing rounds=-1", 2,
     "got --smoothing rounds=-1; expected an integer of"),
    ("optimize in.vtu out.vtu --threads 0", 2, "0 is not in the range x>=1"),
    ("optimize in.vtu out.vtu --smoothing exponent=-2", 2,
     "got --smoothing exponent=-2; expected a pos"),
    ("optimize in.vtu out.vtu --smoothing exponent=nan", 2,
     "got --smoothing exponent=nan; expected a p"),
    ("optimize in.vtu out.vtu --keep beauty", 2, "got 'beauty'; expected some of min_quality"),
    ("optimize in.vtu out.vtu --keep=", 2, "got no name; expected some of min_quality"),
    ("optimize in.vtu out.vtu --fixed empty.txt", 2, "empty.txt holds no index; expected at"),
    ("optimize in.vtu out.vtu --selection empty.txt", 2, "empty.txt holds no index; expected"),
    ("optimize in.vtu out.vtu --density nosuch", 2, "got 'nosuch'; expected the name of a point"),
    ("optimize in.vtu out.vtu --density flow", 2, r"array 'flow' has shape \(5, 3\)"),
    ("optimize in.vtu out.vtu --fixed nosuch", 2, "or a file of indices, it has rho"),
    ("optimize in.vtu out.vtu --fixed words.txt", 2, "cannot read indices from words.txt"),
    ("optimize in.vtu out.vtu --fixed broken.npy", 2, "cannot read indices from broken.npy"),
    ("optimize in.vtu out.vtu --fixed far.txt", 2, "77"),
    ("optimize in.vtu out.vtu --selection far.txt", 2, "77"),
    ("optimize in.vtu out.vtu --regions nosuch", 2, "--regions nosuch names no cell array"),
    ("optimize in.vtu out.vtu --plot p.bmp", 2, "expected a file ending in .png"),
    ("optimize in.vtu out.vtu --report out.vtu", 2, "OUTPUT and --report name the same"),
    ("optimize in.vtu out.vtu --report folder.vtu/../in.vtu", 2, "INPUT and --report name"),
    ("optimize zero.vtu out.vtu --density rho", 2, "density"),
    ("optimize in.vtu out.nosuch", 1, "out.nosuch has no suffix of a mesh file"),
    ("optimize in.vtu no/out.vtu", 1, "cannot write no/out.vtu"),
    ("optimize in.vtu folder.vtu", 1, "is a directory"),
    ("optimize in.vtu out.vtu --report no/r.json", 1, "cannot write no/r.json"),
    ("optimize in.vtu out.vtu --plot no/p.png", 1, "cannot write no/p.png"),
    ("optimize none.vtu out.vtu", 1, "cannot read none.vtu"),
    ("optimize folder.vtu out.vtu", 1, "cannot read folder.vtu"),
    ("optimize cut.vtu out.vtu", 1, "cannot read cut.vtu"),
    ("optimize text.vtu out.vtu", 1, "cannot read text.vtu"),
    ("optimize mixed.vtu out.vtu", 1, "try --repair orient$"),
    ("optimize twice.vtu out.vtu", 1, "cell 4"),
    ("optimize double.vtu out.vtu", 1, "cell"),
    ("optimize nan.vtu out.vtu", 1, "NaN"),
    ("optimize quad.vtu out.vtu", 1, "expected tetra or triangle"),
    ("quality", 2, "Missing argument 'INPUT...'"),
    ("quality text.vtu", 1, "cannot read text.vtu"),
    ("quality quad.vtu", 1, "expected tetra or triangle"),
    ("quality in.vtu --min-angle nan", 2, "got nan; expected a number"),
    ("demo --edge-length 0", 2, "0.0 is not in the range"),
    ("demo --out in.vtu", 1, "in.vtu"),
    ("compare none.vtu --out in.vtu", 1, "cannot write into in.vtu: .*; try another --out"),
    ("compare none.vtu --keep in.vtu/k", 1, "cannot write into in.vtu/k: .*; try another --keep"),
    ("batch in.vtu --out o --suffix vtu", 2, "got --suffix vtu; expected one with its dot"),
]


NEEDS = {"batch": ("jinja2", "pyarrow"), "compare": ("jinja2",), "demo": ("pytetwild",)}
"""What commands need before anything else can be wrong."""


@pytest.mark.parametrize(("words", "code", "says"), BAD, ids=[b[0] for b in BAD])
def test_an_error_is_one_clear_sentence_and_nothing_is_written(
    place: Path, capsys: pytest.CaptureFixture[str], words: str, code: int, says: str
) -> None:
    for tool in NEEDS.get(words.split()[0], ()):
        pytest.importorskip(tool)
    broken_files(place)
    there = contents(place)
    assert cli.main(words.split()) == code
    out, err = capsys.readouterr()
    assert out == ""
    (line,) = err.splitlines()
    assert line.startswith("odt-plugins: ")
    assert len(line) < 500
    assert "Traceback" not in line
    # The lowest version of click that is allowed names options without quotation marks.
    line = re.sub(r"(No such option: )(--[\w-]+)", r"\1'\2'", line)
    assert re.search(says, line), line
    assert contents(place) == there


def test_without_a_command_the_help_is_shown_as_wrong_use(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert cli.main([]) == 2
    assert "Usage: odt-plugins" in capsys.readouterr().err
    assert cli.main(["--help"]) == 0
    assert "optimize" in capsys.readouterr().out


def test_no_bar_in_a_pipe_and_one_on_a_terminal(
    place: Path, still: list[Options], capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    cli.main(["optimize", "in.vtu", "out.vtu"])
    assert still[-1].progress is None
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    cli.main(["optimize", "in.vtu", "out.vtu"])
    assert callable(still[-1].progress)
    assert "compiling" not in capsys.readouterr().err


def test_a_terminal_is_told_once_that_kernels_are_compiled(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
) -> None:
    def compile_one() -> None:
        with compiling_told():
            pass

    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    with terminal.progress_bar(quiet=False):
        numba.njit(lambda x: x)(1.0)
    assert "compiling" not in capsys.readouterr().err
    with terminal.progress_bar(quiet=False):
        compile_one()
        compile_one()
    assert capsys.readouterr().err.count("compiling the kernels, once") == 1
    with terminal.progress_bar(quiet=True):
        compile_one()
    compile_one()
    assert "compiling" not in capsys.readouterr().err
    with terminal.progress_bar(quiet=False) as progress:
        assert progress is not None
        progress(COMPILING, 0.0)
        progress(COMPILING, 0.0)
    assert capsys.readouterr().err.count("compiling the kernels, once") == 1


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_a_stopped_run_leaves_no_file_and_says_so(place: Path, name: str) -> None:
    script = textwrap.dedent("""
        import pathlib, signal, sys, time
        from odt_plugins.cli import main as cli
        from odt_plugins.engine.run import plan
        # a job of a shell's background inherits an ignored SIGINT
        signal.signal(signal.SIGINT, signal.default_int_handler)
        def run(mesh, options, leaving):
            pathlib.Path("started").touch()
            time.sleep(60)
        plan.run = run
        sys.exit(cli.main(["optimize", "in.vtu", "out.vtu", "--report", "r.json"]))
    """)
    with subprocess.Popen([sys.executable, "-c", script], stderr=subprocess.PIPE,
                          text=True) as job:
        try:
            for _ in range(600):
                if Path("started").exists() or job.poll() is not None:
                    break
                time.sleep(0.05)
            job.send_signal(getattr(signal, name))
            err = job.communicate(timeout=30)[1]
        finally:
            job.kill()
    assert job.returncode == 1
    assert err.split("\n")[-2] == \
        "odt-plugins: stopped before the end, no half-written file is left"
    assert "Traceback" not in err
    assert sorted(p.name for p in place.iterdir()) == ["in.vtu", "started"]


def test_a_run_stopped_while_libraries_are_loaded_says_so() -> None:
    script = textwrap.dedent("""
        import sys
        from odt_plugins.__main__ import start
        class Stopping:
            def find_spec(name, path=None, target=None):
                if name == "click":
                    raise KeyboardInterrupt
        sys.meta_path.insert(0, Stopping)
        sys.exit(start())
    """)
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True,
                          check=False)
    assert (done.returncode, done.stderr) == (1, "odt-plugins: stopped before it began\n")


COMPARED = """
import sys
from contestants import charts_unwritten, in_this_process
from odt_plugins.__main__ import start
sys.argv = ["odt-plugins", "compare", "in.vtu", "--against", "laplacian", "--repeats", "1",
            "--no-poisson"]
with in_this_process(), charts_unwritten():
    sys.exit(start())
"""


def test_characters_that_the_output_lacks_are_told_by_number(place):
    paths = os.pathsep.join(sys.path)
    done = subprocess.run(
        [sys.executable, "-c", COMPARED], capture_output=True, text=True, check=False,
        env=os.environ | {"PYTHONIOENCODING": "ascii", "PYTHONPATH": paths})
    assert done.returncode == 0, done.stderr
    assert "written: comparison" in done.stdout


@pytest.mark.skipif(sys.platform == "win32", reason="a shell of POSIX closes the streams")
@pytest.mark.parametrize("closed", ["2>&-", "<&- >&- 2>&-"])
def test_closed_streams_are_none_to_fail_at(place, closed):
    command = f'"{sys.executable}" -m odt_plugins optimize in.vtu out.vtu {closed}'
    assert subprocess.run(command, shell=True, check=False).returncode == 0
    assert (place / "out.vtu").is_file()


def test_a_reader_that_closes_the_pipe_gets_no_traceback(place: Path) -> None:
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run([sys.executable, "-m", "odt_plugins", "quality", "in.vtu"],
                          stdout=write, stderr=subprocess.PIPE, text=True, check=False)
    os.close(write)
    assert done.returncode == 1
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(("owner", "name", "number", "words"), [
    (Path, "write_bytes", errno.ENOSPC, os.strerror(errno.ENOSPC)),
    (Path, "write_bytes", errno.EDQUOT, os.strerror(errno.EDQUOT)),
    (tempfile, "gettempdir", errno.ENOENT, "No usable temporary directory found in ['/tmp']"),
])
def test_a_temporary_folder_without_room_is_told(
    place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], owner: Any,
    name: str, number: int, words: str,
) -> None:
    pytest.importorskip("pytetwild")

    def full(*_: Any) -> None:
        raise OSError(number, words)

    monkeypatch.setattr(owner, name, full)
    faces = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
    corners = np.vstack([np.zeros(3), np.eye(3)])
    meshio.write(place / "skin.vtu", meshio.Mesh(corners, [("triangle", np.array(faces))]))
    assert cli.main(["tetrahedralize", str(place / "skin.vtu"), str(place / "out.vtu")]) == 1
    said = capsys.readouterr().err
    assert said.startswith(f"odt-plugins: cannot write: {words}; try more room in")
    assert len(said.splitlines()) == 1


def test_help_is_quick_and_loads_neither_engine_nor_toolkits() -> None:
    script = ("import sys; from odt_plugins.cli.main import main;"
              "code = main(['optimize', '--help']);"
              "heavy = {'numba', 'scipy', 'meshio', 'pyvista', 'matplotlib'} & set(sys.modules);"
              "sys.exit(f'{code} {heavy}' if code or heavy else 0)")
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True,
                          check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert "--smoothing" in done.stdout


def test_a_usual_run_loads_no_room_for_other_meshes_and_options() -> None:
    script = ("import sys; import numpy as np; from scipy.spatial import Delaunay;"
              "from odt_plugins import optimize;"
              "points = np.random.default_rng(0).normal(size=(60, 3));"
              "points /= np.maximum(1.0, np.linalg.norm(points, axis=1))[:, None];"
              "optimize((points, Delaunay(points).simplices), threads=1);"
              "others = ('ground', 'sliding', 'surface', 'untangle', 'moves.insertion',"
              " 'moves.flips2d', 'odt.global_step');"
              "sys.exit(str([name for name in sys.modules"
              " if name.startswith(tuple('odt_plugins.engine.' + other for other in others))]))")
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True,
                          check=False)
    assert done.stderr.strip() == "[]"


def test_garbage_is_looked_for_rarely_and_not_at_the_end():
    code = """
import gc, sys
from odt_plugins import __main__
sys.argv = ["odt-plugins", "--version"]
__main__.start()
print(gc.get_threshold()[0] == __main__.RARELY, gc.get_freeze_count() > 1000)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "True True"


@pytest.mark.parametrize(("said", "flags"), [
    ("got size=-1.0; try scale=1", "got --size -1.0; try --scale 1"),
    ("smaller, see growth=; expected at most most_cells=20, try a larger most_cells=",
     "smaller, see --growth; expected at most --most-cells 20, try a larger --most-cells"),
    ("try repair='orient'.", "try --repair orient."), ("finish=False, or", "--no-finish, or"),
    ('boundary="slide" and insert=True', "--boundary slide and --insert"),
    ("got method='cpt'; try x", "got --method cpt; try x"),
    ("smoothing={'solver': 'jacobi'}; try x", "--smoothing solver=jacobi; try x"),
    ("try smoothing={'solver': ...}", "try --smoothing solver=..."),
    ("try keep=('min_quality', 'p1_quality')", "try --keep min_quality,p1_quality"),
    ("try keep=('min_quality',)", "try --keep min_quality"), ("keep=()", "--keep none"),
    ("got size='h p'; x", "got --size 'h p'; x"), ("got metric='p/rho'", "got --metric p/rho"),
    ("regions=('my part', 'b')", "--regions 'my part,b'"), ("size='0,2'", "--size 0,2"),
    ("regions=None", "--regions none"), ("envelope=0.002; q=3", "--envelope 0.002; q=3"),
    ("progress=True, my.keep=(1)", "progress=True, my.keep=(1)"),
    ("got h0=-1.0; try h0=0.2 or a larger most_points=",
     "got --size -1.0; try --size 0.2 or a larger --most-points"),
    ("got level=9; try a smaller level=", "got --levels 9; try a smaller --levels"),
    ("got file_format='gmsh41' for a.vtu", "got --file-format gmsh41 for a.vtu"),
    ("regions='' names no", "--regions '' names no"), ("got suffix='vtu'", "got --suffix vtu"),
    ("levels=1; expected tetrahedralize=True", "--levels 1; expected --tetrahedralize"),
    ("or untangle(mesh, partial=True) for", "or the command untangle with --partial for"),
])
def test_options_are_named_by_their_flags(said, flags):
    assert terminal.in_flags(said) == flags


def test_a_printed_report_names_flags(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    points, cells = tet_meshes.ball(150, 3)
    meshio.Mesh(points, [("tetra", cells)]).write("in.vtu")
    assert cli.main(["optimize", "in.vtu", "out.vtu", "--smoothing", "rounds=1", "--report",
                     "r.json"]) == 0
    said = capsys.readouterr().out
    assert "try --boundary slide" in said
    assert 'boundary="slide"' not in said
    with open("r.json") as file:
        assert 'boundary="slide"' in json.load(file)["binding"][0]["hint"]


@pytest.mark.parametrize(("words", "said"), [
    ("optimize ball.vtu o.vtu --envelope 0.01", "--envelope for tetrahedra whose boundary stays"),
    ("optimize ball.vtu o.vtu --feature-angle 30 --boundary fixed", "--boundary slide beside it"),
    ("optimize in.vtu o.vtu --envelope 0.01",
     "--envelope for triangles in the plane whose boundary stays"),
    ("optimize ball.vtu o.vtu --block-rounds 2", "expected --blocks beside it"),
    ("optimize ball.vtu o.vtu --smoothing omega=1.5 --smoothing solver=global",
     "expected none unless the solver is a"),
    ("optimize ball.vtu o.vtu --smoothing omega=4", "a number above 0 and at most 3"),
    ("optimize ball.vtu o.vtu --smoothing exponent=-1", "expected a positive number"),
    ("optimize ball.vtu o.vtu --smoothing omega=1.5 --method cvt",
     "expected none unless the solver is a"),
    ("tetrahedralize skin.vtu o.vtu --feature-angle 30", "--boundary slide or --levels"),
    ("batch ball.vtu --out o --edge-length 0.1", "expected --tetrahedralize beside it"),
    ("optimize ball.vtu o.e --ascii", "expected no choice, the format has only"),
    ("optimize ball.vtu o.e --file-format gmsh22", "expected one of gmsh22, gmsh41, for .msh"),
    ("optimize ball.vtu o.vtu --metric input --insert 0.3",
     "got --insert 0.3; expected --no-insert with a metric"),
    ("optimize ball.vtu o.vtu --metric input --insert --insert=0.3",
     "got --insert 0.3; expected --no-insert with a metric"),
    ("optimize ball.vtu o.vtu --insert=few", "'few' is not a valid float"),
    ("optimize ball.vtu o.vtu --no-finish --insert", "expected --no-insert without finishing"),
    ("optimize ball.vtu o.vtu --insert --smoothing connectivity=none",
     "got --insert; expected --no-insert with --smoothing connectivity=none"),
])
def test_flags_without_effect_are_refused(tmp_path, monkeypatch, capsys, words, said):
    monkeypatch.chdir(tmp_path)
    points, cells = tet_meshes.ball(60, 3)
    meshio.Mesh(points, [("tetra", cells)]).write("ball.vtu")
    square().write("in.vtu")
    meshio.Mesh(points[:4], [("triangle", [[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])]).write(
        "skin.vtu")
    assert cli.main(words.split()) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert said in lines[0]
    assert "None" not in lines[0]
    assert not Path("o.vtu").exists()


@pytest.mark.parametrize("words", [
    "ball.vtu o.vtu --envelope 0.01 --feature-angle 30 --boundary slide",
    "ball.vtu o.vtu --block-rounds 2 --blocks 2",
    "skin.vtu o.vtu --envelope 0.01 --repair orient",
    "ball.vtu o.vtu --repair orient",
])
def test_flags_with_an_effect_are_not(tmp_path, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    points, cells = tet_meshes.ball(60, 3)
    meshio.Mesh(points, [("tetra", cells)]).write("ball.vtu")
    meshio.Mesh(points[:4], [("triangle", [[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])]).write(
        "skin.vtu")
    assert cli.main(["optimize", *words.split(), "--smoothing", "rounds=1", "--quiet"]) == 0


def test_quality_is_a_gate(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    meshio.write("corner.vtu", meshio.Mesh(points, [("tetra", np.array([[0, 1, 2, 3]]))]))
    assert cli.main(["quality", "corner.vtu", "--min-quality", "0.7", "--min-angle", "54",
                     "--max-angle", "90.1"]) == 0
    assert not capsys.readouterr().err
    assert cli.main(["quality", "corner.vtu", "--min-quality", "0.8", "--max-angle", "89"]) == 3
    told = capsys.readouterr().err
    assert "corner.vtu has min_quality 0.7321, expected at least 0.8, max_angle 90" in told
    assert cli.main(["quality", "corner.vtu", "none.vtu", "--min-angle", "60"]) == 3
