"""What makes odt_plugins look like a part of other toolkits, one file each, on request only.

`register` extends one toolkit and does nothing at a second call:

- "pymeshlab" (`hosts.pymeshlab_filters`): the filters of `FILTERS` become methods of MeshSet,
  names for ``apply_filter``, and steps of filter scripts; `run_filter` applies one,
  `run_filter_script` a script that mixes them with MeshLab's own;
- "pyvista" (`hosts.pyvista_accessor`): `OdtAccessor` and `OdtSurfaceAccessor` as ``mesh.odt``;
  pyvista 0.48 and newer find them by themselves (`hosts.pyvista_plugin`);
- "gmsh" (`hosts.gmsh_methods`): `odt` and `odt_remesh` as methods of ``gmsh.model.mesh``;
- "open3d" (`hosts.open3d_filters`): functions shaped like open3d's filters, such as
  `filter_smooth_odt`, `optimize_odt` and `remesh_odt`, become methods of its meshes.

Source: names, parameters and log lines follow the filters of each toolkit.
"""

from __future__ import annotations

from importlib import import_module

from odt_plugins.errors import InvalidOptionError, require

HOSTS = {
    "gmsh": "gmsh_methods",
    "open3d": "open3d_filters",
    "pymeshlab": "pymeshlab_filters",
    "pyvista": "pyvista_accessor",
}
"""File of this package that extends each toolkit; it has a function `register()`."""


def register(name: str) -> None:
    """Extend a toolkit by the filters and accessors of odt_plugins; a second call does nothing.

    Parameters
    ----------
    name : str              "pymeshlab": filters of MeshSet such as `apply_coord_odt_smoothing`,
                            listed by `pymeshlab.print_filter_list()`; "pyvista": accessors
                            `grid.odt` and `surface.odt`; "open3d": methods of its meshes such as
                            `filter_smooth_odt`; "gmsh": `gmsh.model.mesh.odt`

    Raises
    ------
    InvalidOptionError      there is nothing for a toolkit of that name
    MissingDependencyError  the toolkit is not installed
    """
    if not isinstance(name, str) or name not in HOSTS:
        msg = f"got the toolkit {name!r}; expected one of {sorted(HOSTS)}"
        raise InvalidOptionError(msg)
    require(f"register({name!r})", name, name)
    import_module(f"odt_plugins.hosts.{HOSTS[name]}").register()
