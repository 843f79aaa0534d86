# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Vertices and polygons of PLY files, for the engine and for the check before Blender's importer.

That importer crashes at damaged headers, counts and indices, and the artist's unsaved work is lost. Nothing
is allocated that the file does not hold. Needs numpy alone.
"""

from __future__ import annotations

import re
import struct
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from .polygons import Polygons, check_indices

_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2"},
    **{"int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8"},
}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
# Properties whose values are vertex indices, by element.
_LISTS = ("vertex_indices", "vertex_index")
_INDICES = {"face": _LISTS, "tristrips": _LISTS, "edge": ("vertex1", "vertex2")}
_RESTART = -1  # between two strips of triangles


@dataclass(frozen=True)
class Property:
    """A property of a PLY element; types are numpy's, without byte order."""

    name: str
    type: str
    count_type: str = ""  # of a list


@dataclass(frozen=True)
class Element:
    """An element of a PLY file."""

    name: str
    count: int
    properties: list[Property]

    @property
    def has_lists(self) -> bool:
        """Whether a property is a list."""
        return any(entry.count_type for entry in self.properties)

    def is_index(self, entry: Property) -> bool:
        """Whether the values of a property are vertex indices."""
        return entry.name in _INDICES.get(self.name, ())


@dataclass(frozen=True)
class Header:
    """A PLY header: byte order of the data ("" for ASCII), its elements in their order, and its own bytes."""

    order: str
    elements: list[Element]
    size: int


def read_ply(path: Path) -> Polygons:
    """Read a PLY file and check its coordinates and indices; strips become triangles.

    Raises:
        OSError: the system's.
        ValueError: what is wrong with it.
    """
    with open(path, "rb") as file:
        header = read_header(file.read(1_000_000))
    data: np.ndarray = np.memmap(path, np.uint8, "r")[header.size :]
    line_words = None
    if not header.order:
        header, data, line_words = _as_binary(header, data)
    columns: dict[str, _Columns] = {}
    place, line = 0, 0
    for element in header.elements:
        columns[element.name] = found = _read_element(data, place, element, header.order)
        words = None if line_words is None else line_words[line : line + element.count]
        if words is not None and (wrong := found.sizes // 8 != words).any():
            raise ValueError(
                f"the values of its element '{element.name}' {int(wrong.argmax())} are too few or many"
            )
        place, line = found.end, line + element.count
    vertices = np.stack([columns["vertex"].values[axis].astype(np.float64) for axis in "xyz"], axis=1)
    corners, lengths = np.zeros(0, np.int64), np.zeros(0, np.int64)
    for element in header.elements:
        for name in filter(columns[element.name].values.__contains__, _INDICES.get(element.name, ())):
            indices = _whole(columns[element.name].values[name])
            counts = columns[element.name].lengths.get(name, lengths)
            if element.name == "tristrips":
                indices = _strip_triangles(indices, counts)
                counts = np.full(len(indices) // 3, 3)
            if element.name == "edge":
                check_indices(indices, len(vertices))
            else:
                corners, lengths = np.concatenate([corners, indices]), np.concatenate([lengths, counts])
    polygons = Polygons(vertices, corners, lengths)
    polygons.check()
    return polygons


def _as_binary(header: Header, data: np.ndarray) -> tuple[Header, np.ndarray, np.ndarray]:
    """An ASCII file as a binary one whose values are all float64, and the number of values in each line."""
    ends = np.flatnonzero(data == ord("\n"))
    if len(data) and data[-1] != ord("\n"):
        ends = np.append(ends, len(data))
    count = sum(element.count for element in header.elements)
    if count > len(ends):
        raise ValueError(f"it has {len(ends):,} lines, and its elements need {count:,}")
    data = data[: ends[count - 1]] if count else data[:0]
    solid = data > ord(" ")
    words = np.flatnonzero(solid & ~np.append(False, solid[:-1])[: len(solid)])
    line_words = np.diff(np.searchsorted(words, ends[:count]), prepend=0)
    values = np.zeros(0)
    if len(words):
        with warnings.catch_warnings():
            warnings.simplefilter("error", DeprecationWarning)  # at what is no number
            try:
                values = np.fromstring(data.tobytes(), np.float64, sep=" ")
            except (DeprecationWarning, ValueError):
                raise ValueError("it holds something that is no number") from None
    elements = [
        replace(
            element,
            properties=[
                replace(entry, type="f8", count_type="f8" if entry.count_type else "")
                for entry in element.properties
            ],
        )
        for element in header.elements
    ]
    return Header("=", elements, 0), values.view(np.uint8), line_words


@dataclass(frozen=True)
class _Columns:
    """The values of an element.

    Attributes:
        values: by property, of coordinates and indices alone; those of lists one list after the other.
        lengths: (N,) int64 of the lists, by property.
        sizes: (N,) int64 bytes of each.
        end: the byte after the last one.
    """

    values: dict[str, np.ndarray]
    lengths: dict[str, np.ndarray]
    sizes: np.ndarray
    end: int


def _read_element(data: np.ndarray, place: int, element: Element, order: str) -> _Columns:
    """Read an element at a place in the bytes (N,) u8, ordered by the lengths of its lists."""
    least = element.count * sum(_size(entry.count_type or entry.type) for entry in element.properties)
    if least > len(data) - place:
        raise ValueError(
            f"it ends too early: {element.count:,} elements '{element.name}' need {least:,} bytes,"
            f" {max(len(data) - place, 0):,} are left"
        )
    lists = [entry.name for entry in element.properties if entry.count_type]
    wanted = [
        entry.name
        for entry in element.properties
        if element.is_index(entry) or (element.name == "vertex" and entry.name in ("x", "y", "z"))
    ]
    values = {name: [np.zeros(0)] for name in wanted}
    rows = np.zeros((0, len(lists)), np.int64)
    sizes = np.zeros(0, np.int64)
    if element.count:
        starts, rows, end = _places(data, place, element, order)
        sizes = np.diff(starts, append=end)
        keys, kind = (
            np.unique(rows, axis=0, return_inverse=True) if lists else (rows[:1], np.zeros(len(rows)))
        )
        rows = keys[np.sort(kind.reshape(-1)).astype(np.int64)]
        for number, key in enumerate(keys):
            record = _record(element, order, key)
            if len(keys) == 1:
                records = np.frombuffer(data, record, element.count, place)
            else:
                found = starts[kind.reshape(-1) == number]
                records = data[found[:, None] + np.arange(record.itemsize)].view(record)[:, 0]
            for name, parts in values.items():
                parts.append(records[name].reshape(-1))
        place = end
    return _Columns(
        {name: np.concatenate(parts[1:] or parts) for name, parts in values.items()},
        {name: rows[:, number] for number, name in enumerate(lists)},
        sizes,
        place,
    )


def _places(data: np.ndarray, place: int, element: Element, order: str) -> tuple[np.ndarray, np.ndarray, int]:
    """First bytes (N,) of elements, lengths of their lists (N, lists), and the byte after the last one."""
    plan = [
        (
            struct.Struct(order + np.dtype(entry.count_type).char) if entry.count_type else None,
            _size(entry.type),
        )
        for entry in element.properties
    ]
    lists = sum(counter is not None for counter, _ in plan)
    content, starts, lengths = data.data, [], []
    for number in range(element.count):
        starts.append(place)
        for counter, size in plan:
            if counter is None:
                place += size
                continue
            if place + counter.size > len(content):
                raise ValueError(f"it ends within its elements '{element.name}'")
            (length,) = counter.unpack_from(content, place)
            if not (length >= 0 and length % 1 == 0):
                raise ValueError(f"an element '{element.name}' has a list of {length:g} values")
            lengths.append(int(length))
            place += counter.size + int(length) * size
        if place > len(content):
            raise ValueError(f"it ends within its elements '{element.name}'")
        if not number:  # most often, all are like the first one
            record = _record(element, order, lengths)
            end = starts[0] + element.count * record.itemsize
            if end <= len(data):
                records = np.frombuffer(data, record, element.count, starts[0])
                if all(
                    (records[name] == records[name][0]).all() for name in record.names or () if " " in name
                ):
                    return (
                        starts[0] + record.itemsize * np.arange(element.count),
                        np.tile(np.array(lengths, np.int64), (element.count, 1)),
                        end,
                    )
    return np.array(starts), np.array(lengths, np.int64).reshape(-1, lists), place


def _record(element: Element, order: str, lengths: Sequence[int]) -> np.dtype:
    """The type of elements whose lists have these lengths."""
    left = iter(lengths)
    fields: list[Any] = []
    for entry in element.properties:
        if entry.count_type:
            fields.append(("length " + entry.name, order + entry.count_type))
        shape = (int(next(left)),) if entry.count_type else ()
        fields.append((entry.name, order + entry.type, shape))
    return np.dtype(fields)


def _size(kind: str) -> int:
    return int(kind[1])


def _whole(values: np.ndarray) -> np.ndarray:
    """Vertex indices as int64."""
    if values.dtype.kind == "f" and not (values % 1 == 0).all():
        raise ValueError("a vertex index is no whole number")
    return np.clip(values, -(2**53), 2**53).astype(np.int64)


def _strip_triangles(indices: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Corners (3 T,) of the triangles of strips; `_RESTART` and the end of a list end a strip."""
    indices = np.insert(indices, np.cumsum(lengths), _RESTART)
    places = np.arange(len(indices))
    first = np.maximum.accumulate(np.where(indices == _RESTART, places + 1, 0))
    places = places[: max(len(indices) - 2, 0)]
    triangles = indices[places[:, None] + np.arange(3)]
    odd = (places - first[places]) % 2 == 1
    triangles[odd] = triangles[odd][:, [1, 0, 2]]
    # Repeated vertices lead from one strip to the next.
    kept = (triangles != _RESTART).all(axis=1) & (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    return triangles[kept].reshape(-1)


def read_header(start: bytes) -> Header:
    """Parse the header of a PLY file, given the start of the file.

    Raises:
        ValueError: what is wrong with it.
    """
    end = re.search(rb"\nend_header[ \t]*\r?\n", start)
    if not re.match(rb"ply\s*?\n", start) or end is None:
        raise ValueError("it has no complete PLY header")
    try:
        lines = start[: end.start()].decode("ascii", errors="strict").splitlines()
    except UnicodeDecodeError:
        lines = [line.decode("latin-1") for line in start[: end.start()].split(b"\n")]
    order = None
    elements: list[Element] = []
    for line in lines[1:]:
        match line.split():
            case ["comment" | "obj_info", *_]:
                pass
            case ["format", name, "1.0"] if name in _ORDERS and order is None:
                order = _ORDERS[name]
            case ["element", name, count] if order is not None and re.fullmatch(r"\d{1,10}", count):
                if int(count) > 2**31 - 1:  # indices are 32-bit
                    raise ValueError(f"it states {int(count):,} elements '{name}'")
                elements.append(Element(name, int(count), []))
            case ["property", kind, name] if elements and kind in _TYPES:
                elements[-1].properties.append(Property(name, _TYPES[kind]))
            case ["property", "list", count, kind, name] if elements and kind in _TYPES:
                if _TYPES.get(count, "f")[0] == "f":
                    raise ValueError(f"the header has the line '{line.strip()[:60]}'")
                elements[-1].properties.append(Property(name, _TYPES[kind], _TYPES[count]))
            case _:
                raise ValueError(f"the header has the line '{line.strip()[:60]}'")
    header = Header(order or "", elements, end.end())
    _check_elements(header, order is not None)
    return header


def _check_elements(header: Header, has_format: bool) -> None:
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
            if element.is_index(entry) and (entry.type[0] == "f" or is_list != (element.name != "edge")):
                raise ValueError(f"the property '{entry.name}' is of a type that can't hold indices")
