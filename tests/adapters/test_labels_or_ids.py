"""Formats with one number for each cell get labels, not the ids or colours that come before."""

from __future__ import annotations

import warnings

import meshio
import numpy as np
import pytest
from contract import grid

from odt_plugins.adapters.files import read_file, write_file
from odt_plugins.errors import DataNotKeptWarning

LABELS = {".mesh": "medit:ref", ".bdf": "nastran:ref", ".vol": "netgen:index", ".ele": "tetgen:ref",
          ".avs": "avsucd:material", ".med": "cell_tags", ".e": "exodus:block"}


def labelled(labels, name):
    points, cells, _ = grid(3, 4, 1)
    m = len(cells)
    return meshio.Mesh(points, [("tetra", cells)], cell_data={
        "vtkOriginalCellIds": [np.arange(m)], "colour": [np.full(m, 7, dtype=np.uint8)],
        name: [np.where(points[cells].mean(axis=1)[:, 0] > 0.5, *labels)]})


@pytest.mark.parametrize("name", ["material", "where"])
@pytest.mark.parametrize("suffix", sorted(LABELS))
def test_labels_are_written_before_ids(suffix, name, tmp_path):
    mesh = labelled((5, 9), name)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataNotKeptWarning)
        write_file(tmp_path / f"a{suffix}", mesh)
    back = read_file(tmp_path / f"a{suffix}")
    found = np.abs(np.concatenate(back.cell_data[LABELS[suffix]]))
    places = np.concatenate([back.points[b.data].mean(axis=1)[:, 0] for b in back.cells])
    assert np.array_equal(found, np.where(places > 0.5, 5, 9))


def test_ids_are_no_blocks_of_exodus(tmp_path):
    mesh = labelled((5, 9), "material")
    del mesh.cell_data["material"], mesh.cell_data["colour"]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        write_file(tmp_path / "a.e", mesh)
    back = read_file(tmp_path / "a.e")
    assert len(back.cells) == 1
    ids = back.cell_data["vtkOriginalCellIds"]
    assert np.array_equal(ids, mesh.cell_data["vtkOriginalCellIds"])
