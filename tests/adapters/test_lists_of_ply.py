"""PLY files whose vertices have lists, as of weights: these stay at their vertices."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import trimesh

from odt_plugins.adapters.files import read_file
from odt_plugins.adapters.formats.ply_tables import decoded, parsed
from odt_plugins.api import optimize_file


@pytest.mark.parametrize("lengths", [(1, 0, 2), (2,)])
@pytest.mark.parametrize("text", [True, False])
def test_lists_of_vertices_stay(text, lengths, tmp_path):
    ball = trimesh.creation.icosphere(2)
    points = ball.vertices + np.random.default_rng(3).normal(0, 0.02, ball.vertices.shape)
    weights = [np.arange(lengths[i % len(lengths)]) + i for i in range(len(points))]
    kind = "ascii" if text else "binary_little_endian"
    head = ["ply", f"format {kind} 1.0", f"element vertex {len(points)}",
            *(f"property double {k}" for k in "xyz"), "property list uchar short weights",
            f"element face {len(ball.faces)}", "property list uchar int vertex_indices",
            "end_header", ""]
    if text:
        rows = [" ".join(map(str, [*p, len(w), *w]))
                for p, w in zip(points.tolist(), weights, strict=True)]
        body = "\n".join([*rows, *(f"3 {a} {b} {c}" for a, b, c in ball.faces), ""]).encode()
    else:
        body = b"".join(p.tobytes() + np.uint8(len(w)).tobytes() + w.astype("<i2").tobytes()
                        for p, w in zip(points, weights, strict=True))
        body += b"".join(b"\3" + face.astype("<i4").tobytes() for face in ball.faces)
    source, target = tmp_path / "a.ply", tmp_path / "b.ply"
    source.write_bytes("\n".join(head).encode() + body)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        report = optimize_file(source, target)
    assert report.after.mean_quality > report.before.mean_quality
    assert not np.array_equal(read_file(target).points, points)
    data = target.read_bytes()
    found = decoded(data, *parsed(data))[0]["vertex"]["weights"]
    assert all(map(np.array_equal, found, weights))
