"""Every example is run in an empty directory, one of its numbers is checked, nothing is left."""

from __future__ import annotations

import importlib.util
import itertools
import re
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import contract
import meshio
import numpy as np
import pytest
import surface_meshes as sm
from pictures import draw_small

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    """An empty working directory, in which only pictures that were asked for may be left."""
    monkeypatch.chdir(tmp_path)
    if find_spec("matplotlib"):
        draw_small(monkeypatch)
    yield tmp_path
    assert [p.name for p in tmp_path.iterdir() if p.suffix != ".png"] == []


def example(name):
    """Module of an example."""
    spec = importlib.util.spec_from_file_location(f"example_{name}", EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def colours(path):
    """Number of different colours in the left and in the right half of a picture."""
    from matplotlib.image import imread

    pixels = (imread(path)[:, :, :3] * 255).astype(int)
    half = pixels.shape[1] // 2
    return [len({tuple(c) for c in side.reshape(-1, 3)[::7].tolist()})
            for side in (pixels[:, :half], pixels[:, half:])]


def test_a_tetwild_mesh_is_improved():
    for name in ("pytetwild", "pyvista"):
        pytest.importorskip(name)
    report = example("tetwild_postprocess").main()
    assert report.after.mean_quality > report.before.mean_quality + 0.01
    assert report.after.min_quality >= report.before.min_quality
    assert report.after.min_angle >= report.before.min_angle
    assert report.fallback is None


def test_open3d_tetrahedra_are_improved_and_drawn(here):
    for name in ("open3d", "matplotlib"):
        pytest.importorskip(name)
    before, after = example("open3d_pipeline").main(here / "ball.png")
    assert before < 0.55
    assert after > 0.78
    assert min(colours(here / "ball.png")) > 50


def test_surfaces_are_measured_and_drawn(here, tmp_path_factory, capsys, monkeypatch):
    for name in ("pymeshlab", "matplotlib"):
        pytest.importorskip(name)
    pyvista = pytest.importorskip("pyvista")
    points, cells = sm.sphere(3, 0.2)
    # the first vertex a second time, as in files with seams
    cells[0][cells[0] == 0] = len(points)
    points = [*points, points[0]]
    path = tmp_path_factory.mktemp("obj") / "ball.obj"
    path.write_text("".join(f"v {x} {y} {z}\n" for x, y, z in np.array(points).tolist())
                    + "".join(f"f {a} {b} {c}\n" for a, b, c in (cells + 1).tolist()))
    surfaces = example("surfaces")
    monkeypatch.setattr(surfaces, "PEERS", ())
    found = surfaces.read(path)
    for suffix in ("stl", "ply", "vtp", "vtu", "off"):
        other = path.with_suffix(f".{suffix}")
        soup = meshio.Mesh(np.array(points), [("triangle", cells)])
        if suffix == "vtp":
            pyvista.PolyData.from_regular_faces(np.array(points), cells).save(other)
        else:
            soup.write(other)
        same = surfaces.read(other)
        assert len(same.points) == len(found.points), suffix
        assert np.linalg.norm(same.points, axis=1).sum() == pytest.approx(
            np.linalg.norm(found.points, axis=1).sum(), rel=1e-6)
        assert len(same.cells) == len(cells)
    square = path.with_name("square.obj")
    square.write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n")
    assert surfaces.read(square).cells.tolist() == [[0, 1, 2], [0, 2, 3]]
    surfaces.main([str(path), "--envelope", "4e-3", "--picture", str(here / "ball.png")])
    rows = [[w.strip() for w in line.split("|")] for line in capsys.readouterr().out.splitlines()]
    before, after = rows[2:]
    assert before[3] == after[3] == "642"
    assert float(after[4]) > float(before[4]) + 0.05
    assert 0 < max(float(after[8]), float(after[9])) <= 4.0
    assert min(colours(here / "ball.png")) > 50


def test_a_rotor_turns_and_no_cell_stays_inverted(here, capsys, monkeypatch):
    pytest.importorskip("matplotlib")
    monkeypatch.syspath_prepend(str(EXAMPLES))
    example("rotor").main(["--steps", "2", "--turn", "40", "--size", "0.15",
                           "--picture", str(here / "rotor.png")])
    steps = [line for line in capsys.readouterr().out.splitlines() if line.startswith("step")]
    assert len(steps) == 2
    assert all(re.search(r" [1-9]\d* cells inverted before, 0 after", line) for line in steps)
    assert min(colours(here / "rotor.png")) > 5


def test_a_sizing_field_is_kept():
    """TetWild makes another mesh every time; a few allow little at their worst cell."""
    for name in ("pytetwild", "pyvista"):
        pytest.importorskip(name)
    for _ in range(3):
        (plain, spread), (better, kept) = example("sizing_field").main().values()
        assert better >= plain
        assert spread < 0.27
        assert kept < spread + 0.01
        if better > plain + 0.005:
            break
    else:
        pytest.fail("no mesh gained anything")


def test_moved_vertices_alone_make_the_error_smaller(capsys, monkeypatch):
    pytest.importorskip("skfem")
    monkeypatch.syspath_prepend(str(EXAMPLES))
    done = example("r_adaptive").main(["--cells", "800", "--steps", "2"])
    assert len({solved.unknowns for solved in done}) == 1
    assert done[-1].error < 0.65 * done[0].error
    assert "with as many vertices" in capsys.readouterr().out


def test_odt_improves_what_meshlab_remeshed(capsys):
    pytest.importorskip("pymeshlab")
    scan, remeshed, best = example("meshlab_remesh").main(3.0)
    assert scan.n_cells > 3 * remeshed.n_cells
    assert best.n_cells == remeshed.n_cells
    for name in ("min_quality", "p1_quality", "mean_quality"):
        assert getattr(best, name) > getattr(remeshed, name)
    assert "| ODT behind it |" in capsys.readouterr().out


def test_adaptive_elements_reach_the_optimal_rate(here, capsys):
    for name in ("skfem", "matplotlib"):
        pytest.importorskip(name)
    adaptive = example("adaptive")
    adaptive.WAYS.pop("mmg")
    found = adaptive.main(["plane", "--cells", "1200", "--picture", str(here / "adaptive.png")])[2]
    best, plain = found["remesh"][-1], found["halved"][-1]
    assert adaptive.rate(found["remesh"]) > 0.48
    assert adaptive.rate(found["halved"], 2) < 0.36
    assert best.unknowns < plain.unknowns
    assert best.error < 0.6 * plain.error
    cold = adaptive.solve(best.mesh)
    assert cold.error == pytest.approx(best.error, rel=1e-5)
    assert best.steps < cold.steps
    assert "| plane | remesh |" in capsys.readouterr().out
    assert min(colours(here / "adaptive.png")) > 5


def test_pyvista_renders_without_a_window(here):
    """In a process of its own: a graphics driver that is missing ends it."""
    for name in ("pyvista", "matplotlib"):
        pytest.importorskip(name)
    picture = here / "picture.png"
    done = subprocess.run([sys.executable, str(EXAMPLES / "pyvista_before_after.py"), str(picture)],
                          capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    words = done.stdout.split()
    before, after = float(words[3]), float(words[5].rstrip(","))
    assert before < 0.55
    assert after > 0.78
    assert min(colours(picture)) > 50


def test_a_filter_script_mixes_the_filters():
    pytest.importorskip("pymeshlab")
    before, after = example("filter_script").main()
    assert before < 0.8
    assert after > 0.94


def test_a_scan_becomes_tetrahedra_inside_pymeshlab():
    for name in ("pymeshlab", "pytetwild"):
        pytest.importorskip(name)
    result = example("meshlab_pipeline").main()
    points, cells = result["tet_vertex_matrix"], result["tet_matrix"]
    assert (contract.volumes(points, cells) > 0).all()
    assert result["mean_radius_ratio"] > result["mean_radius_ratio_before"] + 0.01
    assert result["mean_radius_ratio"] > 0.77
    # The holes are closed: every edge of the boundary has an even number of faces.
    edges = np.sort(np.array([pair for face in contract.facets(cells, np.zeros(len(cells), int))
                              for pair in itertools.combinations(face, 2)]), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] % 2 == 0).all()


def test_a_coarse_mesh_becomes_a_fine_one(here, tmp_path_factory):
    for name in ("pymeshlab", "pytetwild", "pyvista"):
        pytest.importorskip(name)
    import meshio
    import surface_meshes

    points, faces = surface_meshes.sphere(2)
    surface = tmp_path_factory.mktemp("surface") / "open.vtu"
    meshio.write(surface, meshio.Mesh(points, [("triangle", faces[1:])]))
    small = {"surface": surface, "levels": 1, "envelope": 1e-2, "edge_length": 0.15}
    report, *seconds = example("refine_bunny").main(here / "levels.png", **small)
    assert report.within
    assert report.after.n_cells > 7 * report.levels[0].quality.n_cells
    assert report.after.mean_quality > 0.8
    assert min(seconds) > 0
    assert min(colours(here / "levels.png")) > 20


def test_batch_models(here):
    pytest.importorskip("pymeshlab")
    models = here / "models"
    count = example("batch_models").make_models(models, samples=["bone.ply"], lengths=[3.0, 5.0])
    assert count == 4
    sizes = [len(meshio.read(models / f"bone-{n}.stl").cells[0].data) for n in (30, 50)]
    assert 2.0 < sizes[0] / sizes[1] < 3.5
    shutil.rmtree(models)


def test_batch_models_for_tetwild(here):
    pytest.importorskip("pymeshlab")
    models = here / "solids"
    made = example("batch_models")
    assert len(made.SOLIDS) * len(made.COARSE) == 40
    assert made.make_models(models, samples=["bone.ply"], lengths=[6.0], solid=True) == 3
    assert 200 < len(meshio.read(models / "bone-60.stl").cells[0].data) < 600
    sheet = meshio.read(models / "poisoned.stl")
    assert np.ptp(sheet.points, axis=0).min() == 0.0
    assert len(sheet.cells[0].data) == 128
    shutil.rmtree(models)


@pytest.mark.parametrize("arguments", [["--", "--help"], ["mesh.vtu", "--", "-h"]])
def test_figures_show_the_help_of_the_command(capsys, arguments):
    with pytest.raises(SystemExit, match="0"):
        example("figures").main(arguments)
    assert capsys.readouterr().out.startswith("Usage: odt-plugins optimize")


def test_figures_need_a_mesh():
    for arguments in ([], ["--help"], ["--", "--smoothing", "cycles=2"]):
        with pytest.raises(SystemExit, match=r"usage: python examples/figures.py MESH"):
            example("figures").main(arguments)


def test_figures_of_a_mesh_are_a_table(capsys, tmp_path_factory):
    own = tmp_path_factory.mktemp("own") / "report.json"
    example("figures").main([str(EXAMPLES / "meshes" / "airfoil.vtu"), "--", "--smoothing",
                             "cycles=0",
                             "--report", str(own)])
    rows = [[w.strip() for w in line.split("|")] for line in capsys.readouterr().out.splitlines()]
    assert rows[2][1:4] == ["airfoil", "before", "0.8941"]
    assert rows[3][1:3] == ["airfoil", "after"]


def test_blocks_are_set_beside_one_piece(capsys):
    example("blocks").main(["--blocks", "2", "--orders", "1", "--least", "100",
                            str(EXAMPLES / "meshes" / "airfoil.vtu")])
    name, cells, mean, by, p1 = [w.strip() for w in
                                 capsys.readouterr().out.splitlines()[2].strip("|").split("|")]
    assert name == "airfoil"
    assert int(cells) > 100
    assert 0.9 < float(mean.split("..")[0]) < 1.0
    assert all(abs(float(value)) < 0.01 for column in (by, p1) for value in column.split(".."))


def test_meshes_are_generated_and_drawn(here):
    pytest.importorskip("matplotlib")
    found = example("generate_mesh").main(here / "generated.png")
    assert min(figures.min_quality for figures in found.values()) > 0.6
    assert min(figures.mean_quality for figures in found.values()) > 0.95
    assert min(colours(here / "generated.png")) > 50


def test_the_gallery_is_drawn(here, capsys):
    pytest.importorskip("matplotlib")
    example("gallery").main(["plane", "--folder", str(here)])
    assert capsys.readouterr().out.strip() == str(here / "plane.png")
    assert min(colours(here / "plane.png")) > 50
    assert (here / "plane.png").stat().st_size < 210_000


def test_a_job_of_ten_lines_is_run_drawn_and_measured(here, capsys, monkeypatch):
    pytest.importorskip("gmsh")
    monkeypatch.syspath_prepend(EXAMPLES)
    jobs = example("jobs")
    assert list(jobs.jobs()) == ["job_fem", "job_ngsolve", "job_gmsh", "job_meshlab", "job_open3d"]
    jobs.main(["job_gmsh", "--folder", str(here)])
    name, figure, before, after = [
        word.strip() for word in capsys.readouterr().out.splitlines()[-1].strip("|").split("|")]
    assert (name, figure) == ("job_gmsh", "least minSICN")
    assert float(after) > float(before) + 0.1
    assert min(colours(here / "job_gmsh.png")) > 50
