"""The subcommand ``odt-plugins paraview``; and the work of its plugin, ``python -m`` this file."""

from __future__ import annotations

import json
import shlex
import sys
import warnings
from pathlib import Path
from typing import Any

import click

from odt_plugins import hosts
from odt_plugins.errors import ODTError

PLUGIN = Path(hosts.__file__).with_name("paraview_plugin.py")


@click.command(short_help="Tell how ParaView loads the filters.")
def paraview() -> int:
    """Print the path of ParaView's plugin and how to load it.

    The filters are ODT Optimize, ODT Remesh, ODT Quality and ODT Tetrahedralize.
    """
    click.echo(f"""plugin: {PLUGIN}

Start ParaView with the Python that does the work:
  {shlex.join(["env", f"ODT_PLUGINS_PYTHON={sys.executable}", "paraview"])}
In ParaView: Tools > Manage Plugins > Load New ..., choose the plugin, tick Auto Load.
In its Python shell, or in pvpython:
  import inspect, paraview.simple
  inspect.getargspec = inspect.getfullargspec  # for ParaView 5.11 with Python 3.11, as in Debian 12
  paraview.simple.LoadPlugin({str(PLUGIN)!r}, ns=globals())""")
    return 0


def main() -> None:
    """Do the job that standard input holds as JSON, and write one line of JSON for every step."""
    def tell(**told: Any) -> None:
        click.echo(json.dumps(told))

    job = json.load(sys.stdin)
    warnings.simplefilter("ignore")
    try:
        work(job, lambda stage, share: tell(stage=stage, share=share))
    except (ODTError, click.UsageError) as exc:
        tell(error=" ".join(str(exc).split()))
        return
    tell(done=True)


def work(job: dict[str, Any], progress: Any) -> None:
    """Optimise, remesh or tetrahedralise a file into another.

    Parameters
    ----------
    job : dict            task ("optimize", "remesh" or "tetrahedralize"), source, target, and
                          options that differ from the defaults
    progress : callable   is told stage and share
    """
    from odt_plugins.adapters.files import read_file, write_file
    from odt_plugins.api import optimize_file
    from odt_plugins.cli.flags import length_or_name
    from odt_plugins.cli.named import resolve_arrays
    from odt_plugins.generate.fill import tetrahedralize
    from odt_plugins.remeshing import remesh

    source, options = Path(job["source"]), job["options"] | {"progress": progress}
    if job["task"] == "tetrahedralize":
        tetrahedralize(source, target=job["target"], **options)
        return
    named = {"density": "keep", "fixed": None, "selection": None} | options
    if job["task"] == "remesh":
        named = resolve_arrays(source, named) | {"size": length_or_name(options.get("size"))}
        del named["density"]
        if not {"cells", "size"} & set(options):
            named.setdefault("scale", 1.0)
        write_file(job["target"], remesh(read_file(source), **named))
        return
    optimize_file(source, job["target"], **resolve_arrays(source, named))


if __name__ == "__main__":
    main()
