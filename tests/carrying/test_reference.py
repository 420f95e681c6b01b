"""The envelope around a reference: repeated calls stay within it, whatever they did before."""

from __future__ import annotations

import numpy as np
import planar_meshes
import pytest
import pyvista
import surface_meshes
import tet_meshes
from click.testing import CliRunner

import odt_plugins
from odt_plugins.cli.main import cli
from odt_plugins.engine.cells.geometry import boundary_facets
from odt_plugins.errors import InvalidOptionError, UnsupportedMeshError
from odt_plugins.figures import radius_ratio


def skin(points, cells):
    return points, boundary_facets(cells) if cells.shape[1] == 4 else cells


def far(one, other):
    """Slow two-sided distance of two surfaces, as a part of the diagonal of the first."""
    surfaces = (*skin(*one), *skin(*other))
    return max(surface_meshes.two_sided(*surfaces, 4)) / surface_meshes.diagonal(one[0])


def test_repeated_calls_stay_in_one_envelope_where_they_would_add_up():
    start, envelope = tet_meshes.ball(100, 4), 1e-3
    mesh = free = start
    for call in range(2):
        mesh, report = odt_plugins.optimize_with_report(
            mesh, boundary="slide", envelope=envelope, reference=start)
        free = odt_plugins.optimize(free, boundary="slide", envelope=envelope)
        assert far(start, mesh) <= envelope
        assert any("away from its reference" in note for note in report.notes) == (call > 0)
    assert report.after.mean_quality > report.before.mean_quality
    assert far(start, free) > 1.5 * envelope


def test_a_mesh_is_its_own_reference():
    start = surface_meshes.sphere(2, noise=0.05)
    plain = odt_plugins.optimize(start, envelope=5e-3)
    same = odt_plugins.optimize(start, envelope=5e-3, reference=start)
    assert plain[0].tobytes() == same[0].tobytes()
    assert np.array_equal(plain[1], same[1])


@pytest.mark.parametrize("kind", ["tetrahedra", "surface", "plane"])
def test_remeshing_within_what_is_left(kind):
    start = {"tetrahedra": lambda: tet_meshes.ball(250, 4),
             "surface": lambda: surface_meshes.sphere(2, noise=0.02),
             "plane": lambda: planar_meshes.grid(3, holes=())}[kind]()
    start = tuple(start[:2])
    once = odt_plugins.optimize(start, boundary="slide", envelope=0.01)
    twice, report = odt_plugins.remesh_with_report(once, scale=1.3, envelope=0.02, reference=start)
    assert len(twice[1]) < len(start[1])
    assert report.notes
    if kind != "plane":
        assert far(start, twice) <= 0.02
    assert radius_ratio(*twice).min() > 0.0


def test_what_can_be_no_reference_is_refused(tmp_path):
    ball, sphere = tet_meshes.ball(100, 4), surface_meshes.sphere(1)
    with pytest.raises(InvalidOptionError, match="whose boundary stays; expected boundary='slide'"):
        odt_plugins.optimize(ball, reference=ball)
    with pytest.raises(InvalidOptionError, match="got a curved surface as reference= of tetrahed"):
        odt_plugins.optimize(ball, boundary="slide", reference=sphere)
    moved = ball[0] * 1.1, ball[1]
    with pytest.raises(InvalidOptionError, match=r"expected less than the envelope.*try envelope="):
        odt_plugins.optimize(moved, boundary="slide", reference=ball)
    with pytest.raises(UnsupportedMeshError):
        odt_plugins.optimize(sphere, reference=object())
    bowl = surface_meshes.bowl(6)
    closed = surface_meshes.cube(3)
    with pytest.raises(InvalidOptionError, match="without the rims or borders"):
        odt_plugins.optimize(bowl, reference=closed)
    grid = pyvista.MultiBlock([pyvista.UnstructuredGrid({10: ball[1]}, ball[0])])
    with pytest.raises(InvalidOptionError, match="several blocks; expected one mesh"):
        odt_plugins.optimize(grid, boundary="slide", reference=ball)
    with pytest.raises(InvalidOptionError, match="reference= for levels"):
        odt_plugins.refine(sphere, reference=sphere)


def test_a_soup_and_a_file_are_references(tmp_path):
    points, cells = surface_meshes.sphere(2, noise=0.05)
    path = tmp_path / "first.stl"
    pyvista.PolyData.from_regular_faces(points, cells).save(path)
    soup = points[cells].reshape(-1, 3), np.arange(3 * len(cells)).reshape(-1, 3)
    once = odt_plugins.optimize((points, cells), envelope=5e-3)
    for given in (soup, path):
        twice, report = odt_plugins.optimize_with_report(once, envelope=8e-3, reference=given)
        assert far((points, cells), twice) <= 8e-3
        assert "of the envelope" in str(report)
    assert report.to_dict()["options"]["reference"] == str(path)
    out = tmp_path / "out.vtu"
    start = tmp_path / "start.vtu"
    pyvista.PolyData.from_regular_faces(*once).cast_to_unstructured_grid().save(start)
    done = CliRunner().invoke(cli, ["optimize", str(start), str(out), "--envelope", "8e-3",
                                    "--reference", str(path)])
    assert done.exit_code == 0, done.output
    assert "away from its reference" in done.output
    done = CliRunner().invoke(cli, ["optimize", str(start), str(out), "--reference",
                                    str(tmp_path / "none.stl")])
    assert "none.stl: it is missing" in str(done.exception)
