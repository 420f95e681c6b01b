"""What tests/hosts/test_paraview.py lets ParaView's own Python do; FOLDER holds its files.

pvpython --force-offscreen-rendering tests/hosts/paraview_session.py FOLDER PLUGIN
"""

import inspect
import json
import os
import sys

inspect.getargspec = getattr(inspect, "getargspec", inspect.getfullargspec)

from paraview import simple  # noqa: E402
from vtkmodules.numpy_interface import dataset_adapter  # noqa: E402

folder, plugin = sys.argv[1:]
simple.LoadPlugin(plugin)


def facts(source):
    """What a filter gives."""
    source.UpdatePipeline()
    data = simple.servermanager.Fetch(source)
    wrapped = dataset_adapter.WrapDataObject(data)
    return {"class": data.GetClassName(), "cells": data.GetNumberOfCells(),
            "arrays": {name: wrapped.CellData[name].tolist() for name in wrapped.CellData.keys()},
            "fields": wrapped.PointData.keys()}


def draw(meshes, name):
    """Meshes cut open beside each other, coloured by radius ratio."""
    view = simple.CreateRenderView(ViewSize=[900, 420], Background=[1, 1, 1])
    view.UseColorPaletteForBackground = 0
    view.OrientationAxesVisibility = 0
    box = meshes[0].GetDataInformation().DataInformation.GetBounds()
    for k, mesh in enumerate(meshes):
        cut = simple.Clip(Input=mesh, Crinkleclip=1)
        cut.ClipType.Normal = [0, 1, 0]
        cut.ClipType.Origin = [0.5 * (box[i] + box[i + 1]) for i in (0, 2, 4)]
        shown = simple.Show(cut, view)
        shown.SetRepresentationType("Surface With Edges")
        shown.Position = [1.1 * k * (box[1] - box[0]), 0, 0]
        simple.ColorBy(shown, ("CELLS", "odt_radius_ratio"))
    simple.GetColorTransferFunction("odt_radius_ratio").RescaleTransferFunction(0.1, 0.9)
    view.CameraViewUp = [0, 0, 1]
    view.CameraPosition, view.CameraFocalPoint = [0, 1, 0], [0, 0, 0]
    view.ResetCamera()
    simple.GetActiveCamera().Dolly(1.8)
    simple.SaveScreenshot(os.path.join(folder, name), view)


found = {}
mesh = simple.XMLUnstructuredGridReader(FileName=[os.path.join(folder, "mesh.vtu")])
before = simple.ODTQuality(Input=mesh)
optimize = simple.ODTOptimize(Input=mesh)
found["properties"] = sorted(optimize.ListProperties())
found["choices"] = list(optimize.GetProperty("Objective").Available)
told = []
optimize.SMProxy.GetClientSideObject().AddObserver(
    "ProgressEvent", lambda source, event: told.append(source.GetProgress()))
optimize.Smoothing = "exponent=4 rounds=10"
after = simple.ODTQuality(Input=optimize)
found["before"], found["after"] = facts(before), facts(after)
found["progress"] = told
draw([before, after], "shot.png")

optimize.Smoothing = "exponent=-4"
found["refused"] = facts(optimize)["cells"]

surface = simple.XMLPolyDataReader(FileName=[os.path.join(folder, "surface.vtp")])
found["surface"] = facts(simple.ODTQuality(Input=simple.ODTOptimize(Input=surface,
                                                                    Smoothing="rounds=3")))
coarse = simple.ODTRemesh(Input=surface)
coarse.Size, coarse.Envelope = "1.2", 0.1
found["coarse"] = facts(coarse)
filled = simple.ODTTetrahedralize(Input=surface)
filled.EdgeLength = 0.15
filled.Smoothing = "rounds=5"
found["filled"] = facts(filled)
with open(os.path.join(folder, "found.json"), "w") as file:
    json.dump(found, file)
