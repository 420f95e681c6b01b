"""The filters inside pymeshlab: lists, parameters, errors, log, scripts, files."""

from __future__ import annotations

import inspect
import re
import signal
from pathlib import Path
from xml.etree import ElementTree

import contract
import meshio
import numpy as np
import pytest
import surface_meshes

import odt_plugins
from odt_plugins.adapters.pymeshlab_set import saved_script
from odt_plugins.cli import main as cli
from odt_plugins.errors import (
    InvalidMeshError,
    InvalidOptionError,
    MeshFileError,
    MissingDependencyError,
    NotFilledWarning,
    ODTError,
    UnsupportedMeshError,
)
from odt_plugins.hosts import pymeshlab_work
from odt_plugins.hosts.filter_table import FILTERS, RICH
from odt_plugins.processes import handling

pymeshlab = pytest.importorskip("pymeshlab")
odt_plugins.register("pymeshlab")

DATA = Path(__file__).parents[1] / "data"
MOVING = [name for name in FILTERS if name.startswith("apply_coord")]
ENTRY = '<filter name="{}">{}</filter>'


def flat(n=6, seed=3):
    points, faces, _ = contract.grid(2, n, seed)
    return pymeshlab.Mesh(np.column_stack([points, 0 * points[:, 0]]), faces)


def flat_set(**settings):
    meshes = pymeshlab.MeshSet(**settings)
    meshes.add_mesh(flat(), "plate")
    return meshes


def sphere():
    meshes = pymeshlab.MeshSet()
    meshes.create_sphere(radius=2.0, subdiv=2)
    return meshes


def script(tmp_path, *entries):
    file = tmp_path / "some.mlx"
    file.write_text(f"<!DOCTYPE FilterScript>\n<FilterScript>{''.join(entries)}</FilterScript>",
                    encoding="utf-8")
    return file


def heron(points, faces):
    """2 r/R of triangles, from area and sides."""
    x = points[faces]
    side = [np.linalg.norm(x[:, i] - x[:, i - 1], axis=1) for i in range(3)]
    area = 0.5 * np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1)
    return 16 * area**2 / (sum(side) * np.prod(side, axis=0))


def state(meshes):
    mesh = meshes.current_mesh()
    return mesh.vertex_matrix(), mesh.face_matrix()


def same(a, b):
    return all(np.array_equal(x, y) for x, y in zip(state(a), state(b), strict=True))


def test_the_filters_are_listed_and_documented(capfd):
    odt_plugins.register("pymeshlab")
    listed = pymeshlab.filter_list()
    assert listed == sorted(listed)
    assert len(listed) == len(set(listed)) > 200 + len(FILTERS)
    assert set(FILTERS) <= set(listed)
    pymeshlab.print_filter_list()
    pymeshlab.search("odt")
    out = capfd.readouterr().out
    assert out.count("apply_coord_odt_smoothing\n") == 2
    assert "apply_coord_taubin_smoothing" in out
    for name, chosen in FILTERS.items():
        method = getattr(pymeshlab.MeshSet, name)
        assert method.__name__ == name
        assert re.fullmatch(r"(apply|compute|meshing|generate)(_[a-z]+)+", name)
        names = [p.name for p in chosen.parameters]
        assert list(inspect.signature(method).parameters) == ["self", *names]
        pymeshlab.print_filter_parameter_list(name)
        out = capfd.readouterr().out
        for parameter in names:
            assert f"\t{parameter} : " in out
            assert f"\n{parameter} : " in method.__doc__
    pymeshlab.print_filter_parameter_list("apply_coord_taubin_smoothing")
    assert "lambda_ : float" in capfd.readouterr().out


@pytest.mark.parametrize("name", MOVING)
def test_method_and_apply_filter_do_the_same_for_the_options_they_stand_for(name):
    one, other = flat_set(), flat_set()
    result = getattr(one, name)(stepsmoothnum=4, density="uniform", keepquality=False)
    assert other.apply_filter(name, stepsmoothnum=4, density="uniform", keepquality=False) == result
    assert same(one, other)
    method = "cpt" if "cpt" in name else "odt"
    solver = "global" if "global" in name else "gauss-seidel"
    third = odt_plugins.optimize(
        flat(), method=method, finish=False, density="uniform", keep=(),
        smoothing={"rounds": 4, "solver": solver, "connectivity": "none"})
    assert np.array_equal(third.vertex_matrix(), one.current_mesh().vertex_matrix())
    moved = (flat().vertex_matrix() != third.vertex_matrix()).any(axis=1)
    assert result["moved_vertices"] == moved.sum() > 0
    assert result["mean_radius_ratio"] == odt_plugins.quality(third).mean_quality
    assert result["mean_radius_ratio_before"] == odt_plugins.quality(flat()).mean_quality


def test_optimization_flips_edges_and_says_how_many_faces_are_new():
    meshes = flat_set()
    result = meshes.meshing_odt_optimization()
    expected = odt_plugins.optimize(flat())
    assert np.array_equal(meshes.current_mesh().vertex_matrix(), expected.vertex_matrix())
    assert np.array_equal(meshes.current_mesh().face_matrix(), expected.face_matrix())
    old = {frozenset(f) for f in flat().face_matrix().tolist()}
    new = {frozenset(f) for f in expected.face_matrix().tolist()}
    assert result["new_faces"] == len(new - old) > 0


@pytest.mark.parametrize("change", [
    lambda meshes: meshes.meshing_odt_optimization(),
    lambda meshes: meshes.meshing_odt_remeshing(targetlen=pymeshlab.PureValue(0.1)),
    lambda meshes: meshes.apply_coord_odt_smoothing()])
def test_ctrl_c_waits_until_the_mesh_is_whole(change):
    class Watched(pymeshlab.MeshSet):
        stops = False

        def apply_filter(self, name, **given):
            if self.stops and name in ("compute_selection_by_edge_length",
                                       "compute_coord_linear_morphing"):
                signal.raise_signal(signal.SIGINT)
            return super().apply_filter(name, **given)

        def clear(self):
            super().clear()
            signal.raise_signal(signal.SIGINT)

    meshes, whole = Watched(), flat_set()
    meshes.add_mesh(flat(), "plate")
    meshes.stops = True
    # Gmsh, where it is in use, ends the process.
    with handling(signal.SIGINT, signal.default_int_handler), pytest.raises(KeyboardInterrupt):
        change(meshes)
    change(whole)
    assert meshes.mesh_number() == 1
    assert same(meshes, whole)


def test_regions_and_objective_are_parameters():
    """What messages advise can be followed."""
    _, faces, labels = contract.grid(2, 6, 3)
    meshes, plain = flat_set(), flat_set()
    for some in (meshes, plain):
        some.current_mesh().add_face_custom_scalar_attribute(labels.astype(float), "part")
    before = meshes.current_mesh().vertex_matrix()
    given = {"regions": "part", "objective": "min_dihedral"}
    expected = odt_plugins.optimize((before, faces), **{**given, "regions": labels})
    meshes.meshing_odt_optimization(**given)
    assert np.array_equal(meshes.current_mesh().vertex_matrix(), expected[0])
    assert np.array_equal(meshes.current_mesh().face_matrix(), expected[1])
    plain.meshing_odt_optimization()
    assert not same(meshes, plain)
    with pytest.raises(pymeshlab.PyMeshLabException, match="regions='none_such' names no"):
        plain.apply_coord_odt_smoothing(regions="none_such")
    with pytest.raises(pymeshlab.PyMeshLabException, match="regions: got 3; expected a str"):
        plain.apply_coord_odt_smoothing(regions=3)


def test_vertices_are_inserted_into_tetrahedra(monkeypatch):
    mesh = meshio.read(DATA / "tetwild_bunny.vtu")
    tets = mesh.points, mesh.cells[0].data
    monkeypatch.setattr(pymeshlab_work, "run_tetwild", lambda given: tets)
    monkeypatch.setattr(pymeshlab_work, "compare_with_surface", lambda *_: None)
    result = sphere().generate_odt_tetrahedralization(insert=True, objective="min_dihedral")
    (points, cells), report = odt_plugins.optimize_with_report(
        tets, insert=True, objective="min_dihedral")
    assert np.array_equal(result["tet_vertex_matrix"], points)
    assert np.array_equal(result["tet_matrix"], cells)
    assert result["vertices_added"] == report.counts["vertices added"]
    assert result["vertices_removed"] == report.counts["vertices removed"]
    assert result["vertices_added"] + result["vertices_removed"] > 0
    assert 0 < result["moved_vertices"] <= len(points) - result["vertices_added"]


def test_quality_is_kept_unless_told_otherwise():
    """The best place of this centre for the radius ratio is not where ODT sends it."""
    points = np.array([[0, 0, 0], [2, 0, 0], [2.4, 1, 0], [0, 1.3, 0], [0.95, 0.58, 0.0]])
    faces = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    worse = []
    for keep in (True, False):
        meshes = pymeshlab.MeshSet()
        meshes.add_mesh(pymeshlab.Mesh(points, faces))
        result = meshes.apply_coord_odt_smoothing(keepquality=keep, density="uniform")
        ratio = heron(meshes.current_mesh().vertex_matrix(), faces)
        assert result["min_radius_ratio"] == pytest.approx(ratio.min(), rel=1e-12)
        worse.append(ratio.min() < heron(points, faces).min() - 1e-6
                     or ratio.mean() < heron(points, faces).mean() - 1e-6)
    assert worse == [False, True]


def test_a_set_that_is_not_verbose_says_nothing(capfd):
    meshes = flat_set()
    capfd.readouterr()
    meshes.apply_coord_odt_smoothing()
    meshes.meshing_odt_optimization()
    meshes.compute_scalar_by_radius_ratio_per_face()
    assert capfd.readouterr() == ("", "")


def test_time_and_effect_appear_in_the_log(capfd):
    meshes = flat_set(verbose=True)
    meshes.apply_coord_taubin_smoothing(stepsmoothnum=1, selected=False)
    native = capfd.readouterr()
    result = meshes.apply_coord_odt_smoothing(stepsmoothnum=2)
    own = capfd.readouterr()
    pattern = r"\nApplying filter \w+ with the following parameters:\n\{'.*\}\n"
    assert re.match(pattern, native.out)
    assert re.match(pattern, own.out)
    assert "'stepsmoothnum': 2" in own.out
    for text, name in ((native.err, "taubin"), (own.err, "odt")):
        assert text.endswith(f"LOG: 2 apply_coord_{name}_smoothing applied!    [ 100% ]\n")
        assert re.search(r"^LOG: 2 Smoothed \d+ vertices$", text, re.MULTILINE)
    assert f"Smoothed {result['moved_vertices']} vertices" in own.err
    assert f"-> {result['min_radius_ratio']:.4f}, mean" in own.err
    assert re.search(r"Applied filter ODT Smoothing in \d+ msec", own.err)
    assert own.err.count("Applied filter") == 1
    assert "morph" not in (own.out + own.err).lower()
    meshes.apply_coord_taubin_smoothing(stepsmoothnum=1, selected=False)
    assert capfd.readouterr().err == native.err


@pytest.mark.parametrize(("given", "words"), [
    ({"steps": 2}, r"Parameter steps not found for filter apply_coord_odt_smoothing.*stepsmooth"),
    ({"stepsmoothnum": 2.5}, r"Parameter stepsmoothnum: got 2\.5; expected an int"),
    ({"stepsmoothnum": -1}, "got -1; expected an int of at least 0"),
    ({"selected": 1}, "Parameter selected: got 1; expected a bool"),
    ({"density": "even"}, "Enum 'even' not found. Possible values are 'keep'; 'uniform';"),
    ({"density": np.ones(3)}, "Enum '.*' not found"),
    ({"density": 4}, "Enum 4 not valid. Must be a value between 0 and 3"),
    ({"featuredeg": 0}, "featuredeg: got 0; expected a positive number"),
    ({"envelope": 0.1}, r"envelope: got 0\.1; expected a pymeshlab.PercentageValue"),
    ({"envelope": pymeshlab.PureValue(0.0)}, "envelope: got 0.0; expected a positive length"),
])
def test_wrong_parameters_are_named_in_the_words_of_meshlab(given, words):
    meshes = flat_set()
    host = pymeshlab.InvalidEnumException if "density" in given else pymeshlab.PyMeshLabException
    before = state(meshes)
    for call in (lambda: meshes.apply_coord_odt_smoothing(**given),
                 lambda: meshes.apply_filter("apply_coord_odt_smoothing", **given),
                 lambda: meshes.filter_parameter_values("apply_coord_odt_smoothing", **given)):
        with pytest.raises(host, match=words) as caught:
            call()
        assert isinstance(caught.value, InvalidOptionError)
    assert all(np.array_equal(a, b) for a, b in zip(before, state(meshes), strict=True))
    with pytest.raises(pymeshlab.PyMeshLabException, match="Filter does not exist"):
        meshes.apply_filter("apply_coord_odt")
    with pytest.raises(pymeshlab.PyMeshLabException, match="Filter does not exist"):
        meshes.filter_parameter_values("apply_coord_odt")


def test_choices_have_numbers_as_in_meshlab():
    meshes = flat_set()
    for i, choice in enumerate(("keep", "uniform", "inverse-volume")):
        values = meshes.filter_parameter_values("apply_coord_odt_smoothing", density=np.int64(i))
        assert values["density"] == choice
    with pytest.raises(pymeshlab.PyMeshLabException, match="got 0; expected an int of at least 1"):
        meshes.meshing_odt_optimization(iterations=0)


def test_lengths_are_percentages_or_pure_values_as_in_meshlab():
    meshes = flat_set()
    name = "generate_odt_tetrahedralization"
    diagonal = 2**0.5
    assert meshes.filter_parameter_values(name)["targetlen"] == pytest.approx(0.05 * diagonal)
    for value, length in ((pymeshlab.PercentageValue(10), 0.1 * diagonal),
                          (pymeshlab.PureValue(0.3), 0.3)):
        found = meshes.filter_parameter_values(name, maxsurfdist=value)
        assert found["maxsurfdist"] == pytest.approx(length)
    with pytest.raises(pymeshlab.PyMeshLabException, match=r"got 0\.3; expected a pymeshlab.Perc"):
        meshes.generate_odt_tetrahedralization(targetlen=0.3)
    with pytest.raises(pymeshlab.PyMeshLabException, match="expected a positive length"):
        meshes.generate_odt_tetrahedralization(targetlen=pymeshlab.PureValue(0.0))


def test_meshes_that_a_filter_cannot_take_are_named_in_the_words_of_meshlab():
    crossed = pymeshlab.Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 1]]),
                             np.array([[0, 1, 2], [0, 3, 2]]))
    double = pymeshlab.Mesh(np.eye(3), np.array([[0, 1, 2], [0, 1, 2]]))
    for mesh, words in ((None, "^[a-z_]+ requires at least one mesh loaded in the MeshSet.$"),
                        (pymeshlab.Mesh(np.eye(3)), "does not have any faces"),
                        (crossed, r"1 edge .*meshing_re_orient_faces_coherently"),
                        (double, "meshing_remove_duplicate_faces")):
        meshes = pymeshlab.MeshSet()
        if callable(mesh):
            meshes = sphere()
        elif mesh is not None:
            meshes.add_mesh(mesh)
        script = saved_script(meshes)
        for name in (*MOVING, "meshing_odt_optimization"):
            with pytest.raises(pymeshlab.PyMeshLabException, match=words) as caught:
                meshes.apply_filter(name)
            assert isinstance(caught.value, ODTError)
            assert name in str(caught.value)
        assert saved_script(meshes) == script
    with pytest.raises(UnsupportedMeshError):
        pymeshlab.MeshSet().apply_coord_odt_smoothing()


def test_the_boundary_of_a_planar_mesh_slides_along_itself():
    meshes = flat_set()
    area = meshes.get_geometric_measures()["surface_area"]
    for call in (meshes.apply_coord_odt_smoothing, meshes.meshing_odt_optimization):
        call(boundary=True)
        assert meshes.get_geometric_measures()["surface_area"] == pytest.approx(area, rel=1e-6)


@pytest.mark.parametrize("name", [*MOVING, "meshing_odt_optimization"])
def test_filters_work_on_curved_surfaces(name):
    p, t = surface_meshes.torus(40, 16, noise=0.5)
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(p, t), "ring")
    before = odt_plugins.quality(meshes)
    meshes.apply_filter(name, envelope=pymeshlab.PercentageValue(0.5))
    x, c = meshes.current_mesh().vertex_matrix(), meshes.current_mesh().face_matrix()
    after = odt_plugins.quality(meshes)
    assert after.mean_quality > before.mean_quality + (0.004 if "global" in name else 0.02)
    assert max(surface_meshes.two_sided(p, t, x, c, 2)) <= 5e-3 * surface_meshes.diagonal(p)
    assert (name == "meshing_odt_optimization") != np.array_equal(c, t)
    # MeshLab computes the normals of the result
    normal = np.cross(x[c[:, 1]] - x[c[:, 0]], x[c[:, 2]] - x[c[:, 0]])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    found = meshes.current_mesh().face_normal_matrix()
    found = found / np.linalg.norm(found, axis=1)[:, None]
    assert (found * normal).sum(axis=1).min() > 0.999


@pytest.fixture(scope="module")
def filled():
    meshes = sphere()
    meshes.set_matrix(transformmatrix=np.diag([1.0, 2.0, 1.0, 1.0]), freeze=False)
    before = state(meshes)
    result = meshes.generate_odt_tetrahedralization(
        targetlen=pymeshlab.PercentageValue(15), maxsurfdist=pymeshlab.PureValue(0.2),
        iterations=1)
    return meshes, before, result


def test_tetrahedra_fill_the_surface_and_their_boundary_is_a_new_mesh(filled):
    meshes, before, result = filled
    points, cells = result["tet_vertex_matrix"], result["tet_matrix"]
    volume = contract.volumes(points, cells) / 6
    assert (volume > 0).all()
    assert meshes.mesh_number() == 2
    assert meshes.current_mesh_id() == 1
    surface = meshes.current_mesh()
    assert surface.label() == f"{meshes.mesh(0).label()} tetrahedralization"
    assert np.array_equal(points[result["boundary_vertex_index"]], surface.vertex_matrix())
    faces = result["boundary_vertex_index"][surface.face_matrix()]
    rim = contract.facets(cells, np.zeros(len(cells), int))
    assert {tuple(sorted(f)) for f in faces.tolist()} == rim
    # By the divergence theorem, which holds only with all normals outwards.
    enclosed = np.linalg.det(points[faces]).sum() / 6
    assert enclosed == pytest.approx(volume.sum(), rel=1e-12)
    assert volume.sum() == pytest.approx(4 / 3 * np.pi * 8, rel=0.15)
    assert np.linalg.norm(surface.vertex_matrix(), axis=1) == pytest.approx(2.0, abs=0.3)
    assert np.array_equal(surface.transform_matrix(), np.diag([1.0, 2.0, 1.0, 1.0]))
    meshes.set_current_mesh(0)
    assert all(np.array_equal(a, b) for a, b in zip(before, state(meshes), strict=True))


def test_tetrahedra_are_better_than_those_of_tetwild(filled):
    *_, result = filled
    figures = odt_plugins.quality((result["tet_vertex_matrix"], result["tet_matrix"]))
    assert figures.mean_quality == result["mean_radius_ratio"]
    assert figures.min_quality == result["min_radius_ratio"] >= result["min_radius_ratio_before"]
    assert result["mean_radius_ratio"] > result["mean_radius_ratio_before"]


def test_no_tetrahedra_inside_a_flat_mesh():
    with pytest.raises(pymeshlab.PyMeshLabException, match=r"TetWild f.*meshing_close_h") as caught:
        flat_set().generate_odt_tetrahedralization(targetlen=pymeshlab.PercentageValue(30))
    assert isinstance(caught.value, InvalidMeshError)


def test_a_surface_that_tetrahedra_do_not_fill_is_named():
    meshes = sphere()
    meshes.compute_selection_by_condition_per_face(condselect="z0 > 1")
    meshes.meshing_remove_selected_faces()
    with pytest.warns(NotFilledWarning, match="boundary of the result stands for no face"):
        meshes.generate_odt_tetrahedralization(targetlen=pymeshlab.PercentageValue(15))


@pytest.mark.parametrize("name", [name for name in FILTERS if "radius_ratio" not in name])
def test_vertices_without_finite_coordinates_are_named(name):
    points, faces = (np.array(part) for part in state(flat_set()))
    points[3] = np.nan
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(points, faces))
    with pytest.raises(InvalidMeshError, match=r"1 vertex \(first: vertex 3\) with NaN"):
        meshes.apply_filter(name)


def test_vertices_of_no_face_change_no_lengths(monkeypatch):
    points, faces = state(sphere())
    calls = []
    for more in (0, 1):
        meshes = pymeshlab.MeshSet()
        stray = np.concatenate([points, np.full((more, 3), 99.0)])
        meshes.add_mesh(pymeshlab.Mesh(stray, faces))
        monkeypatch.setattr(
            pymeshlab_work, "remesh_with_report", lambda *_, **how: calls.append(how) or 1 / 0)
        with pytest.raises(ZeroDivisionError):
            meshes.meshing_odt_remeshing(maxsurfdist=pymeshlab.PureValue(0.1))
        monkeypatch.setattr(
            pymeshlab_work, "run_tetwild", lambda given: calls.append(given) or 1 / 0)
        with pytest.raises(ZeroDivisionError):
            meshes.generate_odt_tetrahedralization(targetlen=pymeshlab.PureValue(0.5))
    for one, other in zip(calls[:2], calls[2:], strict=True):
        assert repr(one) == repr(other)


def test_the_filter_script_of_a_set_holds_our_filters_and_runs_them(tmp_path):
    meshes = flat_set()
    meshes.apply_coord_taubin_smoothing(stepsmoothnum=1)
    meshes.apply_coord_odt_smoothing(stepsmoothnum=3, density="uniform", keepquality=False)
    meshes.meshing_surface_subdivision_midpoint(iterations=1)
    meshes.apply_coord_cpt_smoothing(stepsmoothnum=1)
    file = tmp_path / "made.mlx"
    meshes.save_filter_script(str(file))
    names = [entry.get("name") for entry in ElementTree.parse(file).getroot()]
    assert names == ["Taubin Smooth", "ODT Smoothing", "Subdivision Surfaces: Midpoint",
                     "CPT Smoothing"]
    again, loaded = flat_set(), flat_set()
    assert len(odt_plugins.run_filter_script(again, file)) == 4
    assert same(again, meshes)
    assert b"<filter " not in saved_script(again)
    loaded.load_filter_script(str(file))
    loaded.apply_filter_script()
    assert same(loaded, meshes)
    assert saved_script(loaded).count(b"<filter ") == 4
    loaded.clear_filter_script()
    native = script(tmp_path, ENTRY.format("Taubin Smooth", ""))
    loaded.load_filter_script(str(native))
    before = state(loaded)
    loaded.apply_filter_script()
    assert not np.array_equal(before[0], loaded.current_mesh().vertex_matrix())


@pytest.mark.parametrize(("name", "value"), [
    ("regions", "part"), ("regions", ""), ("objective", "amips"), ("density", "uniform"),
    ("keepquality", False), ("iterations", 3), ("featuredeg", 25.5), ("envelope", 0.125)])
def test_values_come_back_from_a_script_as_they_went_in(name, value):
    chosen = FILTERS["meshing_odt_optimization"]
    parameter = next(p for p in chosen.parameters if p.name == name)
    entry = parameter.to_script(value, 2.0)
    assert entry["type"] == RICH[parameter.kind]
    assert all(isinstance(text, str) for text in entry.values())
    assert parameter.from_script(entry) == value


def test_names_and_values_of_scripts(tmp_path):
    """Names as in menus or in Python, parameters in any case, and every kind of value."""
    length = '<Param name="TargetLen" type="{}" value="{}"/>'
    seen = []

    def work(meshes, values):
        seen.append(values)
        return pymeshlab_work.Effect({"n": len(seen)}, [])

    entries = [
        ENTRY.format("ODT Tetrahedralization", length.format("RichAbsPerc", "0.25")),
        ENTRY.format("generate_odt_tetrahedralization", length.format("RichPercentage", "25")),
        ENTRY.format("ODT Tetrahedralization", (
            '<Param name="DENSITY" type="RichEnum" value="1" enum_val0="keep"/>'
            '<Param name="keepquality" type="RichBool" value="false"/>'
            '<Param name="stepSmoothNum" type="RichInt" value="7"/>'
            '<Param name="Insert" type="RichBool" value="true"/>'
            '<Param name="Objective" type="RichEnum" value="1"/>')),
        ENTRY.format("ODT Tetrahedralization",
                     '<Param name="density" type="RichString" value="inverse-volume"/>'),
    ]
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(pymeshlab_work.WORK, "generate_odt_tetrahedralization", work)
        results = odt_plugins.run_filter_script(flat_set(), script(tmp_path, *entries))
    assert [r["n"] for r in results] == [1, 2, 3, 4]
    assert [v["targetlen"] for v in seen[:2]] == pytest.approx([0.25, 0.25 * 2**0.5])
    assert (seen[2]["density"], seen[2]["keepquality"], seen[2]["stepsmoothnum"]) == (
        "uniform", False, 7)
    assert (seen[2]["insert"], seen[2]["objective"]) == (True, "min_dihedral")
    assert (seen[3]["density"], seen[3]["insert"]) == ("inverse-volume", False)


@pytest.mark.parametrize(("entries", "error", "words"), [
    (["<filter"], MeshFileError, "is no filter script"),
    (["<filter/>"], MeshFileError, "<filter> without a filter"),
    (["<mesh/>"], MeshFileError, "<mesh> without a filter"),
    ([ENTRY.format("ODT Smoothing", '<Param name="steps" value="1"/>')], InvalidOptionError,
     "Parameter steps not found"),
    ([ENTRY.format("ODT Smoothing", '<Param name="stepSmoothNum" value="many"/>')],
     InvalidOptionError, "got 'many'; expected a value of type RichInt"),
    ([ENTRY.format("ODT Smoothing", '<Param name="Density" value="9"/>')],
     InvalidOptionError, "got '9'; expected a value of type RichEnum"),
    ([ENTRY.format("ODT Smoothing", '<Param name="Density" value="even"/>')],
     InvalidOptionError, "Enum 'even' not found"),
    ([ENTRY.format("ODT Smoothing", '<Param name="FeatureDeg" value="0"/>')],
     InvalidOptionError, "^ODT Smoothing, filter 2 of 2 in .*some.mlx: Parameter featuredeg: got"),
    ([ENTRY.format("ODT Smoothing", '<Param name="stepSmoothNum" value="-1"/>')],
     InvalidOptionError, "stepsmoothnum: got -1; expected an int of at least 0"),
    ([ENTRY.format("ODT Tetrahedralization", '<Param name="TargetLen" value="0"/>')],
     InvalidOptionError, r"targetlen: got 0\.0; expected a positive length"),
    ([ENTRY.format("ODT Tetrahedralization",
                   '<Param name="MaxSurfDist" type="RichPercentage" value="-2"/>')],
     InvalidOptionError, "maxsurfdist: Invalid percentage -- value must be between 0 and 100"),
])
def test_broken_scripts_change_nothing(tmp_path, entries, error, words):
    meshes = flat_set()
    good = ENTRY.format("Taubin Smooth", "")
    with pytest.raises(error, match=words):
        odt_plugins.run_filter_script(meshes, script(tmp_path, good, *entries))
    assert same(meshes, flat_set())


def test_other_errors_of_scripts_name_the_filter_and_its_place(tmp_path):
    with pytest.raises(MeshFileError, match=r"nowhere\.mlx: No such file"):
        odt_plugins.run_filter_script(flat_set(), tmp_path / "nowhere.mlx")
    (tmp_path / "other.mlx").write_text("<Project/>", encoding="utf-8")
    with pytest.raises(MeshFileError, match="its root is <Project>, expected <FilterScript>"):
        odt_plugins.run_filter_script(flat_set(), tmp_path / "other.mlx")
    meshes = flat_set()
    entries = [ENTRY.format("Taubin Smooth", ""), ENTRY.format("Sharpen & Shine", "").replace(
        "&", "&amp;")]
    with pytest.raises(InvalidMeshError, match="'Sharpen & Shine', filter 2 of 2 in"):
        odt_plugins.run_filter_script(meshes, script(tmp_path, *entries))
    assert not same(meshes, flat_set())
    assert b"<filter " not in saved_script(meshes)


@pytest.mark.parametrize(("name", "near"), [
    ("Taubin Smoth", r"'Taubin Smooth' \(apply_coord_taubin_smoothing in Python\)"),
    ("ODT Smothing", r"'ODT Smoothing' \(apply_coord_odt_smoothing in Python\)"),
    ("apply_coord_taubin_smoothing", r"'Taubin Smooth' \(apply_coord_taubin_smoothing"),
    ("Zzzz", "expected the name of a filter in MeshLab's menus$"),
])
def test_the_nearest_filter_is_named(tmp_path, name, near):
    with pytest.raises(InvalidMeshError, match=rf"^MeshLab has no filter '{name}', .*{near}"):
        odt_plugins.run_filter_script(flat_set(), script(tmp_path, ENTRY.format(name, "")))
    python = {"apply_coord_odt_smothing": "apply_coord_odt_smoothing",
              "apply_coord_taubin_smothing": "apply_coord_taubin_smoothing"}
    for wrong, right in python.items():
        with pytest.raises(pymeshlab.PyMeshLabException, match=rf"Did you mean {right}\?"):
            flat_set().apply_filter(wrong)


def test_scripts_that_would_crash_meshlab_are_refused(tmp_path):
    empty = pymeshlab.MeshSet()
    with pytest.raises(InvalidMeshError, match=r"Smooth requires at least one mesh .*1 of 1"):
        odt_plugins.run_filter_script(empty, script(tmp_path, ENTRY.format("Taubin Smooth", "")))
    made = [ENTRY.format("Sphere", ""), ENTRY.format("Taubin Smooth", "")]
    assert len(odt_plugins.run_filter_script(empty, script(tmp_path, *made))) == 2
    assert empty.mesh_number() == 1
    for value in ("7", "-1", "", "first"):
        other = f'<Param name="SampledMesh" type="RichMesh" value="{value}"/>'
        file = script(tmp_path, ENTRY.format("Hausdorff Distance", other))
        with pytest.raises(InvalidMeshError, match=f"SampledMesh is '{value}'; expected the id of"):
            odt_plugins.run_filter_script(flat_set(), file)


def test_ids_of_meshes_in_scripts_hold_after_flips(tmp_path):
    """Both meshes before and after: the distance is measured between those that are named."""
    pair = "".join(f'<Param name="{name}Mesh" type="RichMesh" value="{i}"/>'
                   for name, i in (("Sampled", 1), ("Target", 0)))
    meshes = flat_set()
    meshes.add_mesh(flat(seed=4), "other")
    odt_plugins.run_filter_script(meshes, script(
        tmp_path, ENTRY.format("ODT Optimization", ""), ENTRY.format("Hausdorff Distance", pair)))
    assert (meshes.mesh_number(), meshes.current_mesh_id()) == (2, 1)


def test_script_on_the_command_line(tmp_path, capsys):
    meshes = flat_set()
    meshes.compute_color_random_per_face()
    meshes.save_current_mesh(str(tmp_path / "in.ply"))
    file = script(tmp_path, ENTRY.format("Taubin Smooth", ""), ENTRY.format("ODT Smoothing", ""))
    names = [str(tmp_path / name) for name in ("some.mlx", "in.ply", "out.ply")]
    assert cli.main(["script", *names]) == 0
    out = capsys.readouterr().out
    assert re.search(r"Applied filter Taubin Smooth in \d+ msec\nSmoothed \d+ vertices\n", out)
    odt_plugins.run_filter_script(meshes, file)
    written = pymeshlab.MeshSet()
    written.load_new_mesh(names[2])
    assert written.current_mesh().vertex_matrix() == pytest.approx(
        meshes.current_mesh().vertex_matrix(), abs=1e-12)
    assert np.array_equal(written.current_mesh().face_color_array(),
                          meshes.current_mesh().face_color_array())
    assert cli.main(["script", *names, "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["in.ply", "out.ply", "some.mlx"]


def test_tetrahedra_of_a_script_go_into_a_file(tmp_path):
    sphere().save_current_mesh(str(tmp_path / "ball.ply"))
    length = '<Param name="TargetLen" type="RichPercentage" value="20"/>'
    error = '<Param name="MaxSurfDist" type="RichPercentage" value="4"/>'
    file = script(tmp_path, ENTRY.format("ODT Tetrahedralization", length + error))
    target = tmp_path / "ball.vtu"
    assert cli.main(["script", str(file), str(tmp_path / "ball.ply"), str(target), "--quiet"]) == 0
    figures = odt_plugins.quality(target)
    assert figures.volume == pytest.approx(4 / 3 * np.pi * 8, rel=0.25)
    assert figures.inverted == 0


def test_a_format_without_tetrahedra_is_refused_before_a_script_runs(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(pymeshlab_work, "run_tetwild", None)
    sphere().save_current_mesh(str(tmp_path / "ball.ply"))
    file = script(tmp_path, ENTRY.format("ODT Tetrahedralization", ""))
    words = ["script", str(file), str(tmp_path / "ball.ply"), str(tmp_path / "out.vtp")]
    assert cli.main(words) == 1
    assert "it holds no cells of type tetra" in capsys.readouterr().err


@pytest.mark.parametrize(("source", "target", "words"), [
    ("in.ply", "out.vtu", "MeshLab has no format '.vtu'.*or generate_odt_tetrahedralization"),
    ("in.ply", "no/such/out.ply", r"no/such/out.ply: \S*no/such is not a directory"),
    ("in.ply", "folder.ply", r"folder.ply is a directory; expected a path for a new file"),
    ("nowhere.ply", "out.ply", "it is missing"),
    ("some.mlx", "out.ply", "Unknown format for load"),
])
def test_files_that_cannot_be_read_or_written(tmp_path, capsys, source, target, words):
    flat_set().save_current_mesh(str(tmp_path / "in.ply"))
    file = script(tmp_path, ENTRY.format("Taubin Smooth", ""))
    (tmp_path / "folder.ply").mkdir()
    before = sorted(tmp_path.iterdir())
    assert cli.main(["script", str(file), str(tmp_path / source), str(tmp_path / target)]) == 1
    assert re.search(words, capsys.readouterr().err)
    assert sorted(tmp_path.iterdir()) == before


def test_scripts_without_pymeshlab(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("odt_plugins.errors.find_spec", lambda name: None)
    assert cli.main(["script", "a.mlx", "b.ply", "c.ply"]) == 1
    assert 'pip install "odt-plugins[pymeshlab]"' in capsys.readouterr().err
    monkeypatch.setattr("odt_plugins.errors.find_spec", lambda name: None)
    with pytest.raises(MissingDependencyError, match=r"odt-plugins\[pytetwild\]"):
        sphere().generate_odt_tetrahedralization()


def test_layers_that_a_filter_shall_improve_are_improved():
    base = {"stepsmoothnum": 1, "density": "keep", "keepquality": True}
    for given, free in (({}, ()), ({"freelayers": False}, ()), ({"freelayers": True}, "layers")):
        assert pymeshlab_work._options(base | given, 1.0).get("free", ()) == free
