"""One file with everything a format holds goes through, as two or more other programs read it.

Each row has who makes the file, and who reads it before and after: what these see of labels, names,
sets and arrays is the same. Rows of a format say more than this where the format has its own tests.
"""

from __future__ import annotations

import warnings

import contract
import meshio
import netCDF4
import numpy as np
import pytest
from gmsh_sessions import group_sizes, session, two_solids
from made_files import box, two_boxes
from made_files import exodus as write_exodus

from odt_plugins import optimize
from odt_plugins.adapters.files import read_file, write_file

DIGITS = 6
"""Of measures that are compared: CAD of Gmsh and Netgen, and readers with 32 bits."""


def measures(points, kind, rows, labels):
    """Length, area or volume of every label; None of cells that are none of simplices."""
    corners = {"line": 2, "triangle": 3, "tetra": 4}.get(kind)
    if corners is None:
        return None
    edges = np.asarray(points, float)[rows[:, 1:corners]] - np.asarray(points, float)[rows[:, :1]]
    gram = np.linalg.det(np.einsum("nik,njk->nij", edges, edges))
    size = np.sqrt(np.maximum(gram, 0)) / [1, 1, 2, 6][corners - 1]
    return {int(label): round(float(size[labels == label].sum()), DIGITS)
            for label in np.unique(labels)}


def by_meshio(path):
    mesh = meshio.read(path)
    out = {"names": sorted(mesh.field_data), "nodes": len(mesh.points)}
    for name, nodes in mesh.point_sets.items():
        out["points", name] = sorted(np.asarray(nodes).ravel().tolist())
    out |= {("point", name): (str(values.dtype), values.shape[1:])
            for name, values in mesh.point_data.items()}
    for name, parts in mesh.cell_data.items():
        out["cell", name] = sorted({str(np.asarray(part).dtype) for part in parts})
        for kind in mesh.cells_dict if np.asarray(parts[0]).dtype.kind in "iu" else ():
            labels = np.asarray(mesh.get_cell_data(name, kind)).ravel()
            out["measure", name, kind] = measures(mesh.points, kind, mesh.cells_dict[kind], labels)
    for name in mesh.cell_sets_dict:
        if name != "gmsh:bounding_entities":
            out["set", name] = {kind: measures(mesh.points, kind, mesh.cells_dict[kind][rows], 0)
                                for kind, rows in mesh.cell_sets_dict[name].items() if len(rows)}
    return out


def by_gmsh(path):
    with session() as gmsh:
        gmsh.open(str(path))
        out = {"entities": gmsh.model.getEntities()}
        out |= {name: round(size, DIGITS) for name, size in group_sizes(gmsh).items()}
        out["views"] = [gmsh.view.option.getString(view, "Name") for view in gmsh.view.getTags()]
        return out


def by_vtk(path):
    pyvista = pytest.importorskip("pyvista")
    found = pyvista.read(path)
    blocks = found.recursive_iterator("all", skip_none=True) if isinstance(
        found, pyvista.MultiBlock) else [("", "", found)]
    out = {}
    for _, block, mesh in blocks:
        for home in ("point", "cell", "field"):
            data = getattr(mesh, f"{home}_data")
            out[block, home] = {name: (str(data[name].dtype), data[name].shape[1:])
                                for name in data}
        sizes = mesh.compute_cell_sizes()
        size = np.asarray(sizes["Volume"]) + sizes["Area"] + sizes["Length"]
        flat = not np.any(sizes["Volume"])
        for name, values in mesh.cell_data.items():
            values = np.asarray(values)
            if values.dtype.kind in "iu" and values.ndim == 1 and not flat:
                out[block, name] = {int(label): round(float(size[values == label].sum()), DIGITS)
                                    for label in np.unique(values)}
    return out


def by_exodus(path):
    with netCDF4.Dataset(path) as file:
        out = {name: (str(of.dtype), of.dimensions, of.ncattrs()) for name, of in
               file.variables.items()}
        for name in file.variables:
            if name.startswith(("eb_", "ns_", "ss_", "els_", "node_ns", "name_", "time", "qa")):
                out["values", name] = np.asarray(file[name][:].filled()).tolist()
        return out


def by_h5py(path):
    import h5py

    found = {}
    with h5py.File(path) as file:
        file.visititems(lambda name, of: found.update({name: sorted(of.attrs)}))
    return found


def by_su2(path):
    lines = path.read_text().splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith("NMARK"))
    return {"dimension": lines[0], "markers": lines[first:]}


def by_netgen(path):
    ng = pytest.importorskip("netgen.meshing")
    mesh = ng.Mesh()
    mesh.Load(str(path))
    faces = [mesh.FaceDescriptor(i + 1) for i in range(mesh.GetNFaceDescriptors())]
    return {"identified": [tuple(map(str, pair)) for pair in mesh.GetIdentifications()],
            "segments": [(*map(str, e.vertices), e.index) for e in mesh.Elements1D()],
            "triangles": [(*map(str, e.vertices), e.index) for e in mesh.Elements2D()],
            "faces": [(f.domin, f.domout, f.bc, f.surfnr, f.color) for f in faces],
            "materials": [mesh.GetMaterial(i) for i in (1, 2)],
            "names": [mesh.GetBCName(i) for i in range(len(faces))]}


def by_skfem(path):
    skfem = pytest.importorskip("skfem")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        mesh = skfem.Mesh.load(path)
    return {"inside": {name: len(cells) > 0 for name, cells in (mesh.subdomains or {}).items()},
            "rim": {name: mesh.p[:, mesh.facets[:, np.asarray(facets)]].mean(axis=1).sum().round(
                DIGITS).item() for name, facets in (mesh.boundaries or {}).items()}}


def by_trimesh(path):
    trimesh = pytest.importorskip("trimesh")
    found = trimesh.load(path, process=False)
    parts = found.geometry if isinstance(found, trimesh.Scene) else {"": found}
    return {name: (len(part.vertices), len(part.faces), part.visual.kind,
                   np.unique(part.visual.vertex_colors, axis=0).tolist() if part.visual.kind
                   == "vertex" else None, part.is_watertight) for name, part in parts.items()}


def by_open3d(path):
    open3d = pytest.importorskip("open3d")
    mesh = open3d.io.read_triangle_mesh(str(path))
    colours = np.round(np.asarray(mesh.vertex_colors), 3)
    return {"vertices": len(mesh.vertices), "triangles": len(mesh.triangles),
            "colours": np.unique(colours, axis=0).tolist(), "normals": mesh.has_vertex_normals(),
            "labels": sorted(np.asarray(mesh.triangle_material_ids).tolist())}


def by_meshlab(path):
    pymeshlab = pytest.importorskip("pymeshlab")
    meshes = pymeshlab.MeshSet(verbose=False)
    meshes.load_new_mesh(str(path))
    mesh = meshes.current_mesh()
    return {"vertices": mesh.vertex_number(), "faces": mesh.face_number(),
            "colours": [mesh.has_vertex_color(), mesh.has_face_color()] and np.unique(
                mesh.vertex_color_matrix(), axis=0).round(3).tolist(),
            "of faces": np.unique(mesh.face_color_matrix(), axis=0).round(3).tolist()
            if mesh.has_face_color() else None}


def solid(path):
    """Two boxes in named groups, by Gmsh, with a view in its own format."""
    with session() as gmsh:
        two_solids(gmsh.model)
        for name, value in (("MeshSizeMax", 0.4), ("Optimize", 0), ("Binary", 0),
                            ("MshFileVersion", 2.2 if path.stem.endswith("22") else 4.1)):
            gmsh.option.setNumber(f"Mesh.{name}", value)
        gmsh.model.mesh.generate(3)
        gmsh.write(str(path))
        if path.suffix == ".msh":
            view = gmsh.view.add("heat")
            nodes = gmsh.model.mesh.getNodes()[0]
            gmsh.view.addHomogeneousModelData(view, 0, gmsh.model.getCurrent(), "NodeData", nodes,
                                              np.arange(len(nodes), dtype=float))
            gmsh.option.setNumber("PostProcessing.SaveMesh", 0)
            gmsh.view.write(view, str(path), append=True)


def grid(path):
    """A grid or PolyData by VTK with arrays of several types, a field and active scalars."""
    pyvista = pytest.importorskip("pyvista")
    points, cells, labels = contract.grid(2 if path.suffix == ".vtp" else 3, 6)
    if path.suffix == ".vtp":
        points = np.column_stack([points, np.zeros(len(points))])
        mesh = pyvista.PolyData.from_regular_faces(points, cells)
    else:
        mesh = pyvista.UnstructuredGrid({10: cells}, points)
    mesh.cell_data["material"] = (labels == 7).astype(np.int32) + 1
    mesh.cell_data["two words"] = np.full(len(cells), 0.5, np.float32)
    mesh.point_data["flow"] = points / 3
    mesh.point_data["ids"] = np.arange(len(points), dtype=np.int64)
    mesh.field_data["TimeValue"] = [1.5]
    mesh.set_active_scalars("material", preference="cell")
    if path.suffix != ".vtk":
        mesh.save(path)
        return
    from vtkmodules.vtkIOLegacy import vtkUnstructuredGridWriter

    writer = vtkUnstructuredGridWriter()
    writer.SetFileVersion(writer.VTK_LEGACY_READER_VERSION_4_2)
    writer.SetInputData(mesh)
    writer.SetFileName(str(path))
    writer.Write()


def exodus(path):
    points, cells, labels, plane = box()
    write_exodus(path, "NETCDF3_64BIT_OFFSET", points, [cells[labels == 7], cells[labels != 7]],
                 plane)
    with netCDF4.Dataset(path, "a") as file:
        # VTK takes coordinates apart by axes where it stands.
        file.file_size = np.int32(1)


def ball():
    trimesh = pytest.importorskip("trimesh")
    sphere = trimesh.creation.icosphere(2)
    points = sphere.vertices + np.random.default_rng(3).normal(0, 0.02, sphere.vertices.shape)
    return points, np.array(sphere.faces)


def normal(corners):
    out = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    return (out / np.linalg.norm(out, axis=0)).tolist()


def surface(path):
    """A noisy sphere with what the format has of groups, materials, colours and names."""
    points, cells = ball()
    top = points[cells].mean(axis=1)[:, 2] > 0.1
    parts = {"cap": cells[top], "body": cells[~top]}
    if path.suffix == ".ply":
        trimesh = pytest.importorskip("trimesh")
        colours = np.where(points[:, 2:] > 0, [200, 10, 10, 255], [10, 200, 10, 255])
        trimesh.Trimesh(points, cells, vertex_colors=colours, process=False).export(path)
    elif path.suffix == ".off":
        pymeshlab = pytest.importorskip("pymeshlab")
        meshes = pymeshlab.MeshSet(verbose=False)
        meshes.add_mesh(pymeshlab.Mesh(points, cells, v_color_matrix=np.where(
            points[:, 2:] > 0, [1.0, 0.2, 0.2, 1.0], [0.2, 1.0, 0.2, 1.0])))
        meshes.save_current_mesh(str(path))
    elif path.suffix == ".obj":
        path.write_text("# by hand\n" + "".join(
            "v {!r} {!r} {!r}\n".format(*v) for v in points.tolist()) + "".join(
            f"o {name}\nusemtl paint_{name}\n" + "".join(
                "f {} {} {}\n".format(*t) for t in (rows + 1).tolist())
            for name, rows in parts.items()))
    else:
        path.write_text("".join(f"solid {name}\n" + "".join(
            "facet normal {!r} {!r} {!r}\nouter loop\n".format(*normal(points[t])) + "".join(
                "vertex {!r} {!r} {!r}\n".format(*v) for v in points[t].tolist())
            + "endloop\nendfacet\n" for t in rows) + f"endsolid {name}\n"
            for name, rows in parts.items()))


ROWS = {
    "a22.msh": (solid, by_gmsh, by_meshio, by_skfem),
    "a41.msh": (solid, by_gmsh, by_meshio, by_skfem),
    "a.med": (solid, by_gmsh, by_meshio, by_h5py),
    "a.mesh": (solid, by_gmsh, by_meshio),
    "a.su2": (solid, by_meshio, by_su2),
    "a.vtk": (grid, by_vtk, by_meshio),
    "a.vtu": (grid, by_vtk, by_meshio),
    "a.vtp": (grid, by_vtk),
    "a.e": (exodus, by_exodus, by_vtk),
    "a.vol": (two_boxes, by_netgen),
    "a.obj": (surface, by_trimesh, by_open3d, by_meshlab),
    "a.ply": (surface, by_trimesh, by_open3d, by_meshlab),
    "a.off": (surface, by_trimesh, by_meshlab),
    "a.stl": (surface, by_trimesh, by_open3d, by_meshlab),
}
"""By the name of a file: who makes it, and who reads it."""


@pytest.mark.parametrize("name", ROWS)
def test_others_see_what_they_saw(name, tmp_path):
    make, *readers = ROWS[name]
    source, target = tmp_path / name, tmp_path / f"b{name.removeprefix('a')}"
    make(source)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mesh = read_file(source)
        out = optimize(mesh)
        write_file(target, out)
    assert not np.array_equal(np.asarray(mesh.points), np.asarray(out.points))
    for reader in readers:
        before, after = reader(source), reader(target)
        assert before
        assert after == before, reader.__name__
