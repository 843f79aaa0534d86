# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A lamp that photographs show and the mesh lacks is found, named and kept off the walls; others are not."""

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_captures import CAMERAS, COLORS, PANEL, SmallCapture, photograph_room, write_run
from small_rooms import BOX, bulb, make_room, mesh_room, table

from fipt_blender.core.capture.views import load_capture
from fipt_blender.core.job.messages import Reporter, parse_message
from fipt_blender.core.job.settings import make_settings
from fipt_blender.core.job.view_check import ViewCheck, check_views
from fipt_blender.core.render.surfaces import TriangleMaterials
from fipt_blender.core.scene.pixels import LEFT_OUT, PixelStore, fill_pixels, mark_pure, open_pixels

PLACE = [0.3, 0.2, 1.6]
VIEWS = [*CAMERAS, [[1.5, 0.2, 1.8], [-1.2, -0.4, 1.4]], [[-0.3, 1.7, 1.5], [0.1, -1.5, 1.6]]]


def checked(root: Path, capture: SmallCapture) -> tuple[PixelStore, ViewCheck, list[dict]]:
    run = write_run(root / "run", capture)
    pixels = open_pixels(root / "pixels", load_capture(run).train, create=True)
    fill_pixels(pixels, capture.room, lambda _: None)
    part = capture.room.triangle_object
    mark_pure(pixels, capture.room, part, lambda _: None)
    stream = io.StringIO()
    found = check_views(pixels, capture.room, part, make_settings("draft"), Reporter(stream))
    return pixels, found, [m for line in stream.getvalue().splitlines() if (m := parse_message(line))]


@pytest.fixture(scope="module")
def with_bulb() -> SmallCapture:
    """A hanging bulb of 12 cm in a coloured box."""
    flat = make_room(BOX)
    points, faces = bulb(PLACE, 0.06)
    room = mesh_room(
        np.concatenate([flat.vertices, points]),
        np.concatenate([flat.triangles, faces + len(flat.vertices)]),
        np.concatenate([flat.triangle_object, np.full(8, 6)]),
        parts="objects",
    )
    colors = np.concatenate([np.repeat(np.array(COLORS), 2, axis=0), np.zeros((8, 3))])
    materials = TriangleMaterials(colors, np.ones(20), np.zeros(20))
    lamps = table(list(range(12, 20)), [80.0, 70.0, 60.0])
    return photograph_room(room, materials, lamps, cameras=VIEWS, scale=2, spp=32)


def test_a_lamp_without_mesh_is_named_and_left_out(with_bulb: SmallCapture, tmp_path: Path) -> None:
    pixels, found, messages = checked(tmp_path, replace(with_bulb, room=make_room(BOX, parts="objects")))
    (message,) = messages
    assert message["code"] == "lamp-without-mesh" and message["remedy"]
    (position,) = found.lamps
    assert position == pytest.approx(PLACE, abs=0.06)
    left = np.asarray(pixels.triangle) != LEFT_OUT
    # Nothing on the walls is as bright as the lamp any more, and little is lost.
    assert np.asarray(pixels.radiance)[left].max() < 0.2 * np.asarray(pixels.radiance).max()
    assert (~left).mean() < 0.02


def test_a_lamp_with_mesh_and_one_in_a_mirror_are_no_such_lamps(
    with_bulb: SmallCapture, tmp_path: Path
) -> None:
    _, found, messages = checked(tmp_path / "bulb", with_bulb)
    assert found == ViewCheck() and messages == []
    mirror = [[-1.98, -0.9, 0.6], [-1.98, 0.9, 0.6], [-1.98, 0.9, 2.4], [-1.98, -0.9, 2.4]]
    room = make_room([*BOX, PANEL, mirror], parts="objects")
    colors = np.repeat(np.array([*COLORS, [0.0] * 3, [0.95] * 3]), 2, axis=0)
    smooth = np.arange(16) >= 14
    materials = TriangleMaterials(colors, np.where(smooth, 0.02, 1.0), smooth * 1.0)
    toward = [[[1.5, -1.5, 1.4], [-2.0, 0.2, 1.6]], [[1.5, 1.5, 1.2], [-2.0, -0.2, 1.7]]]
    toward += [[[0.6, -0.9, 1.5], [-2.0, 0.1, 1.9]], [[0.3, 0.2, 0.6], [-2.0, 0.0, 1.6]]]
    lamps = table([12, 13], [30.0, 25.0, 20.0])
    capture = photograph_room(room, materials, lamps, cameras=[*CAMERAS[:4], *toward], scale=2, spp=32)
    _, found, _ = checked(tmp_path / "mirror", capture)
    assert found.lamps == []
