# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Emitters: found by the mask, grouped into fixtures, measured by clean pixels, spared from reflections."""

import numpy as np
import pytest
from small_rooms import BOX, bulb, make_room, mesh_room

from fipt_blender.core.light.emitters import (
    bright_triangles,
    emitter_table,
    find_emitters,
    group_fixtures,
    reflection_explains,
    side_medians,
)
from fipt_blender.core.scene.room import Room

REACH = 0.01


def room_with_bulb(radius: float = 0.05) -> Room:
    """A box whose lamp is an octahedron: triangles 12 to 19."""
    flat = make_room(BOX)
    vertices, triangles = bulb([0.5, 0.3, 1.0], radius)
    return mesh_room(
        np.concatenate([flat.vertices, vertices]),
        np.concatenate([flat.triangles, triangles + len(flat.vertices)]),
        np.concatenate([flat.triangle_object, np.full(8, 6)]),
    )


def pixels(
    rows: list[tuple[int, bool, bool, float]],
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(triangle, front, pure, radiance) of (triangle, front, pure, grey) rows."""
    triangle, front, pure, grey = (np.array(column) for column in zip(*rows, strict=True))
    return triangle, front.astype(bool), pure.astype(bool), np.repeat(grey[:, None], 3, axis=1)


def test_a_bulb_of_five_centimetres_is_found_and_nothing_else() -> None:
    room = room_with_bulb()

    def mask(positions: np.ndarray) -> np.ndarray:
        inside = np.linalg.norm(positions - [0.5, 0.3, 1.0], axis=1) < 0.06
        return np.where(inside, 0.6, 0.0) + 1e-4  # a trained mask is never quite zero

    found = find_emitters(room, mask, 0.01, 100, np.random.default_rng(0))
    assert np.flatnonzero(found).tolist() == list(range(12, 20))
    # The threshold is on the mean: three quarters of a wall's upper triangle at 0.012 are not enough.
    for alpha, expected in ((0.012, False), (0.02, True)):
        found = find_emitters(
            room, lambda p, a=alpha: a * (p[:, 2] > 1.5), 0.01, 100, np.random.default_rng(0)
        )
        assert found[5] == expected and not found[4] and found[[2, 3]].all()


def test_medians_of_both_sides_from_clean_pixels() -> None:
    group = np.array([0, 0, 1, -1])
    rows = [(0, True, True, 4.0), (0, True, True, 6.0), (1, True, True, 9.0), (1, True, False, 100.0)]
    rows += [(0, False, True, 1.0), (2, True, False, 3.0), (3, True, True, 50.0), (-1, True, True, 70.0)]
    medians, counts = side_medians(*pixels(rows), group)
    assert medians[:, :, 0].tolist() == [[6.0, 1.0], [3.0, 0.0]]
    assert counts.tolist() == [[3, 1], [1, 0]]
    medians, counts = side_medians(*pixels(rows), np.full(4, -1))
    assert len(medians) == 0


def test_two_lamps_apart_are_two_fixtures_with_their_sides() -> None:
    """A panel lit below, and a smaller two-sided one; the dim back of the first counts as dark."""
    first = [[-1.5, -1, 2.9], [-1.5, 0, 2.9], [-0.5, 0, 2.9], [-0.5, -1, 2.9]]
    second = [[0.5, 0, 2.0], [0.5, 0.5, 2.0], [1.0, 0.5, 2.0], [1.0, 0, 2.0]]
    room = make_room([*BOX, first, second])
    emitting = np.zeros(16, bool)
    emitting[12:] = True
    rows = [(12, True, True, 10.0), (13, True, True, 10.5), (12, False, True, 0.4)]
    rows += [(14, True, True, 4.0), (15, True, True, 4.2), (14, False, True, 3.0), (0, True, True, 0.5)]
    fixtures = group_fixtures(room, emitting, *pixels(rows), reach=REACH)
    assert [fixture.triangles.tolist() for fixture in fixtures] == [[12, 13], [14, 15]]
    assert fixtures[0].radiance[0] == pytest.approx(10.25) and fixtures[0].back_radiance[0] == 0.0
    assert fixtures[1].radiance[0] == pytest.approx(4.1) and fixtures[1].back_radiance[0] == 3.0
    assert fixtures[0].area == pytest.approx(1.0) and fixtures[1].area == pytest.approx(0.25)
    assert fixtures[0].centroid == pytest.approx([-1.0, -0.5, 2.9])
    table = emitter_table(fixtures)
    assert table.triangles.tolist() == [12, 13, 14, 15]
    assert table.radiance[:, 1].tolist() == pytest.approx([10.25, 10.25, 4.1, 4.1])
    assert table.back_radiance[:, 2].tolist() == [0.0, 0.0, 3.0, 3.0]
    assert len(emitter_table([]).triangles) == 0
    assert group_fixtures(room, np.zeros(16, bool), *pixels(rows), reach=REACH) == []


def test_touching_triangles_of_unlike_radiance_are_two_fixtures() -> None:
    room = make_room([*BOX, [[0, 0, 2], [0, 1, 2], [1, 1, 2], [1, 0, 2]]])
    emitting = np.zeros(14, bool)
    emitting[12:] = True
    for other, number in ((1.3, 1), (3.0, 2)):
        rows = [(12, True, True, 1.0), (13, True, True, other)]
        assert len(group_fixtures(room, emitting, *pixels(rows), reach=REACH)) == number


def test_unseen_triangles_join_their_lamp_and_black_ones_are_no_lamp() -> None:
    room = room_with_bulb()
    emitting = np.zeros(20, bool)
    emitting[12:15] = True  # what the mask found; 15 to 19 are unseen
    rows = [(i, True, True, 8.0) for i in (12, 13, 14)] + [(2, True, True, 0.3)]
    fixtures = group_fixtures(room, emitting, *pixels(rows), reach=REACH)
    assert [fixture.triangles.tolist() for fixture in fixtures] == [list(range(12, 20))]
    # A dark piece of which little emits does not grow.
    rows += [(i, True, True, 0.2) for i in range(15, 20)]
    fixtures = group_fixtures(room, emitting, *pixels(rows), reach=REACH)
    assert [fixture.triangles.tolist() for fixture in fixtures] == [[12, 13, 14]]
    black = [(i, True, True, 0.0) for i in (12, 13, 14)]
    assert group_fixtures(room, emitting, *pixels(black), reach=REACH) == []


def test_the_far_side_of_a_bulb_in_mixed_pixels_alone_is_the_bulb() -> None:
    """Pixels at its outline show mostly what is behind; the sides seen alone tell how bright it is."""
    room = room_with_bulb()
    emitting = np.zeros(20, bool)
    emitting[12:18] = True
    rows = [(i, True, True, 8.0) for i in (12, 13, 14)] + [(2, True, True, 0.3)]
    rows += [(i, True, False, 0.6) for i in (15, 16, 17, 18)]
    (fixture,) = group_fixtures(room, emitting, *pixels(rows), reach=REACH)
    assert fixture.triangles.tolist() == list(range(12, 20))
    assert fixture.radiance.tolist() == [8.0] * 3
    # Seen alone, a dim side stays out.
    rows += [(19, True, True, 0.2)]
    (fixture,) = group_fixtures(room, emitting, *pixels(rows), reach=REACH)
    assert fixture.triangles.tolist() == list(range(12, 19))


def test_the_rim_of_a_lamp_that_no_pixel_sees_alone_is_no_lamp() -> None:
    """A dim sheet beside a bright lamp, seen by mixed pixels only, is the lamp's light; far away it stays."""
    lamp = [[-1.5, -1, 2.9], [-1.5, 0, 2.9], [-0.5, 0, 2.9], [-0.5, -1, 2.9]]
    rim = [[-0.499, -1, 2.9], [-0.499, 0, 2.9], [-0.48, 0, 2.9], [-0.48, -1, 2.9]]
    room = make_room([*BOX, lamp, rim])
    emitting = np.zeros(16, bool)
    emitting[12:] = True
    for pure, reach, number in ((False, 0.02, 1), (True, 0.02, 2), (False, 1e-4, 2)):
        rows = [(12, True, True, 10.0), (13, True, True, 10.0), (14, True, pure, 3.0), (15, True, pure, 3.0)]
        assert len(group_fixtures(room, emitting, *pixels(rows), reach=reach)) == number


def test_what_is_weak_and_dim_is_no_lamp_but_a_spark_is() -> None:
    """Beside a panel: a dim sliver of less than a thousandth of its power, and as small a bright one."""
    quad = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]]
    small = [[x * 0.02, y * 0.02, 0.0] for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))]
    quads = [quad, [[x + 3.0, y, z] for x, y, z in small], [[x + 6.0, y, z] for x, y, z in small]]
    room = make_room(quads)
    rows = [(0, True, True, 10.0), (1, True, True, 10.0)]
    rows += [(t, True, True, 0.5) for t in (2, 3)] + [(t, True, True, 6.0) for t in (4, 5)]
    fixtures = group_fixtures(room, np.ones(6, bool), *pixels(rows), reach=REACH)
    assert [sorted(f.triangles.tolist()) for f in fixtures] == [[0, 1], [4, 5]]


def test_the_frame_of_a_lamp_is_no_lamp_but_a_lamp_inside_a_ring_of_lamps_is() -> None:
    """Two strips 6 m apart are one bright fixture's box around everything; only what touches them counts."""
    strip = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.1, 6.0, 0.0], [0.0, 6.0, 0.0]]
    bridge = [[0.0, 6.0, 0.0], [6.0, 6.0, 0.0], [6.0, 6.1, 0.0], [0.0, 6.1, 0.0]]
    frame = [[0.105, 0.0, 0.0], [0.155, 0.0, 0.0], [0.155, 6.0, 0.0], [0.105, 6.0, 0.0]]
    inside = [[3.0, 3.0, 0.0], [3.5, 3.0, 0.0], [3.5, 3.5, 0.0], [3.0, 3.5, 0.0]]
    room = make_room([strip, bridge, frame, inside])
    rows = [(t, True, True, 10.0) for t in range(4)] + [(t, True, True, 1.5) for t in range(4, 8)]
    fixtures = group_fixtures(room, np.ones(8, bool), *pixels(rows), reach=REACH)
    assert [sorted(f.triangles.tolist()) for f in fixtures] == [[0, 1, 2, 3], [6, 7]]
    # As bright as a quarter of the lamp it is a lamp of its own.
    rows = [(t, True, True, 10.0) for t in range(4)] + [(t, True, True, 2.5) for t in range(4, 8)]
    assert len(group_fixtures(room, np.ones(8, bool), *pixels(rows), reach=REACH)) == 3


def test_reflection_explains_all_but_what_emits() -> None:
    triangle = np.repeat([0, 1, 2], 5)
    photographed = np.full((15, 3), 2.0)
    rendered = np.repeat([1.9, 0.5, 1.3], 5)[:, None] * np.ones(3)
    rendered[10:12] = 0.0  # stray pixels do not decide
    found = reflection_explains(triangle, photographed, rendered, 4)
    assert found.tolist() == [True, False, False, False]
    # unsorted pixels and an unseen triangle in between
    order = np.random.default_rng(0).permutation(15)
    assert (reflection_explains(triangle[order], photographed[order], rendered[order], 4) == found).all()


def test_bright_triangles_are_aimed_at() -> None:
    room = make_room([*BOX, [[0, 0, 2.9], [0, 0.4, 2.9], [0.4, 0.4, 2.9], [0.4, 0, 2.9]]])
    rows = [(i, True, True, 0.5) for i in range(12)] + [(12, True, True, 60.0), (13, False, True, 40.0)]
    triangle, front, _, radiance = pixels(rows)
    table = bright_triangles(room, triangle, front, radiance)
    assert table.triangles.tolist() == [12, 13]
    assert table.radiance[:, 0].tolist() == [60.0, 0.0] and table.back_radiance[:, 0].tolist() == [0.0, 40.0]
    assert len(bright_triangles(room, triangle, front, radiance * 0.0).triangles) == 0
