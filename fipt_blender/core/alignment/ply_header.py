# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Headers of PLY files, for the engine and for the check before Blender's importer.

Standard library only.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2"},
    **{"int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8"},
}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
# Properties whose values are vertex indices, by element.
_INDICES = {"face": ("vertex_indices", "vertex_index"), "edge": ("vertex1", "vertex2")}


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
    """A PLY header.

    Attributes:
        order: byte order of binary data; "" for ASCII.
        elements: in the order of the data.
        size: bytes of the header; the data follow.
    """

    order: str
    elements: list[Element]
    size: int

    @property
    def vertex_count(self) -> int:
        """Number of vertices."""
        return next(element.count for element in self.elements if element.name == "vertex")


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
            if element.is_index(entry) and (entry.type[0] == "f" or is_list != (element.name == "face")):
                raise ValueError(f"the property '{entry.name}' is of a type that can't hold indices")
