# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Binary COLMAP files compared with their own counts before COLMAP reads them.

COLMAP's reader trusts the counts in a file. With a file that was cut off it allocates memory without end,
or reads parameters past the file's end as zeros. The layouts are those of COLMAP's documentation, "Output
Format".
"""

from __future__ import annotations

import mmap
import struct
from collections.abc import Callable
from pathlib import Path

import pycolmap

from ...run.documents import check_size

MOST_BYTES = 2_000_000_000  # of a file; 1,000 photographs with 8,000 points each have 0.5 GB as text
_COUNT = struct.Struct("<Q")
_CAMERA = struct.Struct("<IiQQ")  # id, model, width, height; then float64 parameters
_RIG = struct.Struct("<II")  # id, number of sensors; then the sensors, the first without a pose
_SENSOR_BYTES = 4 + 4  # type, id
_POSE_BYTES = 7 * 8  # quaternion and translation
_FRAME_BYTES = 4 + 4 + _POSE_BYTES  # id, rig id, pose; then a 32-bit count and data ids
_DATA_BYTES = _SENSOR_BYTES + 8


class _Cursor:
    """A position in a file's bytes that never moves past their end."""

    def __init__(self, data: bytes | mmap.mmap) -> None:
        self._data = data
        self._size = len(data)
        self.position = 0

    def skip(self, count: int) -> None:
        """Move on by `count` bytes."""
        if count > self._size - self.position:
            raise EOFError
        self.position += count

    def read(self, layout: struct.Struct) -> tuple[int, ...]:
        """The values at the position, which moves behind them."""
        start = self.position
        self.skip(layout.size)
        return layout.unpack_from(self._data, start)

    def count(self) -> int:
        """A 64-bit count."""
        return self.read(_COUNT)[0]

    def skip_name(self) -> None:
        """Move behind a text that ends with a zero byte."""
        end = self._data.find(b"\0", self.position)
        if end < 0:
            raise EOFError
        self.position = end + 1


def check_model(folder: Path) -> None:
    """Check that each binary file of a COLMAP model is as long as its counts say.

    Args:
        folder: of cameras.bin, images.bin, points3D.bin and, from COLMAP 3.12 on, rigs.bin and frames.bin.

    Raises:
        ValueError: names the file that is cut off, longer than its counts say, or larger than any model.
        OSError: where a file can't be read.
    """
    for name, skip_record in _FILES.items():
        path = folder / name
        for either in (path, path.with_suffix(".txt")):
            if either.is_file():
                check_size(either, MOST_BYTES)
        if path.is_file():
            _check_file(path, skip_record)


def _check_file(path: Path, skip_record: Callable[[_Cursor], None]) -> None:
    with path.open("rb") as file:
        size = path.stat().st_size
        if size < _COUNT.size:  # an empty file can't be mapped
            raise ValueError(f"{path.name} is cut off: it has {size} bytes")
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            cursor = _Cursor(data)
            records = cursor.count()
            try:
                for _ in range(records):
                    skip_record(cursor)
            except EOFError:
                raise ValueError(
                    f"{path.name} is cut off: it says {records} entries and ends inside one of them"
                ) from None
    if cursor.position != size:
        raise ValueError(f"{path.name} has {size - cursor.position} bytes more than its {records} entries")


def _skip_camera(cursor: _Cursor) -> None:
    _, model, _, _ = cursor.read(_CAMERA)
    cursor.skip(8 * _parameter_count(model))


def _parameter_count(model: int) -> int:
    """Number of parameters of a camera model by its number.

    Raises:
        ValueError: for a model that COLMAP does not know.
    """
    try:
        kind = pycolmap.CameraModelId(model)
        return len(pycolmap.Camera.create_from_model_id(0, kind, 1.0, 1, 1).params)
    except (ValueError, RuntimeError, TypeError):
        raise ValueError(f"cameras.bin names the unknown camera model {model}") from None


def _skip_image(cursor: _Cursor) -> None:
    cursor.skip(4 + 7 * 8 + 4)  # id, quaternion and translation, camera id
    cursor.skip_name()
    cursor.skip((2 * 8 + 8) * cursor.count())  # position, id of the 3D point


def _skip_point(cursor: _Cursor) -> None:
    cursor.skip(8 + 3 * 8 + 3 + 8)  # id, position, colour, error
    cursor.skip((4 + 4) * cursor.count())  # image id, index of the 2D point


def _skip_rig(cursor: _Cursor) -> None:
    _, sensors = cursor.read(_RIG)
    for index in range(sensors):
        cursor.skip(_SENSOR_BYTES)
        if index > 0 and cursor.read(_HAS_POSE)[0]:
            cursor.skip(_POSE_BYTES)


def _skip_frame(cursor: _Cursor) -> None:
    cursor.skip(_FRAME_BYTES)
    cursor.skip(_DATA_BYTES * cursor.read(_SHORT_COUNT)[0])


_HAS_POSE = struct.Struct("<B")
_SHORT_COUNT = struct.Struct("<I")
_FILES: dict[str, Callable[[_Cursor], None]] = {
    "cameras.bin": _skip_camera,
    "images.bin": _skip_image,
    "points3D.bin": _skip_point,
    "rigs.bin": _skip_rig,
    "frames.bin": _skip_frame,
}
