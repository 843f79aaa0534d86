# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Estimation, textures and maps of views of captures without lamps and of meshes with openings."""

import argparse
import io
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core.capture.images import read_radiance
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.messages import Reporter, parse_message
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.core.textures import bake
from samples.small_captures import (
    COLORS,
    PANEL,
    PANEL_RADIANCE,
    UNTRAINED,
    SmallCapture,
    panel_capture,
    photograph,
    run_here,
    window_capture,
    write_run,
)
from samples.small_rooms import BOX, table

pytestmark = pytest.mark.usefixtures("one_thread")


def bake_here(run: RunFolder) -> list[dict]:
    """The engine command `textures` on a square for each quadrilateral of the room; returns its messages."""
    with np.load(run.room_npz) as room:
        quads = len(room["triangles"]) // 2
    side, corners = 16, np.array([(1, 1), (15, 1), (15, 15), (1, 15)])[[0, 1, 2, 0, 2, 3]].reshape(2, 3, 2)
    uv = np.concatenate([corners + (side * index, 0) for index in range(quads)]) / (side * quads, side)
    np.savez(run.atlas_npz, corner_uv=uv.astype(np.float32), triangle_image=np.zeros(2 * quads, np.int32))
    image = {"name": "Room", "width": side * quads, "height": side}
    write_json(run.atlas_json, {"mode": "uv", "images": [image]})
    stream = io.StringIO()
    bake.run(argparse.Namespace(run=run.root), Reporter(stream))
    return [message for line in stream.getvalue().splitlines() if (message := parse_message(line))]


def daylit_room() -> SmallCapture:
    """Light from outside through a missing wall; no lamp."""
    return window_capture([5.0, 4.0, 3.0])


def evenly_lit_room() -> SmallCapture:
    """A closed mesh, all surfaces of one radiance: nothing shows where the light comes from."""
    capture = panel_capture()
    return replace(capture, images=[np.full_like(image, 0.4) for image in capture.images])


def open_room() -> SmallCapture:
    """A lamp, and no mesh of two walls, behind which it is dark: a scan that has not been completed."""
    quads = [*BOX[:4], PANEL]
    return photograph(quads, [*COLORS[:4], [0.0] * 3], table([8, 9], PANEL_RADIANCE), None)


@pytest.mark.filterwarnings("error:.*invalid value:RuntimeWarning")
@pytest.mark.parametrize(
    ("make_capture", "fixtures", "open_mesh"),
    [(daylit_room, 0, True), (evenly_lit_room, 0, False), (open_room, 1, True)],
)
def test_textures_and_maps_follow_every_estimate(
    make_capture: Callable[[], SmallCapture], fixtures: int, open_mesh: bool, tmp_path: Path
) -> None:
    changes = {**UNTRAINED, "rounds": 0, "unseen_light": True, "force": True}  # one room shows nothing
    run = write_run(tmp_path / "run", make_capture(), **changes)
    assert run_here(run, train=False)[-1]["type"] == "done"
    assert len(read_document(run.emitters_json, dict)["fixtures"]) == fixtures
    assert bake_here(run)[-1]["type"] == "done"
    listed = (
        read_document(run.textures_json, dict)["images"]
        + read_document(run.results / "maps" / "maps.json", dict)["views"]
    )
    assert len(listed) == 4
    for entry in listed:
        for path in list(entry.values())[1:]:
            assert np.isfinite(read_radiance(run.resolve(path))).all(), path
    maps = [
        {name: read_radiance(run.resolve(path)) for name, path in entry.items() if name != "view"}
        for entry in listed[1:]
    ]
    seen = np.stack([of_view["roughness"][..., 0] > 0.0 for of_view in maps])
    emission = np.stack([of_view["emission"].max(axis=2) for of_view in maps])
    assert seen.any() and emission.any() == (fixtures > 0)
    # A pixel that shows both a lamp and a wall has at most three of its four places on the lamp.
    assert (emission[seen] < 0.8 * emission.max() + 1e-6).all()
    assert (seen | (emission > 0.0)).all() != open_mesh
    for of_view, reflecting in zip(maps, seen, strict=True):
        assert not of_view["base_color"][~reflecting].any() and not of_view["confidence"][~reflecting].any()
