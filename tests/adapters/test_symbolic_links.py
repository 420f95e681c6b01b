"""Outputs that are symbolic links: the file behind one is written, and the link stays."""

from __future__ import annotations

import os

import meshio
import numpy as np
import pytest
from contract import grid

from odt_plugins.adapters.files import read_file, write_file
from odt_plugins.cli.main import main
from odt_plugins.errors import MeshFileError


def mesh(scale):
    points, cells, _ = grid(3, 4, 1)
    return meshio.Mesh(points * scale, [("tetra", cells)], {"sol": points[:, 0] * scale})


@pytest.fixture
def places(tmp_path):
    for name in ("real", "links"):
        (tmp_path / name).mkdir()
    return tmp_path / "real", tmp_path / "links"


@pytest.mark.parametrize("there", [True, False])
@pytest.mark.parametrize(("suffix", "beside"), [
    (".vtu", ()), (".msh", ()), (".xdmf", (".h5",)), (".ele", (".node",)), (".mesh", (".sol",))])
@pytest.mark.filterwarnings("ignore::odt_plugins.errors.DataNotKeptWarning")
def test_the_file_behind_a_link_is_written_and_read(suffix, beside, there, places):
    real, links = places
    target, link = real / f"a.1{suffix}", links / f"b.1{suffix}"
    if there:
        write_file(target, mesh(1.0))
    link.symlink_to(os.path.relpath(target, links))
    write_file(link, mesh(3.0))
    assert link.is_symlink()
    assert [p.name for p in links.iterdir()] == [link.name]
    assert {p.name for p in real.iterdir()} == {target.name, *(f"a.1{end}" for end in beside)}
    for path in (link, target):
        back = read_file(path)
        assert back.points.max() == pytest.approx(3.0)
        if suffix != ".ele":
            assert np.max(back.point_data["sol"]) == pytest.approx(3.0)


def test_a_file_behind_a_link_may_have_another_suffix(places):
    real, links = places
    (links / "b.vtu").symlink_to(real / "run-7")
    write_file(links / "b.vtu", mesh(2.0))
    assert (links / "b.vtu").is_symlink()
    assert meshio.read(real / "run-7", "vtu").points.max() == read_file(
        links / "b.vtu").points.max() == 2.0


@pytest.mark.parametrize("name", ["run-0.5.xdmf", "run-0.5.XDMF", "run"])
def test_files_beside_the_one_behind_a_link_are_its_own(name, places):
    """Of a name with another point, or another suffix, those of the link's name were written."""
    real, links = places
    write_file(real / "last.xdmf", mesh(7.0))
    (links / "last.xdmf").symlink_to(real / name)
    write_file(links / "last.xdmf", mesh(2.0))
    assert read_file(real / "last.xdmf").points.max() == 7.0
    if name != "run":
        assert read_file(links / "last.xdmf").points.max() == 2.0
    assert meshio.read(real / name, "xdmf").points.max() == 2.0


@pytest.mark.filterwarnings("ignore::odt_plugins.errors.DataNotKeptWarning")
@pytest.mark.parametrize("kind", [".b8.ugrid", ".lb4.ugrid"])
def test_files_of_ugrid_behind_links_are_of_the_kind_of_the_link(kind, places):
    real, links = places
    (links / f"a{kind}").symlink_to(real / "run-0.5.b8.ugrid")
    write_file(links / f"a{kind}", mesh(2.0))
    assert read_file(links / f"a{kind}").points.max() == pytest.approx(2.0)


def test_a_link_into_no_directory_is_refused(places):
    real, links = places
    (links / "b.vtu").symlink_to(real / "gone" / "a.vtu")
    with pytest.raises(MeshFileError, match="gone is not a directory"):
        write_file(links / "b.vtu", mesh(2.0))
    assert (links / "b.vtu").is_symlink()


def test_a_report_goes_behind_its_link(places, capsys):
    real, links = places
    write_file(real / "in.vtu", mesh(1.0))
    for name in ("out.vtu", "report.json"):
        (links / name).symlink_to(real / name)
    words = [str(links / name) for name in ("out.vtu", "report.json")]
    assert main(["optimize", str(real / "in.vtu"), words[0], "--report", words[1]]) == 0
    assert {p.name for p in real.iterdir()} == {"in.vtu", "out.vtu", "report.json"}
    assert all(path.is_symlink() for path in links.iterdir())
    assert main(["optimize", str(real / "in.vtu"), words[0], "--report",
                 str(real / "out.vtu")]) == 2
    assert "name the same file" in capsys.readouterr().err
