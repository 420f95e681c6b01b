"""What pyvista 0.48 and newer import at the first ``mesh.odt``: it adds the accessor at once."""

from __future__ import annotations

from odt_plugins.hosts.pyvista_accessor import register

register()
