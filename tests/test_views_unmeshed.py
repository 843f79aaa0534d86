# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps that the mesh lacks are found, reported and left out of the pixels; other lamps are not."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.tracer.surfaces import TriangleMaterials
from fipt_blender.core.capture.images import read_radiance
from fipt_blender.core.checks.view_check import ViewCheck
from fipt_blender.core.pixels.store import LEFT_OUT
from samples.checked_views import run_check
from samples.scans import scanned_box
from samples.small_captures import CAMERAS, COLORS, PANEL, SmallCapture, photograph_room
from samples.small_rooms import BOX, make_room, room_with_bulb, table

PLACE = [0.3, 0.2, 1.6]
VIEWS = [*CAMERAS, [[1.5, 0.2, 1.8], [-1.2, -0.4, 1.4]], [[-0.3, 1.7, 1.5], [0.1, -1.5, 1.6]]]


@pytest.fixture(scope="module")
def with_bulb() -> SmallCapture:
    """A hanging bulb of 12 cm in a coloured box."""
    room = room_with_bulb(0.06, PLACE, parts="objects")
    colors = np.concatenate([np.repeat(np.array(COLORS), 2, axis=0), np.zeros((8, 3))])
    materials = TriangleMaterials(colors, np.ones(20), np.zeros(20))
    lamps = table(list(range(12, 20)), [80.0, 70.0, 60.0])
    return photograph_room(room, materials, lamps, cameras=VIEWS, scale=2, spp=32)


def test_a_lamp_without_mesh_is_named_and_left_out(with_bulb: SmallCapture, tmp_path: Path) -> None:
    pixels, check, messages = run_check(tmp_path, replace(with_bulb, room=make_room(BOX, parts="objects")))
    (message,) = messages
    assert message["code"] == "lamp-without-mesh" and message["remedy"]
    (lamp,) = check.lamps
    assert lamp["position"] == pytest.approx(PLACE, abs=0.06)
    # An octahedron's mean shadow is a quarter of its surface.
    shadow = np.sqrt(3.0) * 0.06**2
    assert np.pi * lamp["radius"] ** 2 == pytest.approx(shadow, rel=0.35)
    first = pixels.rows(0)
    image = read_radiance(pixels.views[0].image).reshape(-1, 3)
    scale = float(image.sum() / np.asarray(pixels.radiance[first]).sum())
    power = np.pi * lamp["radius"] ** 2 * np.array(lamp["radiance"]) * scale
    assert power == pytest.approx(shadow * np.array([80.0, 70.0, 60.0]), rel=0.2)
    left = np.asarray(pixels.triangle) != LEFT_OUT
    # No remaining pixel is as bright as the lamp, and few are left out.
    assert np.asarray(pixels.radiance)[left].max() < 0.2 * np.asarray(pixels.radiance).max()
    assert (~left).mean() < 0.02


def test_a_lamp_with_mesh_and_one_in_a_mirror_are_no_such_lamps(with_bulb: SmallCapture, tmp_path: Path) -> None:
    _, check, messages = run_check(tmp_path / "bulb", with_bulb)
    assert check == ViewCheck() and messages == []
    mirror = [[-1.98, -0.9, 0.6], [-1.98, 0.9, 0.6], [-1.98, 0.9, 2.4], [-1.98, -0.9, 2.4]]
    room = make_room([*BOX, PANEL, mirror], parts="objects")
    colors = np.repeat(np.array([*COLORS, [0.0] * 3, [0.95] * 3]), 2, axis=0)
    smooth = np.arange(16) >= 14
    materials = TriangleMaterials(colors, np.where(smooth, 0.02, 1.0), smooth * 1.0)
    toward = [[[1.5, -1.5, 1.4], [-2.0, 0.2, 1.6]], [[1.5, 1.5, 1.2], [-2.0, -0.2, 1.7]]]
    toward += [[[0.6, -0.9, 1.5], [-2.0, 0.1, 1.9]], [[0.3, 0.2, 0.6], [-2.0, 0.0, 1.6]]]
    lamps = table([12, 13], [30.0, 25.0, 20.0])
    capture = photograph_room(room, materials, lamps, cameras=[*CAMERAS[:4], *toward], scale=2, spp=32)
    _, check, _ = run_check(tmp_path / "mirror", capture)
    assert check.lamps == []


def test_a_lamp_that_a_scan_lacks_is_named_too(with_bulb: SmallCapture, tmp_path: Path) -> None:
    scan, _ = scanned_box(noise=0.003)
    assert scan.scan is not None
    _, check, _ = run_check(tmp_path, replace(with_bulb, room=scan))
    (lamp,) = check.lamps
    assert lamp["position"] == pytest.approx(PLACE, abs=0.06)


def test_a_white_table_without_mesh_is_left_out_but_no_lamp(tmp_path: Path) -> None:
    """Below a lamp it is the brightest thing beside it: less bright than white, which a lamp exceeds."""
    top = [[-0.2, -0.2, 0.9], [0.2, -0.2, 0.9], [0.2, 0.2, 0.9], [-0.2, 0.2, 0.9]]
    whole, lacking = (make_room([*BOX, PANEL, *more], parts="objects") for more in ([top], []))
    colors = np.repeat(np.array([*([[0.04] * 3] * 6), [0.0] * 3, [0.85] * 3]), 2, axis=0)
    materials = TriangleMaterials(colors, np.ones(16), np.zeros(16))
    corners = [(1.7, 0.3), (-1.6, 0.8), (0.4, 1.7), (0.2, -1.7), (-1.5, -1.4), (1.5, 1.4)]
    down = [[[x, y, 2.6], [-0.2 * x, -0.2 * y, 0.4]] for x, y in corners]
    capture = photograph_room(
        whole, materials, table([12, 13], [30.0, 25.0, 20.0]), cameras=[*down, *CAMERAS[1:6:2]], scale=2, spp=32
    )
    pixels, check, messages = run_check(tmp_path, replace(capture, room=lacking))
    assert check.lamps == [] and messages == []
    assert 0.0 < (np.asarray(pixels.triangle) == LEFT_OUT).mean() < 0.1
