"""Parts of triangles: votes of pixels, ties, sparse ids, neighbours, and the choice of the source."""

import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core.capture.images import MAX_ID, write_exr
from fipt_blender.core.capture.views import View
from fipt_blender.core.parts.labels import NO_PART, choose_parts, fuse_masks
from fipt_blender.core.parts.spreading import spread_labels
from fipt_blender.core.surface.adjacency import weld
from samples.small_rooms import BOX, make_room


def test_the_majority_of_all_views_wins() -> None:
    first = np.array([[5, 5, 9], [9, 9, 0]])
    second = np.array([[5, 5, 5], [7, 0, -1]])
    seen = np.array([0, 0, 0, 1, 1, 2])
    again = np.array([1, 1, 1, 3, 3, -1])
    # triangle 0: 5, 5, 9; triangle 1: 9, 9 and 5, 5, 5; triangle 2: only background; triangle 3: 7 and 0
    assert fuse_masks([first, None, second], [seen, seen, again], 5).tolist() == [5, 5, NO_PART, 7, NO_PART]


def test_ties_go_to_the_lower_id_whatever_the_order() -> None:
    for ids in ([3, 8, 8, 3], [8, 3, 3, 8]):
        assert fuse_masks([np.array([ids])], [np.zeros(4, int)], 1).tolist() == [3]


def test_the_highest_id_counts_and_huge_ids_cost_nothing() -> None:
    """Colour masks have ids up to 2^24: no array may have a length in proportion to the ids."""
    mask = np.array([[MAX_ID, MAX_ID, 1, MAX_ID - 1]])
    tracemalloc.start()
    found = fuse_masks([mask], [np.array([0, 0, 0, 1])], 2)
    spread = spread_labels(np.array([MAX_ID, NO_PART]), np.array([[0, 1, 2], [2, 3, 4]]))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert found.tolist() == [MAX_ID, MAX_ID - 1] and spread.tolist() == [MAX_ID, MAX_ID]
    assert peak < 1_000_000


@pytest.mark.parametrize("seed", range(6))
def test_labels_spread_ring_by_ring_whatever_the_mesh(seed: int) -> None:
    random = np.random.default_rng(seed)
    triangles = random.integers(0, random.integers(3, 80), (random.integers(0, 60), 3))
    expected = np.where(random.random(len(triangles)) < 0.1, random.integers(0, 9, len(triangles)), NO_PART)
    found = spread_labels(expected, triangles)
    corners = [set(triangle) for triangle in triangles.tolist()]
    while True:
        highest = [
            max((label for label, other in zip(expected, corners, strict=True) if own & other), default=-1)
            for own in corners
        ]
        after = np.where(expected < 0, np.array(highest, np.int64), expected)
        if np.array_equal(after, expected):
            break
        expected = after
    assert np.array_equal(found, expected)


def test_welding_joins_equal_places() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1e-9, 0], [0, 1, 0]], np.float32)
    index = weld(vertices)
    assert index[1] == index[2] and len(set(index.tolist())) == 3
    assert (weld(vertices * 1e4) == index).all()


@pytest.fixture
def view(tmp_path: Path) -> View:
    """Sees triangles 0 to 3 of the box, one per pixel: parts 40 and 2, semantics 6."""
    masks = {"parts": [[40, 40], [2, 2]], "semantics": [[6, 6], [6, 0]]}
    for name, ids in masks.items():
        write_exr(tmp_path / f"{name}.exr", np.array(ids, np.float32))
    lens = (2, 2, 1.0, 1.0, 1.0, 1.0, np.eye(4))
    return View("a", "train", tmp_path / "none.exr", *lens, **{name: tmp_path / f"{name}.exr" for name in masks})


def test_sources_of_parts(view: View) -> None:
    room = make_room(BOX, objects=np.array([0, 0, 1, 1, 2, 2]))
    material = np.where(np.arange(12) < 4, -1, 5).astype(np.int32)
    room = replace(room, triangle_material=material)
    seen = [np.arange(4)]

    def chosen(source: str, views: list[View]):
        return choose_parts(replace(room, parts=source), views, seen)

    objects = chosen("objects", [view])
    assert objects.kind == "part" and (objects.triangle_part == room.triangle_object).all()
    materials = chosen("materials", [view])
    assert materials.kind == "part" and materials.triangle_part.tolist() == [NO_PART] * 4 + [0] * 8
    masks = chosen("masks", [view])
    assert masks.kind == "part" and masks.triangle_part[:4].tolist() == [1, 1, 0, 0]
    assert (masks.triangle_part >= 0).all()  # a closed box: all triangles have labelled neighbours
    semantics = chosen("semantics", [view])
    assert semantics.kind == "semantic" and (semantics.triangle_part == 0).all()
    none = chosen("none", [view])
    assert none.kind == "none" and (none.triangle_part == NO_PART).all()


def test_auto_takes_the_finest_source_there_is(view: View) -> None:
    room = make_room(BOX, parts="auto")
    seen = [np.arange(4)]
    assert choose_parts(room, [view], seen).ids.tolist() == [40, 2, -1, -1, -1, -1]  # its six objects
    whole = replace(room, triangle_object=np.zeros(12, int), triangle_material=np.zeros(12, int))
    assert choose_parts(whole, [view], seen).triangle_part[:4].tolist() == [1, 1, 0, 0]
    view = replace(view, parts=None)
    assert choose_parts(room, [view], seen).kind == "semantic"
    assert choose_parts(replace(room, parts="masks"), [view], seen).kind == "semantic"
    view = replace(view, semantics=None)
    assert choose_parts(replace(room, parts="masks"), [view], seen).kind == "none"
    slots = replace(room, triangle_material=np.where(np.arange(12) < 6, 0, 1).astype(np.int32))
    assert len(np.unique(choose_parts(slots, [view], seen).triangle_part)) == 2
    one_slot = replace(room, triangle_material=np.zeros(12, np.int32))
    assert len(np.unique(choose_parts(one_slot, [view], seen).triangle_part)) == 6  # its six objects
    plain = replace(one_slot, triangle_object=np.zeros(12, np.int32))
    assert choose_parts(plain, [view], seen).kind == "none"
