"""From the file of a surface to tetrahedra: labels of faces on the boundary, report, levels."""

from __future__ import annotations

import json
import warnings

import contract
import meshio
import numpy as np
import pytest

import odt_plugins
from odt_plugins import tetwild
from odt_plugins.adapters import files
from odt_plugins.cli import main as cli
from odt_plugins.errors import InvalidMeshError, InvalidOptionError, NotFilledWarning, ODTWarning
from odt_plugins.generate import coarse, fill, odtmesh

CUBE = np.array([[x, y, z] for x in (0.0, 1) for y in (0.0, 1) for z in (0.0, 1)])
QUADS = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
FACES = np.array([t for a, b, c, d in QUADS for t in ((a, b, c), (a, c, d))], dtype=np.int32)
SIDE = np.repeat(np.arange(1, 7, dtype=np.int32), 2)
"""Number of the side of the cube for every face: 2 axis + 1 at 0, one more at 1."""


@pytest.fixture
def place(tmp_path, monkeypatch):
    """An empty directory, and TetWild replaced by a mesh of the cube."""
    points, cells, _ = contract.grid(3, 3)
    calls = []

    def made(given, *_):
        calls.append(given)
        return points.copy(), cells.astype(np.int32)

    for module in (tetwild, coarse):
        monkeypatch.setattr(module, "run_tetwild", made)
    monkeypatch.chdir(tmp_path)
    tmp_path.joinpath("calls").mkdir()
    return calls


def surface(keep=slice(None), **data):
    return meshio.Mesh(CUBE, [("triangle", FACES[keep])],
                       cell_data={name: [values[keep]] for name, values in data.items()})


def side_of(points, facets):
    """Side of the cube on which each facet lies, 0 for none."""
    x = points[facets]
    out = np.zeros(len(facets), dtype=int)
    for axis in range(3):
        for end in (0, 1):
            out[np.isclose(x[:, :, axis], end, atol=1e-6).all(axis=1)] = 2 * axis + 1 + end
    return out


@pytest.mark.parametrize("levels", ["0", "1"])
def test_labels_and_names_of_faces_come_to_the_boundary(place, capsys, levels):
    mesh = surface(**{"gmsh:physical": SIDE, "gmsh:geometrical": SIDE})
    mesh.field_data = {f"side{i}": np.array([i, 2]) for i in range(1, 7)}
    files.write_file("part.msh", mesh)
    assert cli.main(["tetrahedralize", "part.msh", "out.msh", "--edge-length", "0.3",
                     "--levels", levels, "--boundary", "fixed", "--report", "out.json"]) == 0
    out = files.read_file("out.msh")
    tets, facets = out.cells_dict["tetra"], out.cells_dict["triangle"]
    assert {tuple(sorted(row)) for row in facets.tolist()} == set(
        contract.facets(tets, np.zeros(len(tets), int)))
    label = out.cell_data_dict["gmsh:physical"]
    assert np.array_equal(label["triangle"], side_of(out.points, facets))
    assert set(label["triangle"]) == set(range(1, 7))
    assert set(label["tetra"]) == {1}
    assert {name: values.tolist() for name, values in out.field_data.items()} == {
        f"side{i}": [i, 2] for i in range(1, 7)}
    assert place[0]["edge_length_fac"] == 0.3
    with open("out.json") as file:
        told = json.load(file)
    assert told["before"]["n_cells"] == 6 * 3**3
    assert ("levels" in told) == (levels == "1")
    assert ("TetWild" in told.get("times", {})) == (levels == "0")
    assert "mean q" in capsys.readouterr().out


def test_what_stands_for_no_face_has_no_label(place):
    heat = SIDE + 0.5
    mesh = surface(slice(0, 10), side=SIDE, heat=heat, facet_normals=np.ones((12, 3)))
    mesh.write("open.vtu")
    with (
        pytest.warns(NotFilledWarning, match=r"16.4% of the boundary of the result stands for no"),
        pytest.warns(ODTWarning, match=r"18 of 108 triangles of the boundary stand for no face"),
    ):
        odt_plugins.tetrahedralize("open.vtu", target="out.vtu")
    out = files.read_file("out.vtu")
    truth = side_of(out.points, out.cells_dict["triangle"])
    truth[truth == 6] = 0
    side, heat = out.cell_data_dict["side"], out.cell_data_dict["heat"]
    assert np.array_equal(side["triangle"], truth)
    assert not side["tetra"].any()
    assert np.array_equal(heat["triangle"], np.where(truth, truth + 0.5, np.nan), equal_nan=True)
    assert np.isnan(heat["tetra"]).all()
    assert set(out.cell_data) == {"side", "heat"}


def test_sets_of_faces_become_sets_of_facets(place, monkeypatch):
    mesh = surface()
    mesh.cell_sets = {"left": [np.array([0, 1])], "top": [np.array([10, 11])]}
    monkeypatch.setattr(files, "read_file", lambda path: mesh)
    out, _, _ = fill.fill("part.inp", 0, 0.3, {})
    truth = side_of(out.points, out.cells[1].data)
    for name, side in (("left", 1), ("top", 6)):
        assert not len(out.cell_sets[name][0])
        assert np.array_equal(out.cell_sets[name][1], np.flatnonzero(truth == side))


def test_sets_with_sections_of_abaqus_are_kept_without_a_word_of_their_labels(place):
    mesh = surface()
    mesh.cell_sets = {f"side{i}": [np.flatnonzero(i == SIDE)] for i in range(1, 7)}
    files.write_file("part.inp", mesh)
    with open("part.inp", "a") as file:
        file.writelines(f"*SHELL SECTION, ELSET=side{i}, MATERIAL=m\n1.0\n" for i in range(1, 7))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        odt_plugins.tetrahedralize("part.inp", target="out.inp")
    assert not [w for w in caught if "abaqus:elset" in str(w.message)]
    out = files.read_file("out.inp")
    truth = side_of(out.points, out.cells[1].data)
    for i in range(1, 7):
        assert np.array_equal(out.cell_sets[f"side{i}"][1], np.flatnonzero(truth == i))


def test_a_surface_without_labels_gives_tetrahedra_alone(place):
    surface().write("part.stl")
    _, report = odt_plugins.tetrahedralize_with_report("part.stl", target="out.vtu",
                                                       smoothing={"rounds": 2},
                                             threads=1)
    assert set(files.read_file("out.vtu").cells_dict) == {"tetra"}
    assert report.options["smoothing"]["rounds"] == 2
    assert place[0]["num_threads"] == 1


@pytest.mark.parametrize("words", [
    "tetrahedralize part.stl part.stl", "tetrahedralize part.stl out.vtp", "mesh part.stl out.ply",
    "tetrahedralize part.stl out.glb", "mesh circle out.f3grid", "mesh part.stl out.obj",
    "batch part.stl --out . --tetrahedralize --suffix .off"])
def test_a_format_without_such_cells_is_refused_before_any_work(
    place, capsys, monkeypatch, words,
):
    monkeypatch.setattr(odtmesh, "odtmesh2d", lambda *given, **_: place.append(given))
    surface().write("part.stl")
    assert cli.main(words.split()) == 1
    said = capsys.readouterr().err
    assert "it holds no cells of type" in said or "cannot write a single mesh to out.glb" in said
    assert not place


def test_points_of_no_face_change_no_lengths(place):
    far = np.full((1, 3), 99.0)
    meshio.Mesh(np.concatenate([far, CUBE, far]), [("triangle", FACES + 1)]).write("part.vtu")
    odt_plugins.tetrahedralize("part.vtu", levels=0)
    np.testing.assert_array_equal(place[0]["vertices"], CUBE)
    np.testing.assert_array_equal(place[0]["faces"], FACES)


@pytest.mark.parametrize("levels", [0, 1])
@pytest.mark.parametrize("bulge", [0.0, 0.3])
def test_faces_that_are_curved_are_told(place, levels, bulge):
    pairs = np.sort(FACES[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, number = np.unique(pairs, axis=0, return_inverse=True)
    middle = CUBE[edges].mean(axis=1)
    points = np.concatenate([CUBE, middle + bulge * (middle - 0.5)])
    rows = np.concatenate([FACES, 8 + number.reshape(-1, 3)], axis=1)
    meshio.Mesh(points, [("triangle6", rows)]).write("part.vtu")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        odt_plugins.tetrahedralize("part.vtu", levels=levels)
    said = [str(w.message) for w in caught if "12 faces (first: face 0)" in str(w.message)]
    assert len(said) == (bulge > 0.0)
    assert all("up to 0.212 off the flat triangles" in words for words in said)


def test_curved_triangles_in_the_plane_are_refused_without_a_word_on_faces():
    points = np.array([[0.0, 0], [1, 0], [0, 1], [0.5, -0.2], [0.5, 0.5], [0, 0.5]])
    mesh = meshio.Mesh(points, [("triangle6", np.arange(6)[None])])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(odt_plugins.InvalidMeshError, match="in the plane"):
            odt_plugins.refine(mesh)


def test_each_part_of_a_thin_wall_takes_the_label_of_its_side():
    plate = CUBE * [1.0, 1.0, 0.01]
    points, cells, _ = contract.grid(3, 3)
    points = points * [1.0, 1.0, 0.01]
    facets = fill.boundary_facets(cells.astype(np.int32))
    face = fill.closest_faces(points, facets, (plate, FACES), 1e-3)
    on_z = np.isin(SIDE[face], (5, 6))
    assert on_z.sum() == 36
    assert np.array_equal(points[facets][on_z].mean(axis=1)[:, 2] > 0.005, SIDE[face][on_z] == 6)


@pytest.mark.parametrize(("boundary", "share"), [("fixed", 1.0), ("slide", 0.75)])
def test_tetwild_gets_its_part_of_the_envelope(place, boundary, share):
    surface().write("part.vtu")
    _, report = odt_plugins.tetrahedralize_with_report("part.vtu", target="out.vtu",
                                                       boundary=boundary, envelope=0.02,
                                                       smoothing={"rounds": 1})
    assert place[0]["epsilon"] == pytest.approx(share * 0.02)
    assert report.options["envelope"] == pytest.approx(0.02 if share == 1.0 else 0.005)


@pytest.mark.parametrize(("options", "sentence"), [
    ({"fixed": [0]}, "got fixed for a surface"), ({"regions": None}, "got regions for a surface"),
    ({"levels": -1}, "got levels=-1"),
    ({"edge_length": 2.0}, "got edge_length=2.0"), ({"levels": 1, "insert": True}, "insert=True"),
    ({"round": 3}, "try smoothing={'rounds'"),
])
def test_what_has_no_meaning_for_a_surface_is_refused_at_once(place, options, sentence):
    surface().write("part.vtu")
    with pytest.raises(InvalidOptionError, match=sentence):
        odt_plugins.tetrahedralize("part.vtu", target="out.vtu", **options)
    assert place == []


def test_what_does_not_come_to_tetrahedra_is_named(place):
    part = surface(side=SIDE)
    part.point_data = {"T": CUBE[:, 0], "Normals": CUBE}
    part.cells.append(meshio.CellBlock("line", np.array([[0, 1], [1, 3]])))
    part.cell_data["side"].append(np.zeros(2, dtype=np.int32))
    part.write("part.vtu")
    with pytest.warns(ODTWarning, match=r"^got point data 'T', 2 lines beside the faces of part"):
        found = odt_plugins.tetrahedralize("part.vtu", edge_length=0.3)
    assert list(found.cell_data) == ["side"]
    part.point_data = {"medit:ref": np.zeros(8), "Normals": CUBE}
    part.cell_data = {"gmsh:geometrical": part.cell_data["side"]}
    part.write("other.vtu")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        odt_plugins.tetrahedralize("other.vtu", edge_length=0.3)


def test_tetrahedra_are_refused_and_nothing_is_written(place, capsys):
    points, cells, _ = contract.grid(3, 1)
    meshio.Mesh(points, [("tetra", cells)]).write("tets.vtu")
    with pytest.raises(InvalidMeshError, match=r"^tets.vtu holds tetrahedra; expected a surface"):
        odt_plugins.tetrahedralize("tets.vtu", target="out.vtu")
    assert cli.main(["tetrahedralize", "tets.vtu", "out.vtu", "--fixed", "a"]) == 2
    assert "No such option" in capsys.readouterr().err
    assert cli.main(["tetrahedralize", "tets.vtu", "none/out.vtu"]) == 1
    assert "is not a directory" in capsys.readouterr().err
    with pytest.raises(InvalidOptionError, match="got levels=1 for meshes that are there"):
        cli.cli.main(["batch", "tets.vtu", "--out", "o", "--levels", "1"], standalone_mode=False)
    assert place == []


def test_the_report_of_arrays_tells_of_tetwild(place):
    mesh, report = odt_plugins.tetrahedralize_with_report(
        CUBE, FACES, edge_length_fac=0.3, vtk_ordering=True, smoothing={"rounds": 2})
    truth = odt_plugins.tetrahedralize(CUBE, FACES, edge_length_fac=0.3, vtk_ordering=True,
                                       smoothing={"rounds": 2})
    assert mesh[0].tobytes() == truth[0].tobytes()
    assert np.array_equal(mesh[1], truth[1])
    assert next(iter(report.times)) == "TetWild"
    assert report.after.mean_quality > report.before.mean_quality
    assert list(place[0]) == list(place[1])
    with pytest.raises(InvalidOptionError, match="of which there is no report; expected True"):
        odt_plugins.tetrahedralize_with_report(CUBE, FACES, odt=False)
    with pytest.raises(InvalidOptionError, match="did you mean 'edge_length_fac'"):
        odt_plugins.tetrahedralize_with_report(CUBE, FACES, edge_length_fax=0.3)


@pytest.mark.parametrize(("given", "said"), [
    ((CUBE, FACES, {"levels": 1}), r"got levels= with arrays; .* try odt_plugins.refine\("),
    ((CUBE, FACES, {"edge_length": 0.2}), r"edge_length= with arrays; .* mean 'edge_length_fac'"),
    ((CUBE, FACES, {"target": "out.vtu"}), "expected it with the path of a file$"),
    (("in.stl", None, {"edge_length_fac": 0.2}), "it with arrays, did you mean 'edge_length'"),
    (("in.stl", None, {"odt": False}), "got odt= with the path of a file; expected it with arrays"),
])
def test_keywords_of_files_and_of_arrays_are_told_apart(given, said):
    vertices, faces, keywords = given
    for call in (odt_plugins.tetrahedralize, odt_plugins.tetrahedralize_with_report):
        with pytest.raises(InvalidOptionError, match=said):
            call(vertices, faces, **keywords)
