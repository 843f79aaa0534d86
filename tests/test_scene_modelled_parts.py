"""Parts of a modelled mesh: slots and objects give the borders, masks divide them where they agree."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fipt_blender.core.parts.labels import label_parts
from fipt_blender.core.surface.room import Room
from samples.scans import grid_triangles
from samples.small_rooms import mesh_room

SIDE = 12  # squares along an edge of a board
BOARD = 2 * SIDE * SIDE


def boards(slots: tuple[int, ...], parts: str = "auto") -> Room:
    """Flat boards of `BOARD` triangles beside each other, each an object with the given material."""
    places = np.stack(np.meshgrid(np.arange(SIDE + 1.0), np.arange(SIDE + 1.0), [0.0]), -1).reshape(-1, 3)
    count = len(slots)
    vertices = np.concatenate([places + (20.0 * index, 0.0, 0.0) for index in range(count)])
    triangles = np.concatenate([grid_triangles(SIDE, SIDE) + index * len(places) for index in range(count)])
    owner = np.repeat(np.arange(count, dtype=np.int32), BOARD)
    room = mesh_room(vertices, triangles, owner, parts=parts)
    names = {name: tuple(f"{name} {index}" for index in range(count)) for name in ("objects", "materials")}
    return replace(room, triangle_material=np.array(slots, np.int32)[owner], **names)


def parts_of(room: Room, ids: np.ndarray) -> np.ndarray:
    """Parts by a mask in which each triangle (T,) of a row has four by four pixels of its id."""
    mask = np.kron(ids[None], np.ones((4, 4), int))
    seen = np.tile(np.repeat(np.arange(len(ids)), 4), 4)
    return label_parts(room, "masks", [mask], [seen]).triangle_part


def test_a_few_triangles_of_another_id_stay_in_their_slot():
    room = boards((0, 1))
    ids = np.repeat([7, 8], BOARD)
    ids[[3, 4, 5, 40, 41]] = 8  # a mask that is misplaced
    ids[BOARD : BOARD + 9] = 7
    assert (parts_of(room, ids) == room.triangle_material).all()
    alone = parts_of(replace(room, parts="masks"), ids)
    assert (alone != room.triangle_material).sum() == 14  # what masks alone say


def test_masks_divide_a_slot_where_they_agree():
    room = boards((0, 0, 1))
    found = parts_of(room, np.repeat([7, 8, 9], BOARD))  # by object
    assert [len(np.unique(found[room.triangle_object == each])) for each in range(3)] == [1, 1, 1]
    assert len(np.unique(found)) == 3
    ids = np.full(len(room.triangles), 7)
    ids[: BOARD // 3] = 8  # a third of a flat board
    found = parts_of(room, ids)
    assert len(np.unique(found[:BOARD])) == 2 and found[0] != found[BOARD - 1]
    assert (found[BOARD // 3 : BOARD] == found[BOARD]).all()


@pytest.mark.parametrize("ids", [(7, 7, 7), (7, 0, 9)])
def test_one_slot_is_one_part_over_several_objects_and_where_no_pixel_sees_it(ids):
    room = boards((0, 0, 1))
    assert (parts_of(room, np.repeat(ids, BOARD)) == room.triangle_material).all()


def test_objects_count_where_there_are_no_slots():
    room = replace(boards((0, 0)), triangle_material=np.full(2 * BOARD, -1, np.int32), materials=())
    assert (parts_of(room, np.full(2 * BOARD, 7)) == room.triangle_object).all()
