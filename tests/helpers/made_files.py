"""Files of Exodus and Netgen with everything in them."""

from __future__ import annotations

import contract
import netCDF4
import numpy as np

SIDES = ((0, 1, 3), (1, 2, 3), (0, 3, 2), (0, 2, 1))
"""Corners of the sides of a tetrahedron, by the manual of Exodus."""


def box(n=6, seed=4):
    points, cells, labels = contract.grid(3, n)
    points = points / points.max()
    wall = np.zeros(len(points), dtype=bool)
    for label in np.unique(labels):
        other = np.unique(cells[labels != label])
        wall[np.intersect1d(np.unique(cells[labels == label]), other)] = True
    plane = np.isclose(points[:, 1], 0.5)
    inner = ((points > 0) & (points < 1)).all(axis=1) & ~wall & ~plane
    points[inner] += np.random.default_rng(seed).uniform(-0.1, 0.1, (inner.sum(), 3)) / n
    return points, cells, labels, np.flatnonzero(plane)


def put(file, title, kind, dims, values, **attributes):
    variable = file.createVariable(title, kind, dims)
    variable.setncatts(attributes)
    variable[:] = values


def letters(names, length=33):
    table = np.zeros((len(names), length), "S1")
    for i, name in enumerate(names):
        table[i, : len(name)] = list(name)
    return table


def exodus(path, kind, points, blocks, plane, steps=3):
    """Two blocks, a side set on the boundary and inside, two node sets, an element set, steps."""
    cells = np.concatenate(blocks)
    sides = np.concatenate([cells[:, c] for c in SIDES])
    flat = np.abs(points[sides][:, :, 2]).max(axis=1) < 1e-12
    floor = np.flatnonzero(flat)
    at = np.concatenate([floor, [7]])
    element, side = at % len(cells) + 1, at // len(cells) + 1
    rng = np.random.default_rng(1)
    with netCDF4.Dataset(path, "w", format=kind) as f:
        f.setncatts({"api_version": np.float32(5.1), "version": np.float32(5.1),
                     "floating_point_word_size": np.int32(8), "title": "box"})
        for name, size in {
            "len_string": 33, "len_line": 81, "four": 4, "num_dim": 3, "num_nodes": len(points),
            "num_elem": len(cells), "num_el_blk": 2, "num_side_sets": 1, "num_side_ss1": len(at),
            "num_df_ss1": 3 * len(at), "num_node_sets": 2, "num_nod_ns1": len(plane),
            "num_nod_ns2": len(points), "num_elem_sets": 1, "num_ele_els1": 20, "num_qa_rec": 1,
            "num_nod_var": 3, "num_elem_var": 2, "time_step": None, "num_el_in_blk1":
            len(blocks[0]), "num_nod_per_el1": 4, "num_el_in_blk2": len(blocks[1]),
            "num_nod_per_el2": 4, "num_att_in_blk1": 1,
        }.items():
            f.createDimension(name, size)
        put(f, "time_whole", "f8", ("time_step",), np.arange(steps) / 2)
        put(f, "qa_records", "S1", ("num_qa_rec", "four", "len_string"),
            letters(["a", "b", "c", "d"])[None])
        put(f, "eb_status", "i4", ("num_el_blk",), [1, 1])
        put(f, "eb_prop1", "i4", ("num_el_blk",), [70, 8], name="ID")
        put(f, "eb_names", "S1", ("num_el_blk", "len_string"), letters(["steel", "air"]))
        put(f, "ss_prop1", "i4", ("num_side_sets",), [3], name="ID")
        put(f, "ss_names", "S1", ("num_side_sets", "len_string"), letters(["floor"]))
        put(f, "ns_prop1", "i4", ("num_node_sets",), [10, 5], name="ID")
        put(f, "ns_names", "S1", ("num_node_sets", "len_string"), letters(["fault", ""]))
        put(f, "els_prop1", "i4", ("num_elem_sets",), [4], name="ID")
        put(f, "elem_els1", "i4", ("num_ele_els1",), np.arange(20, 0, -1))
        put(f, "elem_num_map", "i4", ("num_elem",), np.arange(len(cells)) + 500)
        put(f, "node_num_map", "i4", ("num_nodes",), np.arange(len(points)) * 2 + 1)
        put(f, "attrib1", "f8", ("num_el_in_blk1", "num_att_in_blk1"), rng.random(
            (len(blocks[0]), 1)))
        for i, axis in enumerate("xyz"):
            put(f, f"coord{axis}", "f8", ("num_nodes",), points[:, i])
        for b in (1, 2):
            put(f, f"connect{b}", "i4", (f"num_el_in_blk{b}", f"num_nod_per_el{b}"),
                blocks[b - 1] + 1, elem_type="TETRA")
        put(f, "elem_ss1", "i4", ("num_side_ss1",), element)
        put(f, "side_ss1", "i4", ("num_side_ss1",), side)
        put(f, "dist_fact_ss1", "f8", ("num_df_ss1",), points[sides[at]].sum(axis=2).ravel())
        put(f, "node_ns1", "i4", ("num_nod_ns1",), plane + 1)
        put(f, "node_ns2", "i4", ("num_nod_ns2",), np.arange(len(points)) + 1)
        put(f, "name_nod_var", "S1", ("num_nod_var", "len_string"), letters(["vX", "vY", "vZ"]))
        put(f, "name_elem_var", "S1", ("num_elem_var", "len_string"), letters(["p", "q"]))
        put(f, "elem_var_tab", "i4", ("num_el_blk", "num_elem_var"), [[1, 1], [0, 1]])
        for i in range(3):
            put(f, f"vals_nod_var{i + 1}", "f8", ("time_step", "num_nodes"),
                np.stack([t + points @ [1 + i, 2, -1] for t in range(steps)]))
        for name in ("vals_elem_var1eb1", "vals_elem_var2eb1", "vals_elem_var2eb2"):
            b = int(name[-1])
            put(f, name, "f8", ("time_step", f"num_el_in_blk{b}"),
                rng.random((steps, len(blocks[b - 1]))))


def two_boxes(path):
    """Boxes of two materials with periodic faces, as Netgen makes them of a CAD model."""
    from netgen.occ import Box, Glue, IdentificationType, OCCGeometry, X

    left, right = Box((0, 0, 0), (1, 1, 1)).mat("air"), Box((1, 0, 0), (2, 1, 1)).mat("steel")
    left.faces.Min(X).name = "inlet"
    left.faces.Min(X).Identify(right.faces.Max(X), "per", IdentificationType.PERIODIC)
    OCCGeometry(Glue([left, right])).GenerateMesh(maxh=0.3, optsteps3d=0).Save(str(path))
