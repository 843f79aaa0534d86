# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Checks mesh files before Blender's importers read them.

Blender's PLY importer crashes at damaged headers, counts and indices, and the artist's unsaved work is lost.
Needs numpy alone.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...core.run.errors import FiptError
from ...core.run.shapes import FARTHEST_UNITS
from .mesh_names import check_named_files

_CHUNK = 1 << 17  # records of lists that are walked at once
_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2"},
    **{"int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8"},
}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
# Properties whose values are vertex indices, by element.
_INDICES = {"face": ("vertex_indices", "vertex_index"), "edge": ("vertex1", "vertex2")}
_LETTERS = re.compile(rb"[A-Za-z]")
_NUMBERS = re.compile(rb"[-+.\deinaf\s]*", re.IGNORECASE)


@dataclass(frozen=True)
class _Property:
    """A property of a PLY element; types are numpy's, without byte order."""

    name: str
    type: str
    count_type: str = ""  # of a list


@dataclass(frozen=True)
class _Element:
    name: str
    count: int
    properties: list[_Property]

    @property
    def has_lists(self) -> bool:
        return any(entry.count_type for entry in self.properties)

    def is_index(self, entry: _Property) -> bool:
        return entry.name in _INDICES.get(self.name, ())


@dataclass(frozen=True)
class _Header:
    """A PLY header.

    Attributes:
        order: byte order of binary data; "" for ASCII.
        elements: in the order of the data.
        size: bytes of the header; the data follow.
    """

    order: str
    elements: list[_Element]
    size: int

    @property
    def vertex_count(self) -> int:
        return next(element.count for element in self.elements if element.name == "vertex")


def check_mesh_file(path: Path) -> None:
    """Check a mesh file whose importer does not survive damage, or opens whatever files it names.

    Raises:
        FiptError: ``mesh-unreadable``.
    """
    check = {".ply": _check_ply, ".obj": _check_obj}.get(path.suffix.lower())
    try:
        check_named_files(path)
        if check is not None:
            check(path)
    except (OSError, ValueError, struct.error) as error:
        raise FiptError(
            "mesh-unreadable",
            f"The mesh {path} can't be used: {error}.",
            "Copy or export the file again, or choose another mesh.",
        ) from None


def _check_ply(path: Path) -> None:
    with open(path, "rb") as file:
        header = _read_header(file.read(1_000_000))
        if not header.order:
            file.seek(header.size)
            _check_ascii(file, header)
            return
    _check_binary(np.memmap(path, np.uint8, "r"), header)


def _read_header(start: bytes) -> _Header:
    """Parse the header of a PLY file, given the start of the file."""
    end = re.search(rb"\nend_header[ \t]*\r?\n", start)
    if not re.match(rb"ply\s*?\n", start) or end is None:
        raise ValueError("it has no complete PLY header")
    try:
        lines = start[: end.start()].decode("ascii", errors="strict").splitlines()
    except UnicodeDecodeError:
        lines = [line.decode("latin-1") for line in start[: end.start()].split(b"\n")]
    order = None
    elements: list[_Element] = []
    for line in lines[1:]:
        match line.split():
            case ["comment" | "obj_info", *_]:
                pass
            case ["format", name, "1.0"] if name in _ORDERS and order is None:
                order = _ORDERS[name]
            case ["element", name, count] if order is not None and re.fullmatch(r"\d{1,10}", count):
                if int(count) > 2**31 - 1:  # Blender's indices are 32-bit
                    raise ValueError(f"it states {int(count):,} elements '{name}'")
                elements.append(_Element(name, int(count), []))
            case ["property", kind, name] if elements and kind in _TYPES:
                elements[-1].properties.append(_Property(name, _TYPES[kind]))
            case ["property", "list", count, kind, name] if elements and kind in _TYPES:
                if _TYPES.get(count, "f")[0] == "f":
                    raise ValueError(f"the header has the line '{line.strip()[:60]}'")
                elements[-1].properties.append(_Property(name, _TYPES[kind], _TYPES[count]))
            case _:
                raise ValueError(f"the header has the line '{line.strip()[:60]}'")
    header = _Header(order or "", elements, end.end())
    _check_elements(header, order is not None)
    return header


def _check_elements(header: _Header, has_format: bool) -> None:
    names = [element.name for element in header.elements]
    if not has_format or names.count("vertex") != 1 or len(set(names)) < len(names):
        raise ValueError("the header lacks the format or has not exactly one element 'vertex'")
    for element in header.elements:
        properties = [entry.name for entry in element.properties]
        if len(set(properties)) < len(properties) or (element.count and not properties):
            raise ValueError(f"the element '{element.name}' has repeated properties or none")
        if element.name == "vertex" and (element.has_lists or not {"x", "y", "z"} <= set(properties)):
            raise ValueError("the vertices have no coordinates x, y and z")
        for entry in element.properties:
            is_list = bool(entry.count_type)
            if element.is_index(entry) and (entry.type[0] == "f" or is_list != (element.name == "face")):
                raise ValueError(f"the property '{entry.name}' is of a type that can't hold indices")


def _check_binary(data: np.ndarray, header: _Header) -> None:
    """Check the bytes (N,) u8 of a binary file after its header."""
    position = header.size
    for element in header.elements:
        if element.has_lists:
            least = sum(_size(entry.count_type or entry.type) for entry in element.properties)
            _check_rest(element, element.count * least, len(data) - position)
            for start in range(0, element.count, _CHUNK):
                count = min(_CHUNK, element.count - start)
                position = _check_lists(data, position, element, count, header)
            continue
        record = np.dtype([(entry.name, header.order + entry.type) for entry in element.properties])
        _check_rest(element, element.count * record.itemsize, len(data) - position)
        records = np.frombuffer(data, record, element.count, position) if element.count else None
        for entry in element.properties:
            if records is not None and element.is_index(entry):
                _check_indices(records[entry.name], header)
        if records is not None and element.name == "vertex":
            near = [np.abs(records[axis].astype(np.float64)) <= FARTHEST_UNITS for axis in "xyz"]
            _refuse_wrong(int((~np.all(near, axis=0)).sum()), element.count)
        position += element.count * record.itemsize


def _size(kind: str) -> int:
    return int(kind[1])


def _check_rest(element: _Element, needed: int, rest: int) -> None:
    if needed > rest:
        raise ValueError(
            f"it ends too early: {element.count:,} elements '{element.name}' need {needed:,} bytes,"
            f" {max(rest, 0):,} are left"
        )


def _check_lists(data: np.ndarray, position: int, element: _Element, count: int, header: _Header) -> int:
    """Check some elements with lists in binary data; returns the position after them."""
    records = _equal_records(data, position, element, count, header.order)
    if records is not None:
        for number, entry in enumerate(element.properties):
            if element.is_index(entry):
                _check_lengths(records[f"length {number}"])
                _check_indices(records[f"items {number}"], header)
        return position + count * records.dtype.itemsize
    starts, lengths, content = [], [], data.data
    plan = [
        (
            struct.Struct(header.order + np.dtype(entry.count_type).char) if entry.count_type else None,
            _size(entry.type),
            element.is_index(entry),
        )
        for entry in element.properties
    ]
    for _ in range(count):
        for counter, size, is_index in plan:
            if counter is None:
                position += size
                continue
            if position + counter.size > len(content):
                raise ValueError(f"it ends within its elements '{element.name}'")
            (length,) = counter.unpack_from(content, position)
            if length < 0:
                raise ValueError(f"an element '{element.name}' has a list of {length} values")
            position += counter.size
            if is_index:
                starts.append(position)
                lengths.append(length)
            position += length * size
    if position > len(data):
        raise ValueError(f"it ends within its elements '{element.name}'")
    kind = next((entry.type for entry in element.properties if element.is_index(entry)), "")
    if kind:
        _check_lengths(np.array(lengths))
        for length in np.unique(lengths):
            first = np.array(starts)[np.array(lengths) == length]
            items = data[first[:, None] + np.arange(int(length) * _size(kind))]
            _check_indices(items.view(header.order + kind), header)
    return position


def _equal_records(
    data: np.ndarray, position: int, element: _Element, count: int, order: str
) -> np.ndarray | None:
    """Elements whose lists are all as long as those of the first one, as records; None if they differ."""
    fields: list[tuple[str, str] | tuple[str, str, tuple[int]]] = []
    size = 0
    for number, entry in enumerate(element.properties):
        if not entry.count_type:
            fields.append((entry.name, order + entry.type))
            size += _size(entry.type)
            continue
        if position + size + _size(entry.count_type) > len(data):
            return None
        length = int(np.frombuffer(data, order + entry.count_type, 1, position + size)[0])
        size += _size(entry.count_type) + length * _size(entry.type)
        if length < 0 or position + count * size > len(data):
            return None
        fields.append((f"length {number}", order + entry.count_type))
        fields.append((f"items {number}", order + entry.type, (length,)))
    if position + count * size > len(data):
        return None
    records = np.frombuffer(data, np.dtype(fields), count, position)
    lengths = [records[name] for name in records.dtype.names or () if name.startswith("length ")]
    return records if all((values == values[0]).all() for values in lengths) else None


def _check_lengths(lengths: np.ndarray) -> None:
    if not lengths.all():
        raise ValueError("a face has no vertices")


def _check_indices(indices: np.ndarray, header: _Header) -> None:
    for index in (int(indices.min(initial=0)), int(indices.max(initial=0))):
        _check_index(index, header)


def _check_index(index: int, header: _Header) -> None:
    if index and not 0 <= index < header.vertex_count:
        raise ValueError(f"a face or edge names the vertex {index}, and there are {header.vertex_count:,}")


def _check_ascii(lines: Iterator[bytes], header: _Header) -> None:
    for element in header.elements:
        names = [entry.name for entry in element.properties]
        axes = [names.index(axis) for axis in "xyz"] if element.name == "vertex" else []
        wrong = 0
        for number in range(element.count):
            line = next(lines, b"")
            values = line.split()
            if not values:
                text = f"{number:,} of {element.count:,} elements '{element.name}'"
                raise ValueError(f"it has {text} before it ends or has an empty line")
            if not _NUMBERS.fullmatch(line):
                raise ValueError(f"an element '{element.name}' is '{_shorten(line)}'")
            if element.has_lists or element.name in _INDICES:
                _check_line(values, element, header)
            elif len(values) < len(element.properties):
                raise ValueError(f"an element '{element.name}' is '{_shorten(line)}'")
            wrong += bool(axes and _LETTERS.search(line)) and not _are_finite([values[axis] for axis in axes])
        _refuse_wrong(wrong, element.count)


def _check_line(values: list[bytes], element: _Element, header: _Header) -> None:
    """Check the values of one element with lists or indices."""
    position = 0
    for entry in element.properties:
        length = 1
        if entry.count_type:
            length = _whole(values[position]) if position < len(values) else -1
            position += 1
        items = values[position : position + max(length, 0)]
        is_face = bool(entry.count_type) and element.is_index(entry)
        if len(items) != length or (is_face and not length):
            raise ValueError(f"an element '{element.name}' is '{_shorten(b' '.join(values))}'")
        if element.is_index(entry):
            for item in items:
                _check_index(_whole(item), header)
        position += length


def _whole(word: bytes) -> int:
    try:
        return int(word)
    except ValueError:
        raise ValueError(f"'{_shorten(word)}' is no whole number") from None


def _shorten(line: bytes) -> str:
    return line[:60].decode("latin-1").strip()


def _check_obj(path: Path) -> None:
    """Check the vertices of an OBJ file, and the faces' indices of them."""
    highest, lowest, vertices, wrong = 0, math.inf, 0, 0
    with open(path, "rb") as file:
        lines = (line for line in _joined(file) if line[:1] in b" \tvf")
        for words in map(bytes.split, lines):
            if not words:
                continue
            if words[0] == b"v":
                vertices += 1
                wrong += bool(_LETTERS.search(b" ".join(words[1:4]))) and not _are_finite(words[1:4])
            elif words[0] == b"f":
                for word in words[1:]:
                    index = _whole(word.partition(b"/")[0])
                    highest = max(highest, index)
                    lowest = min(lowest, index if index > 0 else vertices + index + 1 if index else 0)
    _refuse_wrong(wrong, vertices)
    if lowest < 1 or highest > vertices:
        index = highest if highest > vertices else int(lowest)
        raise ValueError(f"a face names the vertex {index}, and there are {vertices:,}")


def _refuse_wrong(wrong: int, count: int) -> None:
    """Refuse vertices that are no numbers, which Blender's importers put at the origin without a word."""
    if wrong:
        raise ValueError(f"{wrong:,} of {count:,} vertices are no numbers, or impossibly far away")


def _are_finite(words: list[bytes]) -> bool:
    """Whether words are coordinates of a vertex."""
    try:
        return all(abs(float(word)) <= FARTHEST_UNITS for word in words)
    except ValueError:
        return False


def _joined(lines: Iterator[bytes]) -> Iterator[bytes]:
    """Lines without comments; those that end with a backslash joined with the next one."""
    for line in lines:
        while line.rstrip(b"\r\n").endswith(b"\\"):
            following = next(lines, b"")
            line = line.rstrip(b"\r\n")[:-1] + b" " + following
        yield line.partition(b"#")[0]
