"""The XML of XDMF files with the place of every tag, and the numbers that it holds or refers to."""

from __future__ import annotations

import re
from math import prod
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from odt_plugins.errors import MeshFileError

STEP = re.compile(r"(//?)([\w.:*-]+)((?:\[(?:[^\]\"']|\"[^\"]*\"|'[^']*')*\])*)")
"""A step of a path of XPath: axis, name and tests."""

TEST = re.compile(r"\[((?:[^\]\"']|\"[^\"]*\"|'[^']*')*)\]")

TAG = re.compile(rb"<[^\s/>]+(?:\s+[^\s=]+\s*=\s*(?:\"[^\"]*\"|'[^']*'))*\s*/?>")
"""A tag that begins an element."""

TYPES = {"float": "f", "int": "i", "uint": "u", "char": "i", "uchar": "u", "short": "i"}
"""Letters of NumPy's types by their names in files."""

SIZES = {"char": 1, "uchar": 1, "short": 2}
"""Bytes of the types whose name tells their number."""

DEEPEST = 16
"""Most references from one element to the next."""


class Document(NamedTuple):
    """An XML file: its path, bytes, root, and the first and last byte of every opening tag."""

    path: Path
    data: bytes
    root: Any
    tags: dict[Any, tuple[int, int]]


class Stored(NamedTuple):
    """Where the numbers of an item are: a file, and a path within it or a place in bytes."""

    file: Path
    inside: str
    seek: int


def parse(path: Path) -> Document:
    """Parse a file.

    Raises
    ------
    MeshFileError    it is no XML, or none of XDMF
    """
    data = path.read_bytes()
    builder = ElementTree.TreeBuilder()
    tags: dict[Any, tuple[int, int]] = {}
    parser = expat.ParserCreate()

    def start(name: str, attributes: dict[str, str]) -> None:
        at = parser.CurrentByteIndex
        found = TAG.match(data, at)
        tags[builder.start(name, attributes)] = (at, found.end() if found else at)

    parser.StartElementHandler = start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.data
    try:
        parser.Parse(data, True)
    except expat.ExpatError as exc:
        msg = f"its XML ends or breaks at line {exc.lineno} ({expat.ErrorString(exc.code)})"
        raise MeshFileError(msg) from exc
    root: Any = builder.close()
    if local(root) != "Xdmf":
        msg = f"its XML is one of <{root.tag}> and not of <Xdmf>"
        raise MeshFileError(msg)
    return Document(path, data, root, tags)


def local(element: Any) -> str:
    """Name of an element without the prefix of a namespace."""
    return str(element.tag).rpartition(":")[2]


def found(doc: Document, path: str) -> list[Any]:
    """Elements that an absolute path of XPath names, as XInclude and references have them.

    Raises
    ------
    MeshFileError    it has other tests than of places, attributes and names
    """
    pointer = re.fullmatch(r"xpointer\((.*)\)", path.strip(), re.DOTALL)
    text = (pointer[1] if pointer else path).strip()
    here: list[Any] = []
    for i, (axis, name, tests) in enumerate(STEP.findall(text)):
        pools = [list(e) for h in here for e in (h.iter() if axis == "//" else [h])]
        if i == 0:
            pools = [[doc.root]]
            pools += [list(e) for e in doc.root.iter()] if axis == "//" else []
        here = []
        for pool in pools:
            chosen = [e for e in pool if name in ("*", e.tag, local(e))]
            for test in TEST.findall(tests):
                chosen = _tested(chosen, test.strip(), text)
            here += chosen
    return here


def _tested(elements: list[Any], test: str, path: str) -> list[Any]:
    place = re.fullmatch(r"(?:position\(\)\s*=\s*)?(\d+)", test)
    value = re.fullmatch(r"@([\w:.-]+)\s*=\s*(?:\"([^\"]*)\"|'([^']*)')", test)
    names = re.fullmatch(r"self::[\w:]+(?:\s+or\s+self::[\w:]+)*", test)
    if place:
        return elements[int(place[1]) - 1: int(place[1])]
    if test == "last()":
        return elements[-1:]
    if value:
        return [e for e in elements if e.get(value[1]) == (value[2] or value[3] or "")]
    if names:
        known = re.findall(r"self::([\w:]+)", test)
        return [e for e in elements if e.tag in known or local(e) in known]
    msg = f"it refers to {path}, of which [{test}] is not understood"
    raise MeshFileError(msg)


def resolved(doc: Document, element: Any) -> Any:
    """The element itself, or what it refers to.

    Raises
    ------
    MeshFileError    that is not there
    """
    for _ in range(DEEPEST):
        reference = element.get("Reference")
        if reference is None:
            return element
        path = (element.text or "") if reference.upper() == "XML" else reference
        others = [e for e in found(doc, path) if local(e) == local(element)]
        if not others:
            break
        element = others[0]
    msg = f"it refers to {' '.join(path.split())[:80]}, which is not there"
    raise MeshFileError(msg)


def items_of(doc: Document, element: Any) -> list[Any]:
    """Items of numbers within an element, as what they refer to."""
    return [resolved(doc, child) for child in element if local(child) == "DataItem"]


def form_of(item: Any) -> str:
    """How an item is stored: xml, hdf or binary."""
    return str(item.get("Format", "XML")).strip().lower()


def type_of(item: Any) -> np.dtype[Any]:
    """Type of the numbers of an item, as its attributes tell."""
    name = item.get("NumberType", item.get("DataType", "Float")).strip().lower()
    size = SIZES.get(name, int(item.get("Precision", 4)))
    if name not in TYPES or size not in (1, 2, 4, 8):
        msg = f"it has numbers of type {name} in {size} bytes"
        raise MeshFileError(msg)
    order = {"big": ">", "little": "<"}.get(item.get("Endian", "").lower(), "=")
    return np.dtype(f"{order}{TYPES[name]}{size}")


def stored(doc: Document, item: Any) -> Stored:
    """Where the numbers of an item of a form other than XML are.

    Raises
    ------
    MeshFileError    the file is missing
    """
    text = (item.text or "").strip()
    name, _, inside = text.rpartition(":") if form_of(item) == "hdf" else (text, "", "")
    file = doc.path.parent / name.strip()
    if not name or not file.is_file():
        msg = f"its data are in {name.strip() or 'a file without a name'}, which is missing"
        raise MeshFileError(msg)
    return Stored(file, inside.strip(), int(item.get("Seek", 0)))


def slab(doc: Document, item: Any) -> tuple[Any, tuple[slice, ...]] | None:
    """The item from which one is cut, and the part; None of what is no part of another."""
    kind = str(item.get("ItemType", "Uniform")).lower()
    if kind == "uniform":
        return None
    parts = items_of(doc, item)
    if kind != "hyperslab" or len(parts) != 2:
        msg = f"it has items of type {item.get('ItemType')}"
        raise MeshFileError(msg)
    start, stride, count = values_of(doc, parts[0]).reshape(3, -1).astype(np.int64).tolist()
    return parts[1], tuple(slice(s, s + (n - 1) * step + 1, step)
                           for s, step, n in zip(start, stride, count, strict=True))


def values_of(doc: Document, item: Any) -> NDArray[Any]:
    """Numbers of an item, in the shape that it states.

    Raises
    ------
    MeshFileError    it holds others than it declares, or they are in a form that is not known
    """
    part = slab(doc, item)
    if part is not None:
        return _shaped(item, values_of(doc, part[0])[part[1]])
    form = form_of(item)
    if form == "xml":
        try:
            return _shaped(item, np.array((item.text or "").split(), dtype=type_of(item)))
        except ValueError as exc:
            msg = f"it has numbers that are none ({' '.join(str(exc).split())[:60]})"
            raise MeshFileError(msg) from exc
    if form not in ("hdf", "binary"):
        msg = f"it has data in the form {item.get('Format')}"
        raise MeshFileError(msg)
    place = stored(doc, item)
    if form == "binary":
        size = prod(dimensions(item))
        held = max((place.file.stat().st_size - place.seek) // type_of(item).itemsize, 0)
        data = np.fromfile(place.file, type_of(item), min(size, held), offset=place.seek)
        return _shaped(item, data.astype(type_of(item).newbyteorder("=")))
    return _shaped(item, _from_hdf(item, place))


def _from_hdf(item: Any, place: Stored) -> NDArray[Any]:
    import h5py

    try:
        with h5py.File(place.file, "r") as file:
            if place.inside not in file or not isinstance(file[place.inside], h5py.Dataset):
                msg = f"{place.file.name} has no data at {place.inside}"
                raise MeshFileError(msg)
            data = file[place.inside]
            _expect(item, data.size)
            if data.dtype.kind not in "iufb":
                msg = f"{place.file.name} has no numbers at {place.inside}"
                raise MeshFileError(msg)
            return np.asarray(data[()])
    except OSError as exc:
        reason = " ".join(str(exc).split())[:120]
        msg = f"{place.file.name} is incomplete or no HDF5 file ({reason})"
        raise MeshFileError(msg) from exc


def unnamed(doc: Document) -> dict[str, list[str]]:
    """Data in files of HDF5 that no item names, by the names of these files."""
    import h5py

    named: dict[Path, set[str]] = {}
    for item in doc.root.iter():
        if local(item) == "DataItem" and form_of(item) == "hdf" and not item.get(
                "Reference") and not len(item) and (item.text or "").strip():
            place = stored(doc, item)
            named.setdefault(place.file, set()).add(place.inside.strip("/"))
    out = {}
    for file, known in named.items():
        there: list[str] = []
        with h5py.File(file, "r") as opened:
            opened.visititems(lambda name, data, there=there: there.append(name) if isinstance(
                data, h5py.Dataset) else None)
        left = sorted(set(there) - known)
        if left:
            out[file.name] = left
    return out


def dimensions(item: Any) -> list[int]:
    """Shape that an item states."""
    return [int(word) for word in item.get("Dimensions", "").split()]


def _shaped(item: Any, data: NDArray[Any]) -> NDArray[Any]:
    """Numbers in the shape that is stated, with which they must agree."""
    _expect(item, data.size)
    return data.reshape(dimensions(item) or data.shape)


def _expect(item: Any, size: int) -> None:
    shape = dimensions(item)
    if shape and prod(shape) != size:
        msg = f"it declares {item.get('Dimensions')} numbers and holds {size}"
        raise MeshFileError(msg)
