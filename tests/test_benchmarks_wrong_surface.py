# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Which pixels see the wrong surface, and which rays of lamps leave."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import wrong_surface
from samples.small_rooms import BOX, make_room


def test_distances_without_a_surface_are_equal_and_farther_than_all_others() -> None:
    one, other = np.array([np.inf, np.inf, 2.0, 1.05]), np.array([np.inf, 2.0, np.inf, 1.0])
    assert wrong_surface.farther(one, other, 0.1).tolist() == [False, True, False, False]
    assert wrong_surface.farther(one, other, 0.01).tolist() == [False, True, False, True]


def test_borders_are_right_for_a_pixel_beside_them() -> None:
    true = np.full((5, 6), 3.0)
    true[:, :3] = 1.0
    found = true.copy()
    found[2, 2] = 3.0  # the border is off by a pixel
    found[2, 0] = 3.0  # a hole
    near = wrong_surface.near_right(found, true, 0.1)
    assert near[2, 2] and not near[2, 0]


def test_rays_leave_through_a_missing_side() -> None:
    whole, opened = make_room(BOX), make_room([*BOX[:2], *BOX[3:]])
    triangles = np.zeros(len(whole.triangles), np.int64)
    emits = np.zeros(len(whole.triangles), bool)
    emits[np.argmax(whole.vertices[whole.triangles][..., 2].min(axis=1))] = True  # of the ceiling
    truth = wrong_surface.Truth(whole, triangles, emits)
    assert wrong_surface.leaving(whole, truth, 0.05) == 0.0
    assert 0.05 < wrong_surface.leaving(opened, truth, 0.05) < 0.5


def test_rows_name_what_is_on() -> None:
    rows = wrong_surface.changes(["none", "panes+torn_parts", "all"])
    on = [[getattr(each, kind) for kind in wrong_surface.KINDS] for each in rows.values()]
    assert on == [[False] * 3, [True, False, True], [True] * 3]
    with pytest.raises(AttributeError):
        rows["none"].no_such_kind  # noqa: B018
