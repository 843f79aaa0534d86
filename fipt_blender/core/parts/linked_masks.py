"""Part masks whose ids are valid in one view only, from networks that segment one photograph at a time.

Their regions are linked on the mesh, and written with ids that all views share.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.sparse import csr_array

from ..capture.images import write_exr
from ..capture.views import View
from ..pixels.camera_rays import first_hits, trace_pixels
from ..pixels.grouped import numbered, pairs_of, strongest
from ..pixels.store import CELL_PIXELS
from ..surface.room import Room
from .coverage import coarse_view, resampled
from .labels import choose_source
from .linking import RegionPixels, link_regions

# Masks share their ids if a cell with an id in one view has the same id in other views at least this often.
# The median over the ids counts: where ids are ordered by size, those of walls and floors agree by chance.
SHARED = 0.2
# A region belongs to one part if this share of its pixels sees that part.
ONE_PART = 0.7
# Most cells; where views see more, the width of a cell is doubled until they see fewer. Rooms have 100,000.
MOST_CELLS = 400_000


@dataclass(frozen=True)
class _Seen:
    """The surface cells and ids that a view with part masks sees, on a coarse grid of pixels.

    Attributes:
        view: at its own size.
        ids: (h, w) int32 id of each pixel of the grid.
        cell: (h, w) int64 cell that it sees; -1 where it sees nothing or has no id.
    """

    view: View
    ids: np.ndarray
    cell: np.ndarray


def link_masks(room: Room, views: Sequence[View], folder: Path) -> dict[str, Path]:
    """Files of part masks whose ids all views share, by the views' names; none where those of the views do.

    Mitsuba's variant must be set.

    Args:
        folder: for the files; what is in it is removed.
    """
    shutil.rmtree(folder, ignore_errors=True)
    if choose_source(room, views) != "masks":
        return {}
    seen, places = seen_cells(room, views)
    known = [one.cell >= 0 for one in seen]
    pixels = [
        RegionPixels(one.ids[k].astype(np.int64), one.cell[k]) for one, k in zip(seen, known, strict=True)
    ]
    if shared_ids(pixels) >= SHARED:
        return {}
    part = link_regions(pixels, places)
    files = {one.view.name: folder / f"{one.view.name}.exr" for one in seen}
    for one in seen:
        write_exr(files[one.view.name], _linked(one, np.append(part, -1)[one.cell]))
    return files


def with_masks(views: Sequence[View], files: Mapping[str, Path]) -> list[View]:
    """The views with other part masks, by their names."""
    return [replace(view, parts=files.get(view.name, view.parts)) for view in views]


def shared_ids(views: Sequence[RegionPixels]) -> float:
    """0..1, how often the id of a place is the same in two views; median over the ids, 1 without any."""
    pairs = [pairs_of(view.cell, view.region)[:2] for view in views]
    if not pairs:
        return 1.0
    cell, region, pair = pairs_of(*map(np.concatenate, zip(*pairs, strict=True)))
    count, number = np.bincount(pair), numbered([region])
    total = np.bincount(cell, count)[cell]
    same = np.bincount(number, count * (count - 1.0))
    pairs_seen = np.bincount(number, count * (total - 1.0))
    known = pairs_seen > 0
    return float(np.median(same[known] / pairs_seen[known])) if known.any() else 1.0


def seen_cells(room: Room, views: Sequence[View]) -> tuple[list[_Seen], np.ndarray]:
    """The surface cells and ids that the views with part masks see, and (C, 3) int64 places of the cells."""
    points, widths, images = [], [], []
    views = [view for view in views if view.parts]
    for view in views:
        coarse = coarse_view(view)
        distance = first_hits(trace_pixels(room, coarse))[1]
        hit = np.isfinite(distance)
        origin, directions = coarse.rays()
        point = origin + directions.reshape(-1, 3) * np.where(hit, distance, np.nan)[:, None]
        points.append(point.reshape(coarse.height, coarse.width, 3))
        widths.append(float(np.median(distance[hit])) / coarse.fx if hit.any() else 0.0)
        images.append(resampled(_mask(view), (coarse.height, coarse.width)))
    size = max(CELL_PIXELS * float(np.median(widths)) if widths else 0.0, 1e-6)
    usable = [(ids > 0) & np.isfinite(point[..., 0]) for ids, point in zip(images, points, strict=True)]
    used = [point[chosen] for point, chosen in zip(points, usable, strict=True)]
    every = np.floor((np.concatenate([*used, np.zeros((0, 3))]) - room.bounds[0]) / size)
    places, number = np.unique(every.astype(np.int64), axis=0, return_inverse=True)
    while len(places) > MOST_CELLS:
        places, wider = np.unique(places // 2, axis=0, return_inverse=True)
        number = wider.reshape(-1)[number.reshape(-1)]
    seen, first = [], 0
    for view, ids, chosen in zip(views, images, usable, strict=True):
        cell, count = np.full(ids.shape, -1), int(chosen.sum())
        cell[chosen] = number.reshape(-1)[first : first + count]
        seen.append(_Seen(view, ids, cell))
        first += count
    return seen, places


def _mask(view: View) -> np.ndarray:
    """(H, W) int32 ids of a view with part masks, 0 for none."""
    ids = view.part_ids()
    assert ids is not None
    return np.maximum(ids, 0)


def _linked(seen: _Seen, part: np.ndarray) -> np.ndarray:
    """(H, W) int32 part of each pixel from 1, 0 for none.

    In each view a part belongs to the region that contains most of its pixels. The other pixels of a region
    that has parts are taken to look through a hole of the scan, or past its edge.

    Args:
        part: (h, w) int64 of each pixel of the grid, -1 for none.
    """
    mask, known = _mask(seen.view), part >= 0
    ones = np.ones(int(known.sum()), np.int64)
    shape = int(mask.max()) + 1, max(int(part.max()) + 1, 1)
    counts = csr_array((ones, (seen.ids[known], part[known])), shape=shape)
    total, most, largest = counts.sum(axis=1), counts.max(axis=1).toarray(), counts.argmax(axis=1)
    region_of = counts.argmax(axis=0)
    table = counts.tocoo()
    own = region_of[table.col] == table.row
    main = strongest(table.row[own], table.col[own], table.data[own], shape[0], "high")
    of_one = (total > 0) & (most >= ONE_PART * total)
    fine = resampled(part, mask.shape)
    past = (main[mask] >= 0) & ((fine < 0) | (region_of[fine] != mask))
    found = np.where(of_one[mask], largest[mask], np.where(past, main[mask], fine))
    return np.where(mask > 0, found + 1, 0).astype(np.int32)
