# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""`ingest` in this process, and changes to the files that it reads."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from fipt_blender.core.capture.images import read_radiance, write_exr
from fipt_blender.core.capture.ingest import ingest
from fipt_blender.core.capture.options import CaptureOptions
from fipt_blender.core.run.messages import Reporter, parse_message


def run_ingest(capture, run, **options):
    stream = io.StringIO()
    ingest(capture, run, CaptureOptions(**options), Reporter(stream))
    return [parse_message(line) for line in stream.getvalue().splitlines()]


def warnings(messages):
    return [message["code"] for message in messages if message["type"] == "warning"]


def set_pixels(tmp_path, change, name="001_0001"):
    path = tmp_path / "in" / "images" / f"{name}.exr"
    pixels = read_radiance(path)
    write_exr(path, change(pixels))


def put(pixels, value):
    pixels[3, 4, 1] = value
    return pixels


@contextmanager
def edited_json(path: Path) -> Iterator[Any]:
    """The content of a file, which is written back with its changes."""
    data = json.loads(path.read_text())
    yield data
    path.write_text(json.dumps(data))
