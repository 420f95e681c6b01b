"""Arrays of other libraries through DLPack; of PyTorch where it is installed."""

from __future__ import annotations

from importlib.util import find_spec
from typing import NamedTuple

import contract
import numpy as np
import pytest

import odt_plugins
from odt_plugins.errors import InvalidMeshError, UnsupportedMeshError


def _torch(values):
    import torch

    return torch.asarray(values)


def _open3d(values):
    from open3d.core import Tensor

    return Tensor(np.array(values))


MAKERS = {"foreign": contract.Foreign} | {
    name: make for name, make in (("torch", _torch), ("open3d", _open3d)) if find_spec(name)}
"""What makes an array of a library. PyTorch is an extra of its own, since it is large."""


class Mesh(NamedTuple):
    places: object
    cells: object


class OnDevice(contract.Foreign):
    """An array on a graphics card, which numpy cannot read through DLPack."""

    device = "gpu:1"

    def __dlpack__(self, **options):
        raise BufferError("on a device of type 2")

    def __dlpack_device__(self):
        return 2, 1

    def __array_namespace__(self):
        return OnDevice

    @staticmethod
    def asarray(values, device):
        assert device == "gpu:1"
        return OnDevice(np.array(values))

    def get(self):
        return self.values.copy()


@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
def test_arrays_of_the_same_kind_come_back(make):
    points, cells, labels = contract.grid(3, 4)
    places, truth = odt_plugins.optimize((points.astype(np.float32), cells.astype(np.int32)))
    given = Mesh(make(points.astype(np.float32)), make(cells.astype(np.int32)))
    out, report = odt_plugins.optimize_with_report(given)
    assert type(out) is Mesh
    for new, old, want in zip(out, given, (places, truth), strict=True):
        assert type(new) is type(old)
        found = np.from_dlpack(new)
        assert found.dtype == want.dtype
        assert np.array_equal(found, want)
    assert np.array_equal(np.from_dlpack(given.places), points.astype(np.float32))
    assert odt_plugins.quality(out) == report.after
    out = odt_plugins.optimize([make(points), make(cells)], regions=labels)
    assert [type(part) for part in out] == [type(given.places)] * 3
    mixed = odt_plugins.optimize((make(points), cells))
    assert (type(mixed[0]), type(mixed[1])) == (type(given.places), np.ndarray)


def test_arrays_on_a_device_go_back_there():
    points, cells, _ = contract.grid(2, 4)
    out = odt_plugins.optimize((OnDevice(points), OnDevice(cells)))
    assert [type(part) for part in out] == [OnDevice, OnDevice]
    assert np.array_equal(out[0].values, odt_plugins.optimize((points, cells))[0])


class Torn(contract.Foreign):
    def __dlpack__(self, **options):
        raise BufferError("Can't export tensors that require gradient, use tensor.detach()")


class Odd(contract.Foreign):
    def __dlpack__(self, **options):
        raise RuntimeError("no such type: bfloat16")


def test_arrays_of_a_library_that_makes_no_others_are_refused_before_any_work(monkeypatch):
    points, cells, _ = contract.grid(2, 4)
    monkeypatch.delattr(contract.Foreign, "__array_namespace__", raising=False)
    monkeypatch.delattr(contract, "asarray", raising=False)
    with pytest.raises(UnsupportedMeshError, match=r"cells of type Foreign, .*from_dlpack on"):
        odt_plugins.optimize((points, contract.Foreign(cells)))


def test_arrays_that_cannot_be_read_are_named():
    points, cells, _ = contract.grid(2, 4)
    with pytest.raises(InvalidMeshError, match=r"gradient.*try points\.detach\(\)"):
        odt_plugins.optimize((Torn(points), cells))
    with pytest.raises(InvalidMeshError, match=r"cells that numpy cannot read .no such type"):
        odt_plugins.optimize((points, Odd(cells)))
    lost = OnDevice(points)
    lost.get = None
    with pytest.raises(InvalidMeshError, match="try copying them to the CPU"):
        odt_plugins.optimize((lost, cells))
    if "torch" in MAKERS:
        with pytest.raises(InvalidMeshError, match=r"try points\.detach\(\)"):
            odt_plugins.optimize((_torch(points).requires_grad_(), cells))
