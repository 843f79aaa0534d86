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
from pathlib import Path

import numpy as np

from ...core.alignment.ply_header import Element, Header, read_header
from ...core.run.errors import FiptError
from ...core.run.shapes import FARTHEST_UNITS
from .mesh_names import check_named_files

_CHUNK = 1 << 17  # records of lists that are walked at once
_LETTERS = re.compile(rb"[A-Za-z]")
_NUMBERS = re.compile(rb"[-+.\deinaf\s]*", re.IGNORECASE)


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
        header = read_header(file.read(1_000_000))
        if not header.order:
            file.seek(header.size)
            _check_ascii(file, header)
            return
    _check_binary(np.memmap(path, np.uint8, "r"), header)


def _check_binary(data: np.ndarray, header: Header) -> None:
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


def _check_rest(element: Element, needed: int, rest: int) -> None:
    if needed > rest:
        raise ValueError(
            f"it ends too early: {element.count:,} elements '{element.name}' need {needed:,} bytes,"
            f" {max(rest, 0):,} are left"
        )


def _check_lists(data: np.ndarray, position: int, element: Element, count: int, header: Header) -> int:
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
    data: np.ndarray, position: int, element: Element, count: int, order: str
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


def _check_indices(indices: np.ndarray, header: Header) -> None:
    for index in (int(indices.min(initial=0)), int(indices.max(initial=0))):
        _check_index(index, header)


def _check_index(index: int, header: Header) -> None:
    if index and not 0 <= index < header.vertex_count:
        raise ValueError(f"a face or edge names the vertex {index}, and there are {header.vertex_count:,}")


def _check_ascii(lines: Iterator[bytes], header: Header) -> None:
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
            if element.has_lists or element.name in ("face", "edge"):
                _check_line(values, element, header)
            elif len(values) < len(element.properties):
                raise ValueError(f"an element '{element.name}' is '{_shorten(line)}'")
            wrong += bool(axes and _LETTERS.search(line)) and not _are_finite([values[axis] for axis in axes])
        _refuse_wrong(wrong, element.count)


def _check_line(values: list[bytes], element: Element, header: Header) -> None:
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
