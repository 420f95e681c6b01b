"""What makes odt_plugins look like a part of other toolkits, one file each, on request only."""

from __future__ import annotations

from importlib import import_module

from odt_plugins.errors import InvalidOptionError, require

HOSTS = {
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
                            `filter_smooth_odt`

    Raises
    ------
    InvalidOptionError      there is nothing for a toolkit of that name
    MissingDependencyError  the toolkit is not installed
    """
    if name not in HOSTS:
        msg = f"got the toolkit {name!r}; expected one of {sorted(HOSTS)}"
        raise InvalidOptionError(msg)
    require(f"register({name!r})", name, name)
    import_module(f"odt_plugins.hosts.{HOSTS[name]}").register()
