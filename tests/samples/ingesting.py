"""`ingest` in this process, and changes to the files that it reads."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from fipt_blender.core.capture.images import read_radiance
from fipt_blender.core.capture.ingest import ingest
from fipt_blender.core.capture.options import CaptureOptions
from fipt_blender.core.run.messages import Reporter, parse_message
from samples.image_files import write_exr_layers


def run_ingest(capture, run, **options):
    stream = io.StringIO()
    ingest(capture, run, CaptureOptions(**options), Reporter(stream))
    return [parse_message(line) for line in stream.getvalue().splitlines()]


def warnings(messages):
    return [message["code"] for message in messages if message["type"] == "warning"]


def set_pixels(tmp_path, change, name="001_0001"):
    path = tmp_path / "in" / "images" / f"{name}.exr"
    planes = np.moveaxis(change(read_radiance(path)), -1, 0)
    channels = {name: np.ascontiguousarray(plane) for name, plane in zip("RGB", planes, strict=True)}
    write_exr_layers(path, {"": channels}, parts=False)  # also what the engine refuses to write


def put(pixels, value):
    pixels[3, 4, 1] = value
    return pixels


@contextmanager
def edited_json(path: Path) -> Iterator[Any]:
    """The content of a file, which is written back with its changes."""
    data = json.loads(path.read_text())
    yield data
    path.write_text(json.dumps(data))
