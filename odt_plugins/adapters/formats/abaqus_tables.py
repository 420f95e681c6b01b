"""Elements of Abaqus and CalculiX: what they are, and the nodes of their faces."""

from __future__ import annotations

import re

SOLID = r"(?:C|DC|DCC|AC|Q|EMC|EC)3D(\d+)(?!\d|V)[A-Z]*"
PLANE = r"(?:CPS|CPE|CPEG|CAX|CGAX|DC2D|DCAX|DCCAX|AC2D|ACAX|EMC2D|WARP2D)(\d+)(?!\d|V)[A-Z]*"
SHELL = r"(?:S|DS|STRI|M3D|R3D|SFM3D)(3|4|6|65|8|9)(?![0-46-9])[A-Z]*5?"
LINE = r"(?:T2D2|T3D2|B21|B23|B31|B33|DC1D2|R2D2|PIPE21|PIPE31|AC1D2)[A-Z]*"

SOLIDS = {"4": "tetra", "5": "pyramid", "6": "wedge", "8": "hexahedron", "10": "tetra10",
          "13": "pyramid13", "15": "wedge15", "20": "hexahedron20"}

SURFACES = {"3": "triangle", "4": "quad", "6": "triangle6", "65": "triangle6", "8": "quad8",
            "9": "quad9"}

NODES = {"line": 2, "triangle": 3, "quad": 4, "triangle6": 6, "quad8": 8, "quad9": 9, "tetra": 4,
         "pyramid": 5, "wedge": 6, "hexahedron": 8, "tetra10": 10, "pyramid13": 13, "wedge15": 15,
         "hexahedron20": 20}
"""Numbers of nodes of types of cells."""

SIDES = {2: "line", 3: "triangle", 6: "triangle6"}
"""Types of faces by their numbers of nodes; three nodes are those of a curved line in the plane."""


NAMING = dict.fromkeys((
    "BOUNDARY", "CLOAD", "CFLUX", "CFLOW", "CECHARGE", "CECURRENT", "CONCENTRATIONFLUX",
    "CVELOCITY", "TEMPERATURE", "FIELD", "PRESSURESTRESS", "MASSFLOWRATE", "NODALTHICKNESS",
    "NODALENERGYRATE", "INITIALCONDITIONS", "KINEMATICCOUPLING", "DISTRIBUTINGCOUPLING",
    "DISTRIBUTING", "KINEMATIC", "IMPERFECTION", "RETAINEDNODALDOFS", "SUBMODEL", "MOTION",
    "TRANSPORTVELOCITY", "SURFACE", "INCIDENTWAVEPROPERTY", "ACOUSTICWAVEFORMULATION",
    "RIGIDBODY", "PRETENSIONSECTION", "TRACERPARTICLE", "DESIGNRESPONSE", "CONNECTORMOTION",
    "MASSADJUST", "FASTENER"), slice(0, 1)) | dict.fromkeys(
    ("MPC", "SLIDELINE", "CONTOURINTEGRAL", "ORIENTATION"), slice(0, None)) | {
    "NORMAL": slice(1, 2), "EQUATION": slice(0, None, 3)}
"""Keywords whose lines name nodes, and the words that do."""

OF_ELEMENTS = ("STRESS", "HARDENING", "SOLUTION", "PLASTICSTRAIN", "POROSITY", "RELATIVEDENSITY",
               "SPECIFICENERGY", "REBAR", "DAMAGEINITIATION", "ENRICHMENT")
"""Types of initial conditions of elements."""


OF_MESHES = ("HEADING", "PREPRINT", "NODE", "ELEMENT", "NSET", "ELSET", "SURFACE", "INCLUDE",
             "PART", "ENDPART", "ASSEMBLY", "ENDASSEMBLY", "INSTANCE", "ENDINSTANCE", "ENDSTEP")
"""Keywords that say no more than what a mesh holds."""

WORDS = {"tetra": "C3D4", "tetra10": "C3D10", "hexahedron": "C3D8", "hexahedron20": "C3D20",
         "wedge": "C3D6", "wedge15": "C3D15", "pyramid": "C3D5"}
"""Elements in space by types of cells."""

IN_SPACE = {"triangle": "S3", "triangle6": "STRI65", "quad": "S4", "quad8": "S8R", "line": "T3D2"}
IN_PLANE = {"triangle": "CPS3", "triangle6": "CPS6", "quad": "CPS4", "quad8": "CPS8",
            "line": "T2D2"}
"""Those of surfaces, and of meshes in the plane."""

PLAIN = {*WORDS.values(), *IN_SPACE.values(), *IN_PLANE.values()}
"""Elements that say no more than the type of a cell."""


def type_of(name: str) -> str | None:
    """Type of the cells that an element is; None where it is none, or not known."""
    found = re.fullmatch(SOLID, name)
    if found:
        return SOLIDS.get(found[1])
    found = re.fullmatch(PLANE, name) or re.fullmatch(SHELL, name)
    if found:
        return SURFACES.get(found[1])
    return "line" if re.fullmatch(LINE, name) else None


def is_shell(name: str) -> bool:
    """Whether faces with a number are those of the element, not of its edges."""
    return re.fullmatch(SHELL, name) is not None
