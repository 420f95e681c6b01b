"""Figures of meshes with other sizes: named ones never fall, others only where they stay good."""

from types import SimpleNamespace

import numpy as np
import pytest

import odt_plugins
from odt_plugins.options import KEPT
from odt_plugins.promise.good import GOOD, fallen_figures
from odt_plugins.promise.volume import LOWER_IS_BETTER


@pytest.mark.parametrize("corners", [3, 4])
@pytest.mark.parametrize("name", KEPT)
def test_a_figure_that_is_not_named_may_fall_to_a_good_one(name, corners):
    good = GOOD[corners][name]
    step = 1e-3 * good if name in LOWER_IS_BETTER else -1e-3 * good
    before, enough, poor = (
        SimpleNamespace(**GOOD[corners] | {name: value})
        for value in (good - 10.0 * step, good, good + step))
    assert fallen_figures(before, enough, KEPT, corners) == []
    assert len(fallen_figures(before, poor, KEPT, corners)) == 1
    assert len(fallen_figures(before, enough, (name,), corners)) == 1
    assert fallen_figures(poor, poor, KEPT, corners) == []


def test_equilateral_triangles_are_made_coarser_unless_the_mean_is_named():
    i, j = np.meshgrid(np.arange(15), np.arange(15), indexing="ij")
    points = np.stack([i + 0.5 * j, 0.75**0.5 * j], axis=-1).reshape(-1, 2)
    k = (15 * i + j)[:-1, :-1].ravel()
    cells = np.concatenate([np.stack(c, axis=-1) for c in (
        (k, k + 15, k + 1), (k + 15, k + 16, k + 1))])
    _, few = odt_plugins.remesh((points, cells), scale=1.6)
    assert len(few) < 0.6 * len(cells)
    named = odt_plugins.remesh((points, cells), scale=1.6, keep=("mean_quality",))
    assert odt_plugins.quality(named).mean_quality > 1.0 - 1e-9
