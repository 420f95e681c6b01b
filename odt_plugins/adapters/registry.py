"""Which adapter reads an object: a table, asked from top to bottom."""

from __future__ import annotations

from odt_plugins.adapters import (
    arrays,
    dlpack_arrays,
    files,
    gmsh_model,
    meshio_mesh,
    netgen_mesh,
    open3d_mesh,
    open3d_model,
    pymeshlab_mesh,
    pyvista_blocks,
    pyvista_mesh,
    skfem_mesh,
    trimesh_mesh,
    trimesh_scene,
    vtk_mesh,
)
from odt_plugins.adapters.host import Adapter
from odt_plugins.errors import UnsupportedMeshError, counted

ADAPTERS: tuple[Adapter, ...] = (
    arrays,
    dlpack_arrays,
    files,
    meshio_mesh,
    pyvista_mesh,
    pyvista_blocks,
    vtk_mesh,
    pymeshlab_mesh,
    open3d_mesh,
    open3d_model,
    gmsh_model,
    trimesh_mesh,
    trimesh_scene,
    skfem_mesh,
    netgen_mesh,
)

ACCEPTED = (
    "a (points, cells) tuple of arrays, a pyvista.UnstructuredGrid, PolyData or MultiBlock, a "
    "vtkUnstructuredGrid or vtkPolyData, a meshio.Mesh, a pymeshlab.MeshSet or Mesh, an open3d "
    "TriangleMesh (legacy or tensor), TetraMesh or TriangleMeshModel, gmsh.model, a "
    "trimesh.Trimesh or Scene, a mesh of scikit-fem, Netgen or NGSolve, or the path of a mesh file"
)

HINTS = {
    "open3d.PointCloud": "open3d.geometry.TetraMesh.create_from_point_cloud(cloud)[0] of a legacy "
                         "cloud",
    "open3d.HalfEdgeTriangleMesh": "open3d.geometry.TriangleMesh(mesh.vertices, mesh.triangles)",
    "open3d": "a TriangleMesh or TetraMesh made of it",
    "pyvista.PointSet": "mesh.delaunay_3d()",
    "pyvista.DataSet": "mesh.cast_to_unstructured_grid().triangulate()",
    "pyvista.PartitionedDataSet": "pyvista.MultiBlock(list(mesh))",
    **dict.fromkeys(("vtkmodules.PartitionedDataSetCollection",
                     "vtkmodules.vtkPartitionedDataSetCollection"),
                    "mesh.GetPartition(0, 0) and so on, one by one"),
    "pyvista.Table": "a PolyData or UnstructuredGrid made of it",
    "vtkmodules": "pyvista.wrap(mesh)",
    "trimesh.PointCloud": "mesh.convex_hull",
    "trimesh.Path2D": "mesh.triangulate()",
    "trimesh.VoxelGrid": "mesh.marching_cubes",
    "trimesh": "a Trimesh of vertices and faces",
    "netgen": "mesh.GenerateMesh()",
    "ngsolve": "the ngsolve.Mesh that it is of",
    "skfem": "the mesh that it is of",
    "scipy.Delaunay": "(mesh.points, mesh.simplices)",
    "matplotlib.Triangulation": "(numpy.column_stack([mesh.x, mesh.y]), mesh.triangles)",
    "mmgpy.MmgMesh3D": "(mesh.get_vertices(), mesh.get_tetrahedra())",
    "mmgpy": "(mesh.get_vertices(), mesh.get_triangles())",
    "tetgen.TetGen": "mesh.grid",
    "meshpy": "(numpy.array(mesh.points), numpy.array(mesh.elements))",
    "dolfinx": "(mesh.geometry.x, mesh.geometry.dofmap)",
    "vedo": "pyvista.wrap(mesh.dataset)",
    "builtins.dict": '(mesh["vertices"], mesh["triangles"])',
    **dict.fromkeys(("builtins.module", "builtins.type"), "gmsh.model, if it is of gmsh"),
    "builtins": "numpy.asarray on the points and on the cells",
}
"""What to pass instead of an object that has no adapter, by package or package and class."""


def find_adapter(mesh: object) -> Adapter:
    """Find the adapter of an object.

    Raises
    ------
    UnsupportedMeshError    no adapter knows the object
    """
    for adapter in ADAPTERS:
        if adapter.matches(mesh):
            return adapter
    kind = type(mesh)
    if isinstance(mesh, tuple | list):
        parts = ", ".join(type(part).__name__ for part in mesh[:3])
        msg = (f"got a {kind.__name__} of {counted(len(mesh), 'part')} ({parts}"
               f"{', ...' if len(mesh) > 3 else ''}); expected two or three, (points, cells) or "
               f"(points, cells, regions), as arrays or lists of rows, try numpy.asarray on each")
        raise UnsupportedMeshError(msg)
    packages = [base.__module__.partition(".")[0] for base in kind.__mro__]
    keys = [key for package, base in zip(packages, kind.__mro__, strict=True)
            for key in (f"{package}.{base.__name__}", package)]
    hint = next((HINTS[key] for key in keys if key in HINTS), HINTS["builtins"])
    name = f"{kind.__module__}.{kind.__qualname__}".removeprefix("builtins.")
    msg = f"got an object of type {name}; expected {ACCEPTED}, try {hint}"
    raise UnsupportedMeshError(msg)
