"""Regions of single photographs: which belong together, and part masks that are made of them."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.capture.views import View
from fipt_blender.core.estimate.input import prepare_input
from fipt_blender.core.parts import linked_masks, linking
from fipt_blender.core.parts.linked_masks import link_masks, shared_ids, with_masks
from fipt_blender.core.parts.linking import RegionPixels, link_regions
from fipt_blender.core.pixels.camera_rays import trace_pixels
from fipt_blender.core.run.messages import Reporter
from fipt_blender.core.run.settings import make_settings
from fipt_blender.core.surface.room import load_room
from samples.part_views import THING_PART, looking_views, numbered_anew, with_own_ids, write_run
from samples.scans import joined, scanned_box
from samples.small_captures import write_views

WIDTH, HEIGHT, VIEWS = 40, 30, 9
ROWS, COLUMNS = np.divmod(np.arange(HEIGHT * WIDTH), WIDTH)
PLACES = np.stack([COLUMNS, ROWS, 0 * ROWS], axis=1)
# A wall, a picture on it and a strip along its foot.
TRUE = np.where((ROWS > 8) & (ROWS < 20) & (COLUMNS > 12) & (COLUMNS < 28), 1, np.where(ROWS > 25, 2, 0))

Divide = Callable[[int, np.random.Generator], np.ndarray]


def as_it_is(number: int, rng: np.random.Generator) -> np.ndarray:
    return TRUE


def cut(number: int, rng: np.random.Generator) -> np.ndarray:
    """A third of the views cut everything along a line, each along another."""
    return TRUE + 3 * ((number % 3 == 0) & (COLUMNS > rng.integers(5, 35)))


def confused(number: int, rng: np.random.Generator) -> np.ndarray:
    """Three of the nine views take the picture for wall."""
    return np.where((number % 3 == 0) & (TRUE == 1), 0, TRUE)


def shifted(number: int, rng: np.random.Generator) -> np.ndarray:
    """Borders lie off by up to a cell."""
    rows, columns = np.clip(ROWS + rng.integers(-1, 2), 0, HEIGHT - 1), COLUMNS + rng.integers(-1, 2)
    return TRUE[rows * WIDTH + np.clip(columns, 0, WIDTH - 1)]


def views_of(divide: Divide, rng: np.random.Generator, hidden: float = 0.3) -> list[RegionPixels]:
    views = []
    for number in range(VIEWS):
        seen = np.flatnonzero(rng.random(len(TRUE)) > hidden)
        views.append(RegionPixels(numbered_anew(divide(number, rng), rng)[seen].astype(np.int64), seen))
    return views


def impure(part: np.ndarray, true: np.ndarray) -> int:
    """How many cells are not of the true part that most cells of their part are of."""
    pairs = np.unique(np.stack([part, true]), axis=1, return_counts=True)
    return len(part) - sum(pairs[1][pairs[0][0] == number].max() for number in np.unique(part))


@pytest.mark.parametrize("divide", [as_it_is, cut, confused, shifted])
def test_what_most_views_show_in_one_region_is_one_part(divide: Divide, rng: np.random.Generator) -> None:
    part = link_regions(views_of(divide, rng), PLACES)
    assert part.min() == 0 and len(np.unique(part)) == part.max() + 1
    # Each part lies in one true part, and the reverse, up to cells that few other views show.
    few = 0.08 * len(TRUE) if divide in (shifted, confused) else 2
    assert impure(part, TRUE) <= few and impure(TRUE, part) <= few


def test_a_region_that_one_view_alone_shows_whole_does_not_join_parts(rng: np.random.Generator) -> None:
    """One view of many that takes all for one region changes nothing."""
    everything = RegionPixels(np.ones(len(TRUE), np.int64), np.arange(len(TRUE)))
    part = link_regions([*views_of(as_it_is, rng), everything], PLACES)
    assert impure(part, TRUE) == 0 and len(np.unique(part)) == 3


def test_places_apart_are_one_part_if_views_show_them_in_one_region(rng: np.random.Generator) -> None:
    """What stands before a wall divides it; and no view needs to see both ends of a part."""
    sides = np.flatnonzero((COLUMNS < 15) | (COLUMNS > 25))
    wall = RegionPixels(np.full(len(sides), 4), np.arange(len(sides)))
    assert link_regions([wall], PLACES[sides]).max() == 0
    half = COLUMNS < 24, COLUMNS > 16
    views = [RegionPixels(np.full(int(side.sum()), 4), np.flatnonzero(side)) for side in half]
    assert link_regions(views, PLACES).max() == 0
    assert link_regions([], PLACES[:0]).shape == (0,)


def test_whether_ids_are_shared(rng: np.random.Generator) -> None:
    every = np.arange(len(TRUE))
    shared = [RegionPixels(shifted(number, rng) + 5, every) for number in range(VIEWS)]
    own = [RegionPixels(100 * number + view.region, view.cell) for number, view in enumerate(shared)]
    assert shared_ids(shared) > 0.7 and shared_ids(own) == 0.0 and shared_ids([]) == 1.0
    # Numbered by size, the largest region has the same id in all views by chance.
    sizes = [np.where(TRUE == 0, 1, rng.integers(2, 30, 3)[TRUE]) for _ in range(VIEWS)]
    assert shared_ids([RegionPixels(ids, every) for ids in sizes]) < 0.2


def thing() -> tuple[np.ndarray, np.ndarray]:
    """A box in the middle of the room, of small triangles."""
    room, _ = scanned_box(cells=16, noise=0.003, seed=1)
    return 0.2 * room.vertices + [0.0, 0.0, 0.2], room.triangles[:, ::-1]


@pytest.fixture
def run_and_views(tmp_path: Path, rng: np.random.Generator):
    """A run of a scanned room with a thing in it, and views whose masks have ids of their own."""
    scan, _ = scanned_box(cells=30, noise=0.003)
    run = write_run(tmp_path, joined(scan, *thing(), 0), "masks")
    views = looking_views(tmp_path, joined(scan, *thing(), 1))
    return run, views, with_own_ids(views, rng)


def test_masks_with_own_ids_get_shared_ones(run_and_views) -> None:
    run, views, own = run_and_views
    room = load_room(run)
    none = [replace(view, parts=None) for view in own]
    assert link_masks(room, views, run.linked) == {} == link_masks(room, none, run.linked)
    some = [replace(view, parts=None) if view.name < "5" else view for view in own]
    files = link_masks(room, some, run.linked)
    assert files.keys() == {view.name for view in own if view.name >= "5"}
    linked = with_masks(own, link_masks(room, own, run.linked))
    found = np.stack([view.part_ids() for view in linked])
    true = np.stack([view.part_ids() for view in views]) == THING_PART
    ids = np.unique(found[true])
    assert len(ids) == 1 and (np.isin(found, ids) == true).all() and found.min() > 0


def test_masks_that_were_linked_half_way_are_linked_again(run_and_views, monkeypatch: pytest.MonkeyPatch) -> None:
    """Cancelled with other masks, then the former ones again."""
    run, _, own = run_and_views
    others = [replace(view, parts=None) if view.name < "5" else view for view in own]
    settings = make_settings(changes={"force": True, "outlines": False})

    def masks(views: list[View]) -> list[bytes | None]:
        write_views(run, views)
        found = prepare_input(run, settings, Reporter()).values["views"].value
        return [view.parts and view.parts.read_bytes() for view in found]

    first, written = masks(own), []

    def stop(path: Path, array: np.ndarray) -> None:
        written.append(path)
        if len(written) == 2:
            raise KeyboardInterrupt
        write_exr(path, array)

    with monkeypatch.context() as patch:
        patch.setattr(linked_masks, "write_exr", stop)
        with pytest.raises(KeyboardInterrupt):
            masks(others)
    assert masks(own) == first


@pytest.mark.parametrize("shared", [True, False])
def test_views_are_traced_once_for_a_run_its_resume_and_a_second_estimate(
    run_and_views, monkeypatch: pytest.MonkeyPatch, shared: bool
) -> None:
    run, views, own = run_and_views
    views, traced = views if shared else own, []
    monkeypatch.setattr(
        linked_masks, "trace_pixels", lambda room, view: traced.append(view.name) or trace_pixels(room, view)
    )
    write_views(run, views)
    for _ in ("run", "resume", "second estimate"):
        found = prepare_input(run, make_settings(changes={"force": True}), Reporter()).values["views"].value
        assert [view.parts == own.parts for view, own in zip(found, views, strict=True)] == [shared] * len(views)
    assert sorted(traced) == sorted(view.name for view in views)


@pytest.mark.parametrize("most", [2, 1000])
def test_more_sets_than_the_budget_are_bounded(monkeypatch: pytest.MonkeyPatch, most: int) -> None:
    """Two walls that lie apart are one region in all views, among specks that one view each sees."""
    monkeypatch.setattr(linking, "MOST_SETS", most)
    places = np.concatenate([PLACES, PLACES + [200, 0, 0], [[500 * speck, 900, 0] for speck in range(20)]])
    walls = np.arange(2 * len(PLACES))
    views = [RegionPixels(np.ones(len(walls), np.int64), walls) for _ in range(4)]
    views += [RegionPixels(np.ones(1, np.int64), np.array([len(walls) + speck])) for speck in range(20)]
    part = link_regions(views, places)
    assert len(np.unique(part[walls])) == 1
    assert len(np.unique(part)) == 21


def test_places_that_no_two_views_share_take_bounded_memory_and_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """As of a mesh in millimetres among cameras in metres: each pixel sees a cell of its own."""
    monkeypatch.setattr(linking, "MOST_SETS", 500)
    count = 8_000
    views = [RegionPixels(np.ones(count // 10, np.int64), np.arange(view, count, 10)) for view in range(10)]
    tracemalloc.start()
    part = link_regions(views, 100 * np.stack([np.arange(count)] * 3, axis=1))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    # 500 sets of one view each are one region of it; all others stay alone. All pairs would take 512 MB.
    assert len(np.unique(part)) > count - 500 and peak < 100e6
