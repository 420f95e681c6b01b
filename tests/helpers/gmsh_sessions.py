"""Sessions of Gmsh that are always ended, a model with physical groups, and the sizes of groups."""

from __future__ import annotations

from contextlib import contextmanager

import pytest


@contextmanager
def session():
    """Gmsh, initialised and quiet, until the end of the block."""
    gmsh = pytest.importorskip("gmsh")
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        yield gmsh
    finally:
        gmsh.finalize()


def group_sizes(gmsh):
    """Length, area or volume of the physical groups by dimension, tag and name."""
    model = gmsh.model
    return {(dim, tag, model.getPhysicalName(dim, tag)): sum(
        float(model.mesh.getElementQualities(numbers, "volume").sum())
        for entity in model.getEntitiesForPhysicalGroup(dim, tag).tolist()
        for numbers in model.mesh.getElements(dim, entity)[1])
        for dim, tag in model.getPhysicalGroups()}


def two_solids(model):
    """Make two boxes with a common face, in named groups with parts of their skin."""
    model.add("solid")
    model.occ.fragment([(3, model.occ.addBox(0, 0, 0, 1, 1, 1))],
                       [(3, model.occ.addBox(1, 0, 0, 1, 1, 1))])
    model.occ.synchronize()
    skin = [tag for _, tag in model.getBoundary([(3, 1), (3, 2)], oriented=False)]
    for dim, tags, tag, name in ((3, [1], 7, "steel"), (3, [2], 9, "air"),
                                 (2, skin[:2], 3, "inlet"), (2, skin[2:], 4, "wall")):
        model.addPhysicalGroup(dim, tags, tag, name)
    return skin
