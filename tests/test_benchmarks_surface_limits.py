# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a mesh allows an estimate to reach."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks import metrics, surface_limits
from fipt_blender.core.capture.views import View
from fipt_blender.core.pixels.camera_rays import trace_pixels
from fipt_blender.core.surface.room import Room
from samples.part_views import looking_views
from samples.small_rooms import BOX, make_room


def maps_of(room: Room, view: View) -> metrics.Maps:
    """Maps that are smooth functions of the place."""
    place = np.array(trace_pixels(room, view).position).T.reshape(view.height, view.width, 3)
    values = 0.5 + 0.4 * np.sin(2.0 * place)
    black, hit = np.zeros_like(values), np.ones(values.shape[:2], bool)
    return metrics.Maps(values, values, black, np.ones(hit.shape), values[..., 0], black, hit)


@pytest.fixture
def reference(tmp_path: Path) -> surface_limits.Reference:
    room = make_room(BOX)
    views = looking_views(tmp_path, room)
    maps = [maps_of(room, view) for view in views]
    # Held-back views see what others see.
    return surface_limits.Reference(room, views, views[::5], maps, maps[::5])


def test_the_true_mesh_is_hardly_limited(reference: surface_limits.Reference) -> None:
    limits = reference.limits(reference.room)
    assert limits.within == (1.0, 1.0, 1.0) and limits.missing == limits.extra == 0.0
    assert limits.turned < 0.1 and limits.kept > 0.99
    assert limits.maps["kd_psnr"] > 30.0


def test_what_a_mesh_lacks_and_what_is_off_limits_it(reference: surface_limits.Reference) -> None:
    whole = reference.limits(reference.room)
    opened = reference.limits(make_room([*BOX[:2], *BOX[3:]]))
    assert opened.missing > 0.01 and opened.kept < 0.99 and opened.within[2] < 1.0
    assert opened.maps["kd_psnr"] < whole.maps["kd_psnr"]
    room = reference.room
    vertices = room.vertices + np.float32([0.0, 0.0, 0.03])
    moved = reference.limits(surface_limits.bare_room(vertices, room.triangles))
    assert moved.within[0] < moved.within[2] and moved.kept < 0.99
