"""Plugin of ParaView: the filters ODT Optimize, Remesh, Quality and Tetrahedralize.

ParaView loads this file by its path, which `odt-plugins paraview` prints. Its Python has packages
of its own, so the work is done by the interpreter of the environment in which this package lies, or
by the one that ODT_PLUGINS_PYTHON names; meshes go there and back as files of VTK.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape, quoteattr

from paraview import print_error
from paraview.util.vtkAlgorithm import VTKPythonAlgorithmBase, smdomain, smproperty, smproxy

HOME = Path(__file__).resolve().parents[2]
"""Where the package lies. ParaView must not find the other packages there before its own."""

INTERPRETER = "ODT_PLUGINS_PYTHON"

PLAIN = ("objective", "boundary", "insert", "envelope", "threads")
"""Options that the panel shows; the others are advanced."""

RATIO = {"odt_radius_ratio": "quality", "odt_min_angle": "min_angle", "odt_max_angle": "max_angle",
         "odt_altitude": "altitude"}
"""Cell arrays of ODT Quality, and their names in CellFigures."""


def of_package(name: str) -> Any:
    """Import a module of this package that needs nothing but numpy."""
    sys.path.append(str(HOME))
    try:
        return import_module(f"odt_plugins.{name}")
    finally:
        sys.path.remove(str(HOME))


OPTIONS: Mapping[str, Any] = {
    name: about for name, about in of_package("options").OPTIONS.items()
    if about.metadata["flag"] is not None}


def interpreter() -> str:
    """The Python in which this package is installed.

    Raises
    ------
    FileNotFoundError    it cannot be told from the place of the package
    """
    if given := os.environ.get(INTERPRETER):
        return given
    for folder in HOME.parents:
        for name in ("bin/python3", "Scripts/python.exe", "python.exe"):
            if HOME.name == "site-packages" and (folder / name).is_file():
                return str(folder / name)
    msg = (f"got no Python that has odt-plugins: {HOME} is no site-packages; expected the variable "
           f"{INTERPRETER} to name one, try starting ParaView as `odt-plugins paraview` says")
    raise FileNotFoundError(msg)


def property_of(name: str, default: Any, told: Mapping[str, Any], plain: bool) -> str:
    """The property of ParaView for an option: a box, a list, a number or a text."""
    kind, inner, value = "String", "", default
    if told["choices"]:
        words = "".join(f"<String value={quoteattr(word)}/>" for word in told["choices"])
        inner = f'<StringListDomain name="list">{words}</StringListDomain>'
    elif isinstance(default, bool):
        kind, inner, value = "Int", '<BooleanDomain name="bool"/>', int(default)
    elif isinstance(default, int):
        kind, inner = "Int", f'<IntRangeDomain name="range" min="{told["least"]}"/>'
    elif isinstance(default, float):
        kind = "Double"
    elif isinstance(default, tuple):
        value = ",".join(default)
    elif name == "smoothing":
        value = ""
        told = {**told, "flag": "NAME=VALUE, such as solver=global, with a space between two."}
    words = f"{told['help']} {told['flag'] or ''}".strip()
    return (
        f'<{kind}VectorProperty name="{camel(name)}" command="Set{camel(name)}" '
        f'number_of_elements="1" default_values={quoteattr("" if value is None else str(value))} '
        f'panel_visibility="{"default" if plain else "advanced"}">{inner}'
        f"<Documentation>{escape(words)}</Documentation></{kind}VectorProperty>"
    )


def camel(name: str) -> str:
    """The name of a property: FeatureAngle for feature_angle."""
    return "".join(word.capitalize() for word in name.split("_"))


OWN = {"edge_length": (of_package("options").EDGE_LENGTH,
                       "For TetWild, relative to the diagonal of the surface."),
       "levels": (0, "How often the mesh of TetWild is refined, moved to the surface and "
                     "optimised."),
       "size": ("", "Length that edges should have, the name of a point or cell array of lengths, "
                    "or curvature: as coarse as the envelope allows."),
       "scale": (1.0, "Without Size and Cells: multiple of the local size that the input has."),
       "cells": (0, "Instead of Size: how many cells, about; 0 for none."),
       "growth": (1.3, "Largest ratio of the sizes at the ends of an edge as long as the smaller "
                       "one.")}
"""Properties beside the options: default and meaning."""

FILLING, SIZES = ("edge_length", "levels"), ("size", "scale", "cells", "growth")
"""Those of ODT Tetrahedralize and of ODT Remesh."""


def with_properties(names: Sequence[str]) -> Callable[[Any], Any]:
    """Give a filter the options of these names, and their values as `given`."""
    def decorate(kind: Any) -> Any:
        xml = ""
        for name in names:
            if name in OWN:
                default, words = OWN[name]
                told = {"help": words, "flag": "", "choices": (), "least": 0}
            else:
                default, told = OPTIONS[name].default, OPTIONS[name].metadata
            setattr(kind, f"Set{camel(name)}", _setter(name))
            xml += property_of(name, default, told, name in PLAIN or name in OWN)
        return smproperty.xml(xml)(kind)

    return decorate


def _setter(name: str) -> Callable[[Any, Any], None]:
    def setter(self: Any, value: Any) -> None:
        if self.given.get(name) != value:
            self.given[name] = value
            self.Modified()

    return setter


def chosen(given: Mapping[str, Any]) -> dict[str, Any]:
    """The values that differ from the defaults, as the package takes them."""
    out: dict[str, Any] = {}
    for name, value in given.items():
        default = OWN[name][0] if name in OWN else OPTIONS[name].default
        if isinstance(default, bool):
            value = bool(value)
        elif isinstance(default, tuple):
            words = (word.strip() for word in value.split(","))
            value = tuple(word for word in words if word not in ("", "none"))
        elif name == "smoothing":
            value, default = of_package("words").smoothing_of(value.split()), {}
        elif value == "":
            value = None
        elif default is None and "float" in str(OPTIONS[name].type):
            value = float(value)
        elif name == "regions" and value == "none":
            value = None
        if value != default:
            out[name] = value
    return out


class _Working(VTKPythonAlgorithmBase):  # type: ignore[misc]
    """A filter whose work is done by the package's own interpreter."""

    task, suffix = "", ".vtu"

    def RequestData(self, request: Any, inputs: Any, outputs: Any) -> int:
        """Write the input, let the package work, read the result."""
        from vtkmodules.vtkCommonDataModel import vtkDataObject

        data = vtkDataObject.GetData(inputs[0])
        out = vtkDataObject.GetData(outputs)
        try:
            with tempfile.TemporaryDirectory(prefix="odt-plugins-") as folder:
                source = os.path.join(folder, f"in{_suffix(data)}")
                target = os.path.join(folder, f"out{_suffix(out)}")
                _writer(data, source)
                said = self.worked({"task": self.task, "source": source, "target": target,
                                    "options": chosen(self.given)})
                if said is not None:
                    print_error(said)
                    return 0
                out.ShallowCopy(_read(target))
        except (OSError, ValueError) as exc:
            print_error(str(exc))
            return 0
        return 1

    def worked(self, job: Mapping[str, Any]) -> str | None:
        """Run the job, showing how far it is; the sentence of its error, None when it is done."""
        environment = {name: value for name, value in os.environ.items() if name != "PYTHONHOME"}
        environment["PYTHONPATH"] = str(HOME)
        errors = os.path.join(os.path.dirname(job["source"]), "errors")
        with (
            open(errors, "w", encoding="utf-8") as stderr,
            subprocess.Popen([interpreter(), "-m", "odt_plugins.cli.paraview"], text=True,
                             stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=stderr,
                             env=environment) as process,
        ):
            process.stdin.write(json.dumps(job))  # type: ignore[union-attr]
            process.stdin.close()  # type: ignore[union-attr]
            for line in process.stdout or ():
                told = json.loads(line)
                if "share" in told:
                    self.SetProgressText(told["stage"])
                    self.UpdateProgress(told["share"])
                elif "done" in told:
                    return None
                else:
                    return str(told["error"])
                if self.GetAbortExecute():
                    process.kill()
                    return "stopped before the end"
        with open(errors, encoding="utf-8") as file:
            lines = file.read().strip().splitlines()
        return f"the work ended without a result: {lines[-1] if lines else 'no word'}"


def _suffix(data: Any) -> str:
    return ".vtp" if data.IsA("vtkPolyData") else ".vtu"


def _writer(data: Any, path: str) -> None:
    from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter, vtkXMLUnstructuredGridWriter

    writer = (vtkXMLPolyDataWriter if path.endswith(".vtp") else vtkXMLUnstructuredGridWriter)()
    writer.SetFileName(path)
    writer.SetDataModeToBinary()
    writer.SetInputData(data)
    writer.Write()


def _read(path: str) -> Any:
    from vtkmodules.vtkIOXML import vtkXMLPolyDataReader, vtkXMLUnstructuredGridReader

    reader = (vtkXMLPolyDataReader if path.endswith(".vtp") else vtkXMLUnstructuredGridReader)()
    reader.SetFileName(path)
    reader.Update()
    return reader.GetOutput()


class _Same(_Working):
    """A filter whose output is of the class of its input."""

    def __init__(self) -> None:
        super().__init__(nInputPorts=1, nOutputPorts=1, inputType="vtkPointSet",
                         outputType="vtkPointSet")
        self.given: dict[str, Any] = {}

    def RequestDataObject(self, request: Any, inputs: Any, outputs: Any) -> int:
        """Make an output of the class of the input."""
        from vtkmodules.vtkCommonDataModel import vtkDataObject

        data, out = vtkDataObject.GetData(inputs[0]), vtkDataObject.GetData(outputs)
        if out is None or out.GetClassName() != data.GetClassName():
            outputs.GetInformationObject(0).Set(vtkDataObject.DATA_OBJECT(), data.NewInstance())
        return 1


@smproxy.filter(name="ODTOptimize", label="ODT Optimize")
@smproperty.input(name="Input", port_index=0)
@smdomain.datatype(dataTypes=["vtkUnstructuredGrid", "vtkPolyData"], composite_data_supported=False)
@with_properties(tuple(OPTIONS))
class ODTOptimize(_Same):
    """Improve tetrahedra, or triangles of a surface; the boundary and all data stay."""

    task = "optimize"


@smproxy.filter(name="ODTRemesh", label="ODT Remesh")
@smproperty.input(name="Input", port_index=0)
@smdomain.datatype(dataTypes=["vtkUnstructuredGrid", "vtkPolyData"], composite_data_supported=False)
@with_properties((*SIZES, *(name for name in OPTIONS
                            if name not in ("boundary", *of_package("options").NOT_SIZED))))
class ODTRemesh(_Same):
    """Make tetrahedra or triangles coarser or finer within the envelope; all data are carried."""

    task = "remesh"


@smproxy.filter(name="ODTQuality", label="ODT Quality")
@smproperty.input(name="Input", port_index=0)
@smdomain.datatype(dataTypes=["vtkUnstructuredGrid", "vtkPolyData"], composite_data_supported=False)
class ODTQuality(_Same):
    """Add radius ratio, angles and altitude of every tetrahedron or triangle as cell arrays."""

    def RequestData(self, request: Any, inputs: Any, outputs: Any) -> int:
        """Measure in ParaView itself: numpy is enough."""
        import numpy as np
        from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy
        from vtkmodules.vtkCommonDataModel import vtkDataObject

        data, out = vtkDataObject.GetData(inputs[0]), vtkDataObject.GetData(outputs)
        out.ShallowCopy(data)
        points = vtk_to_numpy(data.GetPoints().GetData()).astype(np.float64)
        for place, cells in _cells(data):
            figures = of_package("figures").cell_figures(points, cells)
            for name, figure in RATIO.items():
                values = np.full(data.GetNumberOfCells(), np.nan)
                values[place] = np.abs(getattr(figures, figure))
                array = numpy_to_vtk(values, deep=True)
                array.SetName(name)
                out.GetCellData().AddArray(array)
            out.GetCellData().SetActiveScalars(next(iter(RATIO)))
        return 1


def _cells(data: Any) -> list[tuple[Any, Any]]:
    """Places and vertices of the tetrahedra, or of the triangles where there are none."""
    import numpy as np
    from vtkmodules.util.numpy_support import vtk_to_numpy

    if data.IsA("vtkPolyData"):
        rows, first = data.GetPolys(), data.GetNumberOfVerts() + data.GetNumberOfLines()
        types = None
    else:
        rows, first, types = data.GetCells(), 0, vtk_to_numpy(data.GetCellTypesArray())
    offsets = vtk_to_numpy(rows.GetOffsetsArray())
    nodes = vtk_to_numpy(rows.GetConnectivityArray())
    corners = np.diff(offsets)
    for kind, count in ((10, 4), (5, 3)):
        found = corners == count if types is None else types == kind
        if found.any() and (types is not None or count == 3):
            start = offsets[:-1][found]
            return [(first + np.flatnonzero(found), nodes[start[:, None] + np.arange(count)])]
    return []


@smproxy.filter(name="ODTTetrahedralize", label="ODT Tetrahedralize")
@smproperty.input(name="Input", port_index=0)
@smdomain.datatype(dataTypes=["vtkPolyData"], composite_data_supported=False)
@with_properties((*FILLING, *(name for name in OPTIONS
                              if name not in of_package("options").OF_MESHES)))
class ODTTetrahedralize(_Working):
    """Fill a closed surface with tetrahedra by TetWild and improve them; labels are carried."""

    task = "tetrahedralize"

    def __init__(self) -> None:
        super().__init__(nInputPorts=1, nOutputPorts=1, inputType="vtkPolyData",
                         outputType="vtkUnstructuredGrid")
        self.given: dict[str, Any] = {}
