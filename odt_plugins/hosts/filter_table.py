"""The filters for MeshLab as a table: names, parameters, defaults, and how values are checked.

Those that move vertices change the current mesh in place, by way of meshes that are added
for a moment: those that are added to the set later have higher ids for that.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import inf
from numbers import Integral, Real
from typing import Any, Literal, get_args

import numpy as np

from odt_plugins.adapters.host import is_instance
from odt_plugins.errors import InvalidOptionError
from odt_plugins.options import DENSITIES, OPTIONS, SMOOTHING, Fields, Options, Smoothing

Kind = Literal["int", "float", "bool", "enum", "length", "string"]

RICH = {"int": "RichInt", "float": "RichFloat", "bool": "RichBool", "enum": "RichEnum",
        "length": "RichAbsPerc", "string": "RichString"}
"""Type names in the filter scripts of MeshLab."""


class ParameterError(InvalidOptionError):
    """A parameter of a filter has an unknown name or a wrong type."""


class ChoiceError(InvalidOptionError):
    """A parameter with fixed choices has another value."""


@dataclass(frozen=True)
class Parameter:
    """One parameter of a filter.

    Attributes
    ----------
    name : str             in Python; in filter scripts `gui`, of which it is the lower case
    gui : str
    kind : Kind
    default : object       of a length: percent of the bounding-box diagonal; None of a bool:
                           whether faces are selected
    title, help : str      the texts of MeshLab's dialogs
    choices : tuple        of an enum
    least : int            smallest value of an int
    """

    gui: str
    kind: Kind
    default: Any
    title: str
    help: str
    choices: tuple[str, ...] = ()
    least: int = 0

    @property
    def name(self) -> str:
        """Name in Python."""
        return self.gui.lower()

    def check(self, value: Any, diagonal: float) -> Any:
        """Bring a value into plain form; a length becomes a float in the caller's unit."""
        if self.kind == "enum":
            return self._choice(value)
        if self.kind == "bool":
            self._expect(isinstance(value, bool | np.bool_), value, "a bool")
            return bool(value)
        if self.kind == "string":
            self._expect(isinstance(value, str), value, "a str")
            return value
        if self.kind == "int":
            good = isinstance(value, Integral) and not isinstance(value, bool)
            good = good and int(value) >= self.least
            self._expect(good, value, f"an int of at least {self.least}")
            return int(value)
        if self.kind == "float":
            good = isinstance(value, Real) and not isinstance(value, bool)
            self._expect(good and self.least < float(value) < inf, value, "a positive number")
            return float(value)
        percent = is_instance(value, "pymeshlab", "PercentageValue")
        good = percent or is_instance(value, "pymeshlab", "PureValue")
        kinds = "a pymeshlab.PercentageValue or a pymeshlab.PureValue"
        self._expect(good, value, kinds)
        length = float(value.value()) * (diagonal / 100.0 if percent else 1.0)
        self._expect(0.0 < length < float("inf"), value.value(), "a positive length")
        return length

    def _choice(self, value: Any) -> str:
        """Take one of the choices by its text or its number, as MeshLab does."""
        if isinstance(value, Integral) and not isinstance(value, bool):
            last = len(self.choices) - 1
            if not 0 <= int(value) <= last:
                msg = f"Enum {value} not valid. Must be a value between 0 and {last}"
                raise ChoiceError(msg)
            return self.choices[int(value)]
        if not isinstance(value, str) or value not in self.choices:
            listed = " ".join(f"'{choice}';" for choice in self.choices)
            msg = f"Enum '{value}' not found. Possible values are {listed}"
            raise ChoiceError(msg)
        return value

    def _expect(self, good: bool, value: Any, expected: str) -> None:
        if not good:
            msg = f"Parameter {self.name}: got {value!r}; expected {expected}"
            raise ParameterError(msg)

    def default_value(self, diagonal: float, selected: bool) -> Any:
        """Value that is taken when none is given."""
        if self.kind == "length":
            return self.default * diagonal / 100.0
        return selected if self.default is None else self.default

    def from_script(self, entry: Mapping[str, str]) -> Any:
        """Take the value of a <Param> of a filter script; a length comes as a float.

        Raises
        ------
        ParameterError    the text is no value of this kind
        """
        text = entry.get("value", "")
        try:
            if self.kind == "int":
                return int(text)
            if self.kind == "string":
                return text
            if self.kind in ("float", "length"):
                return float(text)
            if self.kind == "bool":
                return {"true": True, "1": True, "false": False, "0": False}[text.lower()]
            return self.choices[int(text)] if text.isdigit() else text
        except (ValueError, KeyError, IndexError):
            self._expect(False, text, f"a value of type {RICH[self.kind]}")

    def to_script(self, value: Any, diagonal: float) -> dict[str, str]:
        """Attributes of its <Param> in a filter script, value as :meth:`check` gives it."""
        entry = {"name": self.gui, "type": RICH[self.kind], "description": self.title,
                 "tooltip": self.help}
        if self.kind == "enum":
            entry |= {f"enum_val{i}": choice for i, choice in enumerate(self.choices)}
            return entry | {"enum_cardinality": str(len(self.choices)),
                            "value": str(self.choices.index(value))}
        if self.kind == "bool":
            return entry | {"value": str(value).lower()}
        if self.kind == "length":
            entry |= {"min": "0", "max": repr(diagonal)}
        return entry | {"value": value if self.kind == "string" else repr(value)}


@dataclass(frozen=True)
class Filter:
    """One filter: its name in Python, its name in MeshLab's menus and scripts, what it does."""

    name: str
    gui: str
    help: str
    parameters: tuple[Parameter, ...]

    def values(self, given: Mapping[str, Any], diagonal: float, selected: bool) -> dict[str, Any]:
        """All parameters by name: those given, checked, and defaults for the others.

        Raises
        ------
        ParameterError, ChoiceError
        """
        known = {parameter.name: parameter for parameter in self.parameters}
        for name in given:
            if name not in known:
                msg = (f"Parameter {name} not found for filter {self.name}. "
                       f"Its parameters are {', '.join(known) or 'none'}.")
                raise ParameterError(msg)
        return {
            name: parameter.check(given[name], diagonal) if name in given
            else parameter.default_value(diagonal, selected)
            for name, parameter in known.items()
        }

    def doc(self) -> str:
        """Text of help()."""
        lines = [self.help, "", "Parameters", "----------"]
        for p in self.parameters:
            if p.kind == "length":
                default: Any = f"PercentageValue({p.default})"
            else:
                default = "whether faces are selected" if p.default is None else repr(p.default)
            choices = f" ({', '.join(map(repr, p.choices))})" if p.choices else ""
            lines.append(f"{p.name} : {p.kind} = {default}{choices}    {p.help}")
        return "\n".join(lines)


def _of_option(
    option: str, gui: str, kind: Kind, title: str, text: str = "", **more: Any
) -> Parameter:
    """The parameter that stands for an option: its default, limit and help unless MeshLab differs.

    Parameters
    ----------
    option : str        of :func:`odt_plugins.optimize`, or of its `smoothing`
    gui, kind, title    see :class:`Parameter`
    text : str          what MeshLab's users are told instead
    **more              further fields of :class:`Parameter`
    """
    about = (OPTIONS | SMOOTHING)[option]
    common = {"default": about.default, "least": about.metadata["least"]}
    return Parameter(gui, kind, title=title, help=text or about.metadata["help"],
                     **{**common, **more})


STEPS = _of_option(
    "rounds", "stepSmoothNum", "int", "Smoothing steps",
    "The largest number of smoothing steps; fewer are done when the energy has settled.",
    default=10)
SELECTED = _of_option(
    "selection", "Selected", "bool", "Affect only selection",
    "Only vertices whose faces are all selected move; without selected faces, selected vertices.")
BOUNDARY = _of_option(
    "boundary", "Boundary", "bool", "1D Boundary Smoothing",
    "Whether the rims and feature lines of a curved surface move along themselves; otherwise they "
    "stay as they are. The boundary of a planar mesh always stays.", default=False)
DENSITY = _of_option("density", "Density", "enum", "Density", choices=DENSITIES)
ENVELOPE = _of_option(
    "envelope", "Envelope", "length", "Envelope",
    "How far a curved surface may get from what it was, and that from it.",
    default=100.0 * Options.envelope)
ANGLE = _of_option("feature_angle", "FeatureDeg", "float", "Crease Angle")
KEEP = _of_option(
    "keep", "keepQuality", "bool", "Keep quality",
    "No figure (smallest, 1 % and mean radius ratio, extreme angles) may get worse.", default=True)
REGIONS = _of_option(
    "regions", "Regions", "string", "Regions",
    "Custom scalar attribute of the faces that holds labels; edges between labels stay. Empty: one "
    "of a known name; charts: the seams of the texture of a curved surface stay as well.",
    default=OPTIONS["regions"].default or "")
OBJECTIVE = _of_option(
    "objective", "Objective", "enum", "Objective",
    choices=OPTIONS["objective"].metadata["choices"])
INSERT = _of_option(
    "insert", "Insert", "bool", "Add and remove vertices",
    "Whether vertices may be added and removed inside: as many as pay, at most half as many again.")
ROUNDS = replace(STEPS, default=Smoothing.rounds)
ITERATIONS = _of_option("cycles", "Iterations", "int", "Iterations", least=1)

FIELDS = _of_option("fields", "Fields", "enum", "Vertex values", choices=get_args(Fields))
LAYERS = _of_option(
    "free", "freeLayers", "bool", "Free layers",
    "Whether many triangles of a planar mesh that are stretched alike with their neighbours are "
    "treated as any other; otherwise they stay as they are.", default=False)

TARGET = Parameter("TargetLen", "length", 1.0, "Target Length",
                   "Length that edges are to have; with Adaptive they have none in common.")
ADAPTIVE = Parameter("Adaptive", "bool", False, "Adaptive remeshing",
                     "Edges are as long as the surface distance allows where it is curved, and "
                     "grow from there.")
COUNT = Parameter("TargetFaceNum", "int", 0, "Target number of faces",
                  "About how many faces there are to be, whatever the target length; 0: any.")
ADAPT = Parameter(
    "AdaptTo", "string", "", "Adapt to",
    "Custom scalar attribute of the vertices, or vertex scalar, which is their quality, to whose "
    "second derivatives lengths and shapes of faces are adapted; with a target number of faces.")
SELECTED_ONLY = Parameter(
    "SelectedOnly", "bool", False, "Remesh only selected faces",
    "Other faces stay; without selected faces, vertices that are not selected.")

IDS = " Two ids of the MeshSet are used up."

MOVING = (STEPS, BOUNDARY, DENSITY, FIELDS, LAYERS, KEEP, ENVELOPE, ANGLE, REGIONS, SELECTED)

_ALL = (
    Filter(
        "apply_coord_odt_smoothing", "ODT Smoothing",
        "Smooth a mesh by Optimal Delaunay Triangulation: every vertex moves towards the weighted "
        "mean of the circumcenters of its faces, on a curved surface along it. Edges are not "
        "flipped; the boundary, also that of polylines and labelled regions, stays." + IDS,
        MOVING),
    Filter(
        "apply_coord_cpt_smoothing", "CPT Smoothing",
        "Smooth a mesh by Centroidal Patch Triangulation: every vertex moves towards the weighted "
        "mean of the barycenters of its faces, on a curved surface along it. Edges are not "
        "flipped." + IDS, MOVING),
    Filter(
        "apply_coord_odt_global_smoothing", "ODT Global Smoothing",
        "Smooth a mesh by Optimal Delaunay Triangulation, all vertices at once by a linear system "
        "in every step. Edges are not flipped." + IDS, MOVING),
    Filter(
        "meshing_odt_optimization", "ODT Optimization",
        "Improve a planar or curved mesh by Optimal Delaunay Triangulation: moves vertices and "
        "flips edges. On a curved surface vertices slide within an envelope of it. "
        "The mesh is changed in its place, and Mesh objects of it stay valid. Only with custom "
        "attributes or curvature directions of faces, or edges of three faces, it is built anew; "
        "then it gets a new id, and a warning says so, while a mesh of the set is in use as a Mesh "
        "object (the old mesh stays in the set if it is that one), or another has several "
        "textures or one without wedge texture coordinates, or while there are rasters. Up to 18 "
        "ids of the MeshSet are used up.",
        (ROUNDS, ITERATIONS, BOUNDARY, DENSITY, FIELDS, LAYERS, OBJECTIVE, KEEP, ENVELOPE, ANGLE,
         REGIONS, SELECTED)),
    Filter(
        "meshing_odt_remeshing", "ODT Remeshing",
        "Give a planar or curved mesh edges of a length: splits, collapses and flips edges, moves "
        "vertices, and optimizes what it gets. The surface stays within a distance of what it was "
        "and that within it of the surface, both ways. The mesh is built anew, see "
        "meshing_odt_optimization.",
        (TARGET, ADAPTIVE, COUNT, ADAPT, ANGLE,
         replace(ENVELOPE, gui="MaxSurfDist", title="Max. Surface Distance"), FIELDS, REGIONS,
         SELECTED_ONLY)),
    Filter(
        "compute_scalar_by_radius_ratio_per_face", "Per Face Quality by Radius Ratio",
        "Store in the scalar of every face its radius ratio 2 r/R, 1 for an equilateral triangle "
        "and 0 for a flat one. MeshLab's function filters crash on custom attributes of faces "
        "unless these were added to a mesh inside of the set: a mesh that has any is first built "
        "anew in its place, as by meshing_odt_optimization.", ()),
    Filter(
        "generate_odt_tetrahedralization", "ODT Tetrahedralization",
        "Fill the current mesh with tetrahedra by TetWild, improve them by Optimal Delaunay "
        "Triangulation, and add their boundary as a new mesh. The tetrahedra are in the result: "
        "tet_vertex_matrix (n, 3), tet_matrix (m, 4), and boundary_vertex_index, which of their "
        "vertices the new mesh has.",
        (
            Parameter("TargetLen", "length", 5.0, "Target Length",
                      "Edge length of the tetrahedra."),
            Parameter("MaxSurfDist", "length", 0.1, "Max. Surface Distance",
                      "How far the boundary may lie from the surface."),
            ROUNDS, ITERATIONS, DENSITY, OBJECTIVE, INSERT, KEEP,
        )),
)

FILTERS = {filter.name: filter for filter in _ALL}
"""All filters by their Python name."""

BY_GUI = {filter.gui: filter for filter in _ALL}
"""All filters by their name in MeshLab's menus and scripts."""
