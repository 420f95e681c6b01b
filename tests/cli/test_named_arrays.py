"""Arrays that flags name: what tells of no vertices and cells is refused in one sentence."""

from __future__ import annotations

import meshio
import numpy as np
import pytest

from odt_plugins.adapters.files import write_file
from odt_plugins.cli.main import main

BAD = {
    "text": (lambda k: np.array(["a"] * k), "array 'text' has type <U1; expected numbers"),
    "nan": (lambda k: np.where(np.arange(k) == 1, np.nan, 1.0),
            "array 'nan' is nan at index 1 (1 of them); expected numbers"),
    "wide": (lambda k: np.ones((k, 3)), "expected one value for each"),
}


@pytest.mark.parametrize("flag", ["--fixed", "--selection"])
@pytest.mark.parametrize("name", BAD)
def test_arrays_that_are_no_masks_are_refused(name, flag, tmp_path, capsys):
    pytest.importorskip("pyvista")
    make, said = BAD[name]
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]])
    mesh = meshio.Mesh(points, [("tetra", np.array([[0, 1, 2, 3], [1, 2, 3, 4]]))],
                       {name: make(5)}, {name: [make(2)]})
    write_file(tmp_path / "a.vtu", mesh)
    assert main(["optimize", str(tmp_path / "a.vtu"), str(tmp_path / "b.vtu"), flag, name]) == 2
    told = capsys.readouterr().err
    assert f"Invalid value for {flag}: " in told
    assert said in told
    assert not (tmp_path / "b.vtu").exists()
