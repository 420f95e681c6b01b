"""Cards of Nastran: elements, and the fields in which cards name grid points."""

from __future__ import annotations

import re

KINDS = {
    "CTETRA": {10: "tetra10", 4: "tetra"}, "CTRIA3": {3: "triangle"}, "CTRIAR": {3: "triangle"},
    "CTRIA6": {6: "triangle6"}, "CQUAD4": {4: "quad"}, "CQUADR": {4: "quad"},
    "CSHEAR": {4: "quad"}, "CHEXA": {8: "hexahedron"}, "CPENTA": {6: "wedge"},
    "CPYRAM": {5: "pyramid"}, "CPYRA": {5: "pyramid"}, "CROD": {2: "line"}, "CBAR": {2: "line"},
    "CBEAM": {2: "line"}, "CTUBE": {2: "line"},
}
"""Types of cells by the names of elements and their numbers of nodes, the largest first."""

MOST = {"CTETRA": 10, "CHEXA": 20, "CPENTA": 15, "CPYRAM": 13, "CPYRA": 13}
"""Numbers of fields for nodes of elements that may have some between their corners."""

ELEMENT = re.compile(r"(?!CORD|CAERO|CREEP|CSET|CONV|CY|CLOAD|CSSCHD|CBARAO|COMB)C[A-Z]+\d*")
"""Names of elements."""

WHERE = {
    "0": "CYSUP SNORM",
    "1": "FORCE MOMENT CONM1 CONM2 RFORCE RFORCE1 DVGRID TIC MICPNT",
    "2": "UNBALNC",
    "3": "EIGC",
    "9": "EIGR EIGB",
    "0 2": "RADBC",
    "1 2": "CONROD PLOTEL RBAR RBAR1 RROD RJOINT NLRGAP",
    "1 4": "SPC SPCD SPCR DAREA DELAY DPHASE NOLIN1 NOLIN3 NOLIN4",
    "1 4 6": "NOLIN2",
    "1 2 3": "RTRPLT RTRPLT1",
    "1 3 4": "FORCE1 MOMENT1",
    "1 3 4 5 6": "FORCE2 MOMENT2",
    "1 2 3 5 6 7": "CORD1R CORD1C CORD1S",
    "2 3": "CELAS3 CDAMP3 CMASS3 CELAS4 CDAMP4 CMASS4 CDAMP5 CVISC CBUSH1D CBUSH2D",
    "2 3 4": "CBUSH CGAP CBEND",
    "2 4": "CELAS1 CELAS2 CDAMP1 CDAMP2 CMASS1 CMASS2",
    "4 5": "PLOADX1",
    "5 6 7": "CHBDYP CFAST",
    "8 9": "CSEAM",
    "2 4 5 8:": "CWELD",
    "1:7:2": "TEMP SLOAD SUPORT1 USET SEBSET SECSET SEQSET",
    "::2": "ASET BSET CSET QSET OMIT SUPORT EXTRN BNDFIX BNDFREE SPCOFF",
    ":": "CYAX",
    "1:": ("ASET1 BSET1 CSET1 QSET1 OMIT1 BNDFIX1 BNDFREE1 BNDGRID SPCOFF1 SET1 SESET SELOC BLSEG "
           "PLOTEL3 PLOTEL4 PLOTEL6 PLOTEL8 PLOTTET PLOTHEX PLOTPEN PLOTPYR ROTORG CSUPEXT"),
    "2:": ("SET3 USET1 SEBSET1 SECSET1 SEQSET1 RELEASE SEBNDRY RBE3 RSPLINE RSSCON CYJOIN GENEL "
           "CONV CONVM PLOAD PLOADX CSUPER"),
    "3:": "TEMPBC",
    "4:": "QHBDY",
    "7:": "DRESP1",
    "8:": "ACCEL1 SECONCT VCCT CHBDYG",
    "1 3:": "RBE2",
    "1::8 3::8 5::8": "RBE1",
    "1::8 4::8": "MPC",
    "1 8::8": "TF",
    "1 4::4": "DMIG",
}
"""Cards that name grid points, by the fields that do: one, or from one to another by a step."""

NAMED = {name: tuple(
    slice(*(int(word) if word else None for word in part.split(":"))) if ":" in part
    else slice(int(part), int(part) + 1) for part in where.split())
    for where, names in WHERE.items() for name in names.split()}
"""Fields by the names of cards."""

NODES, RIGID = (slice(2, None),), (slice(1, None),)
"""Fields of other elements, and of other rigid ones."""

BEAMS, ORIENTED = ("CBAR", "CBEAM"), (slice(4, 5),)
"""Elements with a grid point in the field that tells how they are turned."""

LISTS = {"PLOAD2": ((0, 1), 2), "PLOAD4": ((0, 2, 3, 4, 5), 1), "BSURF": ((0,), 1),
         "SET3": ((0,), 2)}
"""Fields of cards that name elements: what they say of them, and the first number."""
