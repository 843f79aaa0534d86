"""Binary COLMAP files compared with their own counts before COLMAP reads them.

COLMAP's reader trusts the counts in a file. With a file that was cut off it allocates memory without end,
or reads parameters past the file's end as zeros. The layouts are those of COLMAP's documentation, "Output
Format".
"""

from __future__ import annotations

import mmap
import struct
from pathlib import Path

import pycolmap

from ...run.documents import check_size

MOST_BYTES = 2_000_000_000  # of a file; 1,000 photographs with 8,000 points each have 0.5 GB as text
# Those of a model; the last two from COLMAP 3.12 on.
FILES = ("cameras.bin", "images.bin", "points3D.bin", "rigs.bin", "frames.bin")
_COUNT_BYTES = 8  # of the number of records, with which each file begins
_POSE_BYTES = 7 * 8  # quaternion and translation
_SENSOR_BYTES = 4 + 4  # type, id


def check_model(folder: Path) -> None:
    """Check that each binary file of a COLMAP model is as long as its counts say.

    Args:
        folder: of `FILES`, or of text files of these names.

    Raises:
        ValueError: names the file that is cut off, longer than its counts say, or larger than any model.
        OSError: where a file can't be read.
    """
    for name in FILES:
        path = folder / name
        for either in (path, path.with_suffix(".txt")):
            if either.is_file():
                check_size(either, MOST_BYTES)
        if path.is_file():
            _check_file(path)


def _check_file(path: Path) -> None:
    with path.open("rb") as file:
        size, position = path.stat().st_size, _COUNT_BYTES
        if size < _COUNT_BYTES:  # an empty file can't be mapped
            raise ValueError(f"{path.name} is cut off: it has {size} bytes")
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            records = _number(data, 0, "<Q")
            try:
                for _ in range(records):
                    position = _record_end(path.name, data, position)
                    if position > size:
                        raise EOFError
            except (EOFError, struct.error):
                raise ValueError(
                    f"{path.name} is cut off: it says {records} entries and ends inside one of them"
                ) from None
    if position != size:
        raise ValueError(f"{path.name} has {size - position} bytes more than its {records} entries")


def _record_end(name: str, data: mmap.mmap, start: int) -> int:
    """Where a record of a file ends that begins at `start`.

    Raises:
        EOFError: where the file ends before (or `struct.error`, or the result is behind its end).
        ValueError: for a camera model that COLMAP does not know.
    """
    if name == "cameras.bin":  # id, model, width, height; parameters
        return start + 4 + 4 + 8 + 8 + 8 * _parameter_count(_number(data, start + 4, "<i"))
    if name == "images.bin":  # id, pose, camera id, name; count of points: position, id of the 3D point
        end = data.find(b"\0", start + 4 + _POSE_BYTES + 4)
        if end < 0:
            raise EOFError
        return end + 1 + 8 + (2 * 8 + 8) * _number(data, end + 1, "<Q")
    if name == "points3D.bin":  # id, position, colour, error; count of image ids and numbers of 2D points
        count = start + 8 + 3 * 8 + 3 + 8
        return count + 8 + (4 + 4) * _number(data, count, "<Q")
    if name == "frames.bin":  # id, rig id, pose; count of data ids
        count = start + 4 + 4 + _POSE_BYTES
        return count + 4 + (_SENSOR_BYTES + 8) * _number(data, count, "<I")
    position = start + 4 + 4  # of a rig: id, count of sensors, of which all but the first may have a pose
    for index in range(_number(data, start + 4, "<I")):
        position += _SENSOR_BYTES
        if index:
            position += 1 + _POSE_BYTES * bool(_number(data, position, "<B"))
    return position


def _number(data: mmap.mmap, position: int, layout: str) -> int:
    value: int = struct.unpack_from(layout, data, position)[0]
    return value


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
