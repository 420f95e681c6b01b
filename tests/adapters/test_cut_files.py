"""Files that end early: refused in a sentence that says so, and nothing is written."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from labelled_meshes import mesh_with_everything

from odt_plugins.adapters.files import read_file, write_file
from odt_plugins.cli.main import main
from odt_plugins.errors import MeshFileError

SUFFIXES = (".e", ".med", ".vol", ".mesh", ".ply", ".off", ".stl", ".msh", ".vtu", ".vtk", ".vtp",
            ".bdf")
RAW = ("np.bytes_", "zip()", "reshape", "inhomogeneous", "Errno", "usecols", "index out of")
"""Words of Python and NumPy that say nothing about a file."""


def stored(suffix, folder):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        write_file(folder / f"a{suffix}", mesh_with_everything(2))
    return folder / f"a{suffix}"


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_cut_file_is_said_to_be_incomplete(suffix, tmp_path, capsys):
    path = stored(suffix, tmp_path)
    data = path.read_bytes()
    for part in (0.45, 0.8):
        path.write_bytes(data[: int(part * len(data))])
        with pytest.raises(MeshFileError, match="expected a complete file") as caught:
            read_file(path)
        assert "\n" not in str(caught.value)
        assert not [word for word in RAW if word in str(caught.value)]
    assert main(["optimize", str(path), str(tmp_path / f"b{suffix}")]) == 1
    said = capsys.readouterr()
    assert said.err.startswith("odt-plugins: cannot read")
    assert len(said.err.splitlines()) == 1
    assert not said.out
    assert [part.name for part in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("suffix", [".mesh", ".obj", ".off", ".inp", ".bdf", ".vol"])
def test_a_letter_in_place_of_a_digit_is_told_in_words_about_the_file(suffix, tmp_path):
    path = stored(suffix, tmp_path)
    data = path.read_bytes()
    rng = np.random.default_rng(0)
    digits = [k for k in range(len(data) // 3, len(data)) if data[k: k + 1].isdigit()]
    said = []
    for k in rng.choice(digits, 8):
        path.write_bytes(data[:k] + b"!" + data[k + 1:])
        try:
            read_file(path)
        except MeshFileError as exc:
            said.append(str(exc))
    assert said
    assert not [text for text in said for word in RAW if word in text]
