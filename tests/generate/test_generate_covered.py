"""A surface and the tetrahedra that fill it: what is missing, how bodies face, their labels."""

from __future__ import annotations

import itertools
import json

import meshio
import numpy as np
import pytest
import trimesh

import odt_plugins
from odt_plugins import tetwild
from odt_plugins.adapters import files
from odt_plugins.cli import main as cli
from odt_plugins.errors import InvalidOptionError, NotFilledWarning
from odt_plugins.generate import bodies, coarse, covered

CUBE = np.array([[x, y, z] for x in (0.0, 1) for y in (0.0, 1) for z in (0.0, 1)])
QUADS = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
FACES = np.array([t for a, b, c, d in QUADS for t in ((a, b, c), (a, c, d))], dtype=np.int32)


def boxes(*wanted):
    """One surface of cubes: (corner, edge, whether it faces outward)."""
    points = np.concatenate([np.asarray(low, float) + size * CUBE for low, size, _ in wanted])
    faces = [FACES[:, ::1 if out else -1] + 8 * i for i, (_, _, out) in enumerate(wanted)]
    return points, np.ascontiguousarray(np.concatenate(faces), dtype=np.int32)


def soup(points, faces):
    return points[faces].reshape(-1, 3), np.arange(3 * len(faces), dtype=np.int32).reshape(-1, 3)


def solid(*lows, n=3):
    """Tetrahedra of cubes of edge 1, apart from each other."""
    x = np.stack(np.meshgrid(*[np.linspace(0, 1, n + 1)] * 3, indexing="ij"), -1).reshape(-1, 3)
    step = np.array([(n + 1) ** 2, n + 1, 1])
    first = (np.stack(np.meshgrid(*[np.arange(n)] * 3, indexing="ij"), -1).reshape(-1, 3) @ step)
    t = np.concatenate([first[:, None] + [0, *np.cumsum(step[list(p)])]
                        for p in itertools.permutations(range(3))])
    size = np.linalg.det(x[t][:, 1:] - x[t][:, :1])
    t = np.where(size[:, None] > 0, t, t[:, [1, 0, 2, 3]])
    points = np.concatenate([x + np.asarray(low, float) for low in lows])
    cells = np.concatenate([t + i * len(x) for i in range(len(lows))]).astype(np.int32)
    return points, cells


def enclosed(points, faces):
    """Signed volume by the divergence theorem."""
    return np.linalg.det(points[faces]).sum() / 6


@pytest.fixture
def place(tmp_path, monkeypatch):
    """An empty directory, and TetWild replaced by what the test puts into the list."""
    calls, made = [], []

    def run(given, *_):
        calls.append(given)
        return made[0][0].copy(), made[0][1].copy()

    for module in (tetwild, coarse):
        monkeypatch.setattr(module, "run_tetwild", run)
    monkeypatch.chdir(tmp_path)
    return calls, made


@pytest.mark.parametrize("as_soup", [False, True])
def test_closed_components_face_outward_and_hollows_stay_hollow(as_soup):
    p, t = boxes(((0, 0, 0), 4, False), ((1, 1, 1), 1, True), ((9, 0, 0), 1, False),
                 ((6, 0, 0), 1, True))
    t[[3, 25]] = t[[3, 25]][:, ::-1]  # neighbours that disagree
    if as_soup:
        p, t = soup(p, t)
    turned = bodies.outward(p, t)
    out = np.where(turned[:, None], t[:, ::-1], t)
    sizes = [enclosed(p, out[12 * i:12 * i + 12]) for i in range(4)]
    assert sizes == pytest.approx([64, -1, 1, 1])


def test_what_cannot_face_outward_stays():
    strip = np.array([[np.cos(a) * (2 + w * np.cos(a / 2)), np.sin(a) * (2 + w * np.cos(a / 2)),
                       w * np.sin(a / 2)] for a in np.linspace(0, 2 * np.pi, 12, endpoint=False)
                      for w in (-1, 1)])
    faces = []
    for i in range(12):
        a, b, c, d = 2 * i, 2 * i + 1, (2 * i + 2) % 24, (2 * i + 3) % 24
        c, d = (d, c) if i == 11 else (c, d)
        faces += [(a, b, c), (b, d, c)]
    assert not bodies.outward(strip, np.array(faces, dtype=np.int32)).any()


def test_a_face_with_a_place_twice_does_not_open_a_body():
    p, t = boxes(((0, 0, 0), 1, False))
    flat = np.concatenate([t, np.array([[0, 0, 1]], dtype=np.int32)])
    turned = bodies.outward(p, flat)
    assert enclosed(p, np.where(turned[:, None], flat[:, ::-1], flat)[:12]) == pytest.approx(1)


def test_points_have_the_number_of_the_innermost_body():
    p, t = boxes(((5, 0, 0), 1, True), ((0, 0, 0), 4, True), ((1, 1, 1), 2, True),
                 ((1.5, 1.5, 1.5), 0.5, False))
    x = np.array([[5.5, 0.5, 0.5], [0.5, 0.5, 0.5], [1.2, 1.2, 1.2], [9, 9, 9], [4.05, 2, 2]])
    assert bodies.body_labels(x, p, t, 0.1).tolist() == [1, 2, 3, 0, 2]


@pytest.mark.parametrize("n", [1, 4])
def test_what_is_filled_is_filled(n):
    found = covered.compare(boxes(((0, 0, 0), 1, True)), solid((0, 0, 0), n=n), 1e-3)
    assert (found.missing, found.elsewhere, found.filled) == (0.0, 0.0, True)
    assert found.volume == pytest.approx(1)
    assert found.inside == pytest.approx(1)
    assert found.complaint() == ""


def test_a_body_that_is_gone_is_told_with_its_place():
    surface = boxes(((0, 0, 0), 1, True), ((3, 0, 0), 2, False))
    found = covered.compare(surface, solid((0, 0, 0)), 1e-3)
    assert found.missing == pytest.approx(4 / 5)
    assert found.elsewhere == 0.0
    assert found.inverted
    assert len(found.missing_at) == 1
    assert found.missing_at[0].low == pytest.approx([3, 0, 0], abs=0.1)
    assert found.missing_at[0].high == pytest.approx([5, 2, 2], abs=0.1)
    assert found.missing_at[0].share == pytest.approx(4 / 5)
    assert "80.0% of the area of the surface" in found.complaint()
    assert "repair='orient'" in found.complaint()
    assert json.loads(json.dumps(found.to_dict()))["missing_at"][0]["share"] == pytest.approx(0.8)


def test_a_hole_that_was_closed_is_told_with_its_place():
    p, t = boxes(((0, 0, 0), 1, True))
    found = covered.compare((p, t[:10]), solid((0, 0, 0)), 1e-3)
    assert found.missing == 0.0
    assert found.elsewhere == pytest.approx(1 / 6, rel=0.01)
    assert found.elsewhere_at[0].low[2] == found.elsewhere_at[0].high[2] == 1.0
    assert "try closing the holes" in found.complaint()


def test_a_hollow_that_was_filled_is_told_and_the_overlap_of_bodies_is_not():
    x, t = solid((0, 0, 0), n=4)
    hollow = boxes(((0, 0, 0), 1, True), ((0.25, 0.25, 0.25), 0.5, False))
    assert covered.compare(hollow, (x, t), 1e-3).missing == pytest.approx(0.2, rel=0.01)
    within = boxes(((0, 0, 0), 1, True), ((0.25, 0.25, 0.25), 0.5, True))
    assert covered.compare(within, (x, t), 1e-3).missing == 0.0
    middle = x[t].mean(axis=1)
    empty = t[~((middle > 0.25) & (middle < 0.75)).all(axis=1)]
    assert covered.compare(within, (x, empty), 1e-3).elsewhere == 0.0
    assert covered.compare(hollow, (x, empty), 1e-3).volume == pytest.approx(0.875)
    assert covered.compare(hollow, (x, empty), 1e-3).filled


def test_the_command_says_what_is_gone_and_ends_with_1(place, capsys):
    _, made = place
    made.append(solid((0, 0, 0)))
    surface = boxes(((0, 0, 0), 1, True), ((3, 0, 0), 1, False))
    meshio.Mesh(surface[0], [("triangle", surface[1])]).write("two.vtu")
    assert cli.main(["tetrahedralize", "two.vtu", "o.vtu", "--report", "o.json", "--quiet"]) == 1
    said = capsys.readouterr()
    assert said.out == ""
    assert len(said.err.splitlines()) == 1
    assert "o.vtu is written, but 50.0% of the area of the surface" in said.err
    assert "try --repair orient" in said.err
    assert set(files.read_file("o.vtu").cells_dict) == {"tetra"}
    with open("o.json") as file:
        told = json.load(file)["filled"]
    assert told["missing"] == pytest.approx(0.5)
    assert told["filled"] is False
    with pytest.warns(NotFilledWarning, match="repair='orient'"):
        _, report = odt_plugins.tetrahedralize_with_report("two.vtu", target="o.vtu")
    assert "filled 50.00% of the surface gone" in str(report)


@pytest.mark.parametrize("levels", ["0", "1"])
def test_orient_turns_the_surface_and_bodies_are_numbered(place, capsys, levels):
    calls, made = place
    made.append(solid((0, 0, 0), (3, 0, 0)))
    surface = boxes(((3, 0, 0), 1, False), ((0, 0, 0), 1, True))
    meshio.Mesh(surface[0], [("triangle", surface[1])],
                cell_data={"side": [np.arange(24)]}).write("two.vtu")
    assert cli.main(["tetrahedralize", "two.vtu", "o.vtu", "--repair", "orient", "--bodies",
                     "--quiet", "--levels", levels, "--boundary", "fixed"]) == 0
    assert capsys.readouterr().err == ""
    assert enclosed(calls[0]["vertices"], calls[0]["faces"]) == pytest.approx(2)
    out = files.read_file("o.vtu")
    body = out.cell_data_dict["body"]
    middle = out.points[out.cells_dict["tetra"]].mean(axis=1)
    assert np.array_equal(body["tetra"], np.where(middle[:, 0] > 2, 1, 2))
    assert not body["triangle"].any()
    side = out.cell_data_dict["side"]["triangle"]
    assert set(side) == set(range(24))


def test_bodies_within_each_other_keep_what_lies_between(place):
    _, made = place
    made.append(solid((0, 0, 0), n=4))
    surface = boxes(((0, 0, 0), 1, True), ((0.25, 0.25, 0.25), 0.5, True))
    meshio.Mesh(surface[0], [("triangle", surface[1])]).write("core.vtu")
    odt_plugins.tetrahedralize("core.vtu", target="o.vtu", bodies=True)
    out = files.read_file("o.vtu")
    inner = out.cells_dict["tetra"][out.cell_data_dict["body"]["tetra"] == 2]
    corner = out.points[inner]
    size = np.abs(np.linalg.det(corner[:, 1:] - corner[:, :1])).sum() / 6
    assert size == pytest.approx(0.125, rel=1e-12)
    assert corner.min() == 0.25
    assert corner.max() == 0.75


def test_faces_between_bodies_come_with_their_labels(place, capsys):
    """The inner cube has sides 7 to 12, and is the second body."""
    _, made = place
    made.append(solid((0, 0, 0), n=4))
    surface = boxes(((0, 0, 0), 1, True), ((0.25, 0.25, 0.25), 0.5, True))
    side = np.repeat(np.arange(1, 13), 2)
    meshio.Mesh(surface[0], [("triangle", surface[1])], cell_data={
        "gmsh:physical": [side], "gmsh:geometrical": [side]}).write("core.msh", "gmsh22")
    command = ["tetrahedralize", "core.msh", "o.msh"]
    assert cli.main([*command, "--bodies"]) == 0
    assert capsys.readouterr().err == ""
    out = files.read_file("o.msh")
    label, x = out.cell_data_dict["gmsh:physical"], out.points
    corners = x[out.cells_dict["tetra"]]
    middle = corners.mean(axis=1)
    core = ((middle > 0.25) & (middle < 0.75)).all(axis=1)
    assert np.array_equal(label["tetra"], np.where(core, 2, 1))
    rows = out.cells_dict["triangle"]
    inner = label["triangle"] > 6
    assert len({tuple(row) for row in np.sort(rows, axis=1).tolist()}) == len(rows)
    for of_cells, of_faces in ((slice(None), ~inner), (core, inner)):
        size = np.abs(np.linalg.det(corners[of_cells][:, 1:] - corners[of_cells][:, :1])).sum() / 6
        assert enclosed(x, rows[of_faces]) == pytest.approx(size)
    assert set(label["triangle"]) == set(range(1, 13))
    assert cli.main(command) == 0
    said = capsys.readouterr().err
    assert "12 of 24 faces of the surface have no triangle beside them" in said
    assert "try --bodies" in said
    made.append(solid((0, 0, 0), n=4))
    assert cli.main([*command, "--bodies", "--levels", "1", "--boundary", "fixed"]) == 0
    said = capsys.readouterr().err
    assert "12 of 24 faces of the surface have no triangle beside them" in said
    assert "--bodies" not in said


def test_an_array_of_that_name_is_not_replaced(place):
    calls, _ = place
    meshio.Mesh(CUBE, [("triangle", FACES)], cell_data={"body": [np.arange(12)]}).write("a.vtu")
    with pytest.raises(InvalidOptionError, match="got bodies=True for faces that have an array"):
        odt_plugins.tetrahedralize("a.vtu", target="o.vtu", bodies=True)
    assert calls == []


def test_tetwild_fills_a_body_that_was_inside_out(tmp_path, monkeypatch):
    pytest.importorskip("pytetwild")
    monkeypatch.chdir(tmp_path)
    surface = boxes(((0, 0, 0), 1, True), ((3, 0, 0), 1, False))
    meshio.Mesh(surface[0], [("triangle", surface[1])]).write("two.off")
    plain = ["tetrahedralize", "two.off", "o.vtu", "--edge-length", "0.1", "--quiet"]
    assert cli.main(plain) == 1
    assert cli.main([*plain, "--repair", "orient"]) == 0
    out = files.read_file("o.vtu")
    corner = out.points[out.cells_dict["tetra"]]
    size = np.abs(np.linalg.det(corner[:, 1:] - corner[:, :1])).sum() / 6
    assert size == pytest.approx(2, rel=0.02)


@pytest.mark.parametrize("shift", [(1, 0, 0), (1, 0.5, 0), (1, 1, 0), (1, 1, 1)])
def test_solids_that_touch_are_bodies_of_their_own(shift):
    one = trimesh.creation.box((1, 1, 1)).subdivide()
    other = one.copy()
    other.apply_translation(shift)
    both = trimesh.util.concatenate([one, other])
    both.merge_vertices()
    turn = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    turn[:, 0] *= np.linalg.det(turn)
    points, faces = np.array(both.vertices), np.array(both.faces, dtype=np.int32)
    found = bodies.find_bodies(points @ turn.T, faces)
    assert found.closed.tolist() == [True, True]
    assert found.volume == pytest.approx([1, 1])
    x = np.array([[0.1, 0.1, 0.1], shift, [2.9, 0, 0]])
    assert bodies.body_labels(x, points, faces, 1e-3).tolist() == [1, 2, 0]


def test_places_far_from_the_origin_are_told_within_the_surface():
    points, cells = solid((0, 0, 0))
    surface = boxes(((0, 0, 0), 1, True), ((3, 0, 0), 1, True))
    away = np.array([1e6, 0.0, 0.0])
    found = covered.compare(
        (surface[0] + away, surface[1]), (points + away, cells), 0.01).complaint()
    assert "(x 1000003..1000004 y" in found
