"""XDMF files of the kind that FEniCS writes: steps of time, and tags in grids of their own."""

from __future__ import annotations

import h5py
import numpy as np
from contract import grid

HEAD = '<?xml version="1.0"?>\n<!-- by a solver -->\n<Xdmf Version="3.0" xmlns:xi="{}">\n'.format(
    "http://www.w3.org/2001/XInclude")


def item(form, values, name, stem, folder):
    """A DataItem of values that are stored in one of the three ways."""
    kind = {"f": "Float", "i": "Int", "u": "UInt"}[values.dtype.kind]
    head = (f'<DataItem Dimensions="{" ".join(map(str, values.shape))}" NumberType="{kind}" '
            f'Precision="{values.dtype.itemsize}" Format="{form}">')
    if form == "HDF":
        with h5py.File(folder / f"{stem}.h5", "a") as file:
            data = file.create_dataset(name, data=values, compression="gzip", chunks=True)
            data.attrs["unit"] = "m"
        return f"{head}{stem}.h5:/{name}</DataItem>"
    if form == "Binary":
        (folder / f"{stem}_{name}.bin").write_bytes(values.tobytes())
        return f"{head}{stem}_{name}.bin</DataItem>"
    rows = "\n".join(" ".join(map(repr, row.tolist())) for row in values.reshape(len(values), -1))
    return f"{head}\n{rows}\n</DataItem>"


def series(folder, form="HDF", dim=2, stem="flow"):
    """A series of FEniCS's kind: mesh, tags of cells and of facets, two steps of two arrays."""
    points, cells, _ = grid(dim, 6 if dim == 2 else 4, 3)
    middle = np.isclose(points[:, 0], 0.5)
    lines = np.concatenate([np.delete(cells, k, axis=1) for k in range(dim + 1)])
    lines = np.unique(np.sort(lines[middle[lines].all(axis=1)], axis=1), axis=0)
    kind, facet = ("Triangle", "PolyLine") if dim == 2 else ("Tetrahedron", "Triangle")
    tags = (points[cells].mean(axis=1)[:, 0] > 0.5).astype(np.int32) + 1
    turned = np.random.default_rng(0).permutation(len(cells))

    def data(values, name):
        return item(form, values, name, stem, folder)

    steps = []
    for k, time in enumerate((0.0, 0.125)):
        steps.append(f"""<Grid Name="u" GridType="Uniform">
      <xi:include xpointer="xpointer(/Xdmf/Domain/Grid[@GridType='Uniform'][1]/*[self::Topology or self::Geometry])" />
      <Time Value="{time}" />
      <Attribute Name="u" AttributeType="Scalar" Center="Node">{data((points[:, :1] * (k + 1)), f"u{k}")}</Attribute>
      <Attribute Name="p" AttributeType="Scalar" Center="Cell">{data(np.full(len(cells), k + .5, dtype=np.float32), f"p{k}")}</Attribute>
    </Grid>""")  # noqa: E501
    text = f"""{HEAD}<Domain>
  <Grid Name="mesh" GridType="Uniform">
    <Topology TopologyType="{kind}" NumberOfElements="{len(cells)}" NodesPerElement="{dim + 1}">{data(cells, "topology")}</Topology>
    <Geometry GeometryType="{"XYZ"[:dim]}">{data(points, "geometry")}</Geometry>
    <Information Name="unit" Value="metre"/>
  </Grid>
  <Grid Name="cell_tags" GridType="Uniform">
    <xi:include xpointer="xpointer(/Xdmf/Domain/Grid/Geometry)" />
    <Topology TopologyType="{kind}" NumberOfElements="{len(cells)}" NodesPerElement="{dim + 1}">{data(cells[turned], "tagged")}</Topology>
    <Attribute Name="cell_tags" AttributeType="Scalar" Center="Cell">{data(tags[turned], "tags")}</Attribute>
  </Grid>
  <Grid Name="facet_tags" GridType="Uniform">
    <xi:include xpointer="xpointer(/Xdmf/Domain/Grid/Geometry)" />
    <Topology TopologyType="{facet}" NumberOfElements="{len(lines)}" NodesPerElement="{dim}">{data(lines, "facets")}</Topology>
    <Attribute Name="facet_tags" AttributeType="Scalar" Center="Cell">{data(np.full(len(lines), 7, dtype=np.int32), "values")}</Attribute>
  </Grid>
  <Grid Name="u" GridType="Collection" CollectionType="Temporal">
    {steps[0]}
    {steps[1]}
  </Grid>
</Domain></Xdmf>
"""  # noqa: E501
    (folder / f"{stem}.xdmf").write_text(text)
    return folder / f"{stem}.xdmf", points, cells, lines, tags
