"""Tecplot's files of text with one zone of finite elements, whose head stays as it is."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.formats.change import Change, NotRewritable
from odt_plugins.adapters.formats.decks import unread
from odt_plugins.errors import MeshFileError

KINDS = {"LINESEG": ("line", 2), "TRIANGLE": ("triangle", 3), "QUADRILATERAL": ("quad", 4),
         "TETRAHEDRON": ("tetra", 4), "BRICK": ("hexahedron", 8)}
"""Types of cells by what files call them, and their numbers of nodes."""

RECORD = (r"(?im)^[ \t]*(TITLE|FILETYPE|VARIABLES|ZONE|TEXT|GEOMETRY|DATASETAUXDATA|VARAUXDATA|"
          r"CUSTOMLABELS)\b")
"""Where a record of a file starts."""

NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d+)?"
DATA = rf"(?m)^[ \t,]*(?:\d+\*)?{NUMBER}(?=[\s,]|\Z)"
"""Where numbers start a line."""

PAIR = r"(?i)(AUXDATA\s+[\w.]+|[A-Z]\w*)\s*=\s*(\"[^\"]*\"|\([^)]*\)|[^\s,]+)"
"""A word of the head of a zone and its value."""

AXIS = r"(?i)(?:coordinates?[ _]*)?([xyz])(?:[ _]*[\[(].*)?"
"""A variable that is a coordinate."""

KNOWN = {"T", "N", "NODES", "E", "ELEMENTS", "F", "ET", "DATAPACKING", "ZONETYPE", "VARLOCATION",
         "NV", "DT", "C"}
"""Words of the head of a zone that say nothing which a mesh does not hold."""

ROW = 10
"""Numbers in a line."""


class Parts(NamedTuple):
    """A file, taken apart.

    Attributes
    ----------
    text : str
    zone : int              where the head of the zone starts
    data : int              where its numbers start
    end : int               where they end
    variables : list of str
    words : dict            of the head of the zone
    centred : NDArray       whether a variable is one of the cells
    numbers : (k,) float    all that follow the head
    """

    text: str
    zone: int
    data: int
    end: int
    variables: list[str]
    words: dict[str, str]
    centred: NDArray[np.bool_]
    numbers: NDArray[np.float64]

    @property
    def counts(self) -> tuple[int, int]:
        """Numbers of nodes and of cells."""
        both = [self.words.get(one, self.words.get(two, ""))
                for one, two in (("N", "NODES"), ("E", "ELEMENTS"))]
        if not all(re.fullmatch(r"\d+", word) for word in both):
            msg = "its zone has no numbers of nodes and elements, expected one of finite elements"
            raise MeshFileError(msg)
        return int(both[0]), int(both[1])

    @property
    def block(self) -> bool:
        """Whether the values of a variable stand together, and not those of a node."""
        word = self.words.get("DATAPACKING") or self.words.get("F", "POINT").upper()
        return word.upper().endswith("BLOCK")

    @property
    def kind(self) -> tuple[str, int]:
        """Type of the cells and their number of nodes."""
        word = self.words.get("ZONETYPE") or self.words.get("ET", "")
        found = KINDS.get(word.upper().removeprefix("FE"))
        if found is None:
            msg = f"its zone is of type {word or 'ORDERED'}, expected one of finite elements"
            raise MeshFileError(msg)
        return found

    @property
    def axes(self) -> list[int]:
        """Places of the coordinates among the variables."""
        found: dict[str, int] = {}
        for i, name in enumerate(self.variables):
            known = re.fullmatch(AXIS, name.strip())
            if known and not self.centred[i]:
                found.setdefault(known[1].lower(), i)
        if not {"x", "y"} <= found.keys():
            msg = f"it has no variables X and Y among {', '.join(self.variables)}"
            raise MeshFileError(msg)
        return [found[axis] for axis in "xyz" if axis in found]


def _apart(path: Path) -> Parts:
    """Take a file apart.

    Raises
    ------
    MeshFileError    it has no zone, or several, or one whose data are elsewhere
    """
    raw = path.read_bytes()
    if b"\0" in raw:
        msg = "it is a binary file, expected one of text"
        raise MeshFileError(msg)
    text = re.sub(r"\r\n?", "\n", raw.decode("utf-8", "surrogateescape"))
    plain = re.sub(r"(?m)^[ \t]*#.*$", lambda found: " " * len(found[0]), text)
    records = [(found.start(), found[1].upper()) for found in re.finditer(RECORD, plain)]
    zones = [at for at, word in records if word == "ZONE"]
    if len(zones) != 1:
        msg = (f"it has {len(zones)} zones, expected one, try a file for each zone" if zones
               else "it has no zone")
        raise MeshFileError(msg)
    zone = zones[0]
    ends = [at for at, _ in records if at > zone] + [len(text)]
    start = re.compile(DATA).search(plain, zone)
    data = start.start() if start else len(text)
    end = next(at for at in ends if at >= min(data, len(text)))
    stops = dict(zip([at for at, _ in records], [at for at, _ in records][1:], strict=False))
    listed = [plain[at: stops[at]] for at, word in records if word == "VARIABLES" and at < zone]
    names = re.findall(r'"([^"]*)"|([^\s,="]+)', "".join(listed).partition("=")[2])
    variables = [quoted or bare for quoted, bare in names]
    words = {key.upper(): value for key, value in re.findall(PAIR, plain[zone:data])}
    shared = {"VARSHARELIST", "CONNECTIVITYSHAREZONE", "PASSIVEVARLIST", "D"} & words.keys()
    if shared:
        msg = f"its zone has {', '.join(sorted(shared))}, which is not read here"
        raise MeshFileError(msg)
    return Parts(text, zone, data, end, variables, words, _centred(words, len(variables)),
                 _numbers(plain[data:end]))


def _centred(words: dict[str, str], count: int) -> NDArray[np.bool_]:
    """Which variables have a value for each cell."""
    out = np.zeros(count, dtype=np.bool_)
    if "NV" in words:
        out[int(words["NV"]):] = True
    given = re.sub(r"\s", "", words.get("VARLOCATION", "")).upper()
    for places, where in re.findall(r"(\[[\d,-]+\]|\d+)=(NODAL|CELLCENTERED)", given):
        for first, last in re.findall(r"(\d+)(?:-(\d+))?", places):
            out[int(first) - 1: int(last or first)] = where == "CELLCENTERED"
    bare = given.strip("()")
    if bare and "=" not in bare:
        for i, where in enumerate(bare.split(",")[:count]):
            out[i] = where == "CELLCENTERED"
    return out


def _numbers(text: str) -> NDArray[np.float64]:
    """All numbers of a text, also such as 3*0.5 and 1.5D3."""
    words = text.replace(",", " ").split()
    if "*" in text:
        parts = [word.rpartition("*") for word in words]
        words = [value for many, _, value in parts for _ in range(int(many or 1))]
    if re.search("[dD]", text):
        words = [re.sub("[dD]", "e", word) for word in words]
    return np.array(words, dtype=object).astype(np.float64)


def read(path: Path) -> Any:
    """Read the one zone of a file; variables are arrays of points or cells.

    Raises
    ------
    MeshFileError    it has no zone of finite elements, or several, or ends too early
    """
    from meshio import Mesh

    parts = _apart(path)
    (nodes, elements), (kind, width) = parts.counts, parts.kind
    sizes = [elements if centred else nodes for centred in parts.centred]
    if len(parts.numbers) < sum(sizes) + elements * width:
        msg = "it ends too early"
        raise MeshFileError(msg)
    values, rest = np.split(parts.numbers[: sum(sizes) + elements * width], [sum(sizes)])
    if parts.block:
        columns = np.split(values, np.cumsum(sizes)[:-1])
    elif parts.centred.any():
        msg = "its zone has variables of cells at points"
        raise MeshFileError(msg)
    else:
        columns = list(values.reshape(nodes, len(sizes)).T)
    cells = rest.reshape(elements, width)
    bad = cells[(cells < 1) | (cells > nodes) | (cells != np.floor(cells))]
    if bad.size:
        msg = f"a {kind} refers to node {bad[0]:g} of {nodes}"
        raise MeshFileError(msg)
    others = [i for i in range(len(sizes)) if i not in parts.axes]
    mesh = Mesh(
        np.stack([columns[i] for i in parts.axes], axis=1),
        [(kind, cells.astype(np.int64) - 1)],
        {parts.variables[i]: columns[i].copy() for i in others if not parts.centred[i]},
        {parts.variables[i]: [columns[i].copy()] for i in others if parts.centred[i]})
    more = [word.split()[0] for word in parts.words if word not in KNOWN]
    outside = parts.text[: parts.zone] + parts.text[parts.end:]
    more += {word.upper() for word in re.findall(RECORD, outside)} - {"TITLE", "VARIABLES",
                                                                      "FILETYPE"}
    mesh.info = unread("the records", more)
    return mesh


def rewrite(source: Path, target: Path, change: Change) -> list[str]:
    """Write a file with the same head and end, other numbers of nodes and elements, and others."""
    parts, after = _apart(source), change.after
    points = np.asarray(after.points)
    columns = []
    for i, name in enumerate(parts.variables):
        if i in parts.axes:
            columns.append(points[:, parts.axes.index(i)])
            continue
        home = after.cell_data if parts.centred[i] else after.point_data
        if name not in home:
            msg = f"there is no array {name!r} any more"
            raise NotRewritable(msg)
        columns.append(np.asarray(home[name][0] if parts.centred[i] else home[name]))
    cells = np.asarray(after.cells[0].data) + 1
    lines = [] if parts.block else _rows(np.stack(columns, axis=1))
    for column in columns if parts.block else ():
        lines += [" ".join(map(repr, column[at: at + ROW].tolist()))
                  for at in range(0, len(column), ROW)]
    lines += _rows(cells)
    count = {"N": len(points), "NODES": len(points), "E": len(cells), "ELEMENTS": len(cells)}
    head = re.sub(PAIR, lambda found: found[0] if found[1].upper() not in count else
                  f"{found[0].removesuffix(found[2])}{count[found[1].upper()]}",
                  parts.text[parts.zone: parts.data])
    text = parts.text[: parts.zone] + head + "\n".join(lines) + "\n" + parts.text[parts.end:]
    target.write_bytes(text.encode("utf-8", "surrogateescape"))
    return []


def _rows(table: NDArray[Any]) -> list[str]:
    return [" ".join(map(repr, row)) for row in table.tolist()]
