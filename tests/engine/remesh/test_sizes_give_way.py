"""What remesh does, one after the other, where figures would fall."""

from __future__ import annotations

import numpy as np
from tet_meshes import ball, signed_volumes

import odt_plugins
from odt_plugins.engine.remesh import run


def test_sizes_give_way_everywhere_before_less_of_the_envelope_is_tried(monkeypatch):
    tries = []
    real = run._once

    def once(mesh, sizes, asked, options, leaving, shares, room, *, relents):
        outcome, broken = real(mesh, sizes, asked, options, leaving, shares, room, relents=relents)
        tries.append((float(shares.max()), sizes.values))
        return outcome, ["p1_quality fell"] if tries[-1][0] == tries[0][0] else broken

    monkeypatch.setattr(run, "_once", once)
    monkeypatch.setattr(run, "_fallen", lambda *_, **__: True)
    points, cells = ball(800, 3)
    monkeypatch.setattr(run, "_spoiled", lambda *_: np.arange(len(cells)) < len(cells) // 50)
    x, t = odt_plugins.remesh((points, cells), scale=1.8)
    (first, wanted), (last, smaller) = tries[0], tries[-1]
    assert first > last > 0.0
    assert (smaller < 0.9 * wanted).mean() > 0.9
    assert (smaller > 0.4 * wanted).all()
    assert signed_volumes(x, t).min() > 0.0
    assert len(t) < len(cells)
    assert np.isfinite(x).all()
