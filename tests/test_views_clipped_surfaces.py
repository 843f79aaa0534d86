"""Which triangles are one clipped surface: connected ones of a model, those of one label on a scan."""

from pathlib import Path

import numpy as np

from fipt_blender.core.capture.views import View
from fipt_blender.core.photometry.clipped_surfaces import find_clipped_surfaces
from fipt_blender.core.photometry.codes import Codes
from fipt_blender.core.pixels.store import create_pixels
from samples.scans import scanned_box
from samples.small_rooms import BOX, make_room

ROOM, SIDE = scanned_box(noise=0.002)
EVERY = np.arange(len(SIDE))
CEILING = 1
FOOTPRINT = 0.1


def codes_of(folder: Path, triangles: np.ndarray, clipped: np.ndarray) -> Codes:
    """One photograph with a pixel on each triangle (N,), white where it is clipped (N,)."""
    count = len(triangles)
    view = View("train/0", "train", Path(), count, 1, 1.0, 1.0, 0.0, 0.0, np.eye(4))
    pixels = create_pixels(folder / "pixels", [view])
    pixels.triangle[:] = triangles
    stored = np.where(clipped, 65535, 30000).astype(np.uint16)
    return Codes(pixels, [0], np.repeat(stored[:, None], 3, axis=1))


def on_ceiling(low: float, high: float) -> np.ndarray:
    """(T,) bool, triangles of the scanned ceiling between two x."""
    assert ROOM.scan is not None
    return np.asarray((SIDE == CEILING) & (ROOM.scan.centers[:, 0] > low) & (ROOM.scan.centers[:, 0] < high))


def test_a_surface_of_a_scan_includes_triangles_that_no_pixel_sees(tmp_path: Path) -> None:
    """Every third triangle is seen. Of a lamp, and not of the wall, they are clipped."""
    lamp = on_ceiling(-0.4, 0.4)
    seen = np.arange(0, len(SIDE), 3)
    found = find_clipped_surfaces(ROOM, codes_of(tmp_path, seen, lamp[seen]), np.where(lamp, 1, 0), FOOTPRINT)
    areas = ROOM.areas
    assert areas[(found == 0) & lamp].sum() > 0.97 * areas[lamp].sum()
    assert areas[(found >= 0) & ~lamp].sum() == 0.0
    assert areas[lamp & np.isin(np.arange(len(lamp)), seen)].sum() < 0.5 * areas[lamp].sum()


def test_a_lamp_and_the_clipped_wall_around_it_are_two_surfaces_of_a_scan(tmp_path: Path) -> None:
    lamp, glare = on_ceiling(-0.4, 0.4), on_ceiling(0.4, 0.9)
    codes = codes_of(tmp_path, EVERY, lamp | glare)
    found = find_clipped_surfaces(ROOM, codes, np.where(lamp, 1, 0), FOOTPRINT)
    assert len(np.intersect1d(found[lamp], found[glare])) == 0
    assert (found[lamp] >= 0).mean() > 0.97 and (found[glare] >= 0).mean() > 0.8


def test_pieces_of_a_lamp_behind_bars_are_one_surface_and_spots_on_a_wall_are_not(tmp_path: Path) -> None:
    ends = on_ceiling(-0.9, -0.3) | on_ceiling(0.3, 0.9)
    codes = codes_of(tmp_path, EVERY, ends)
    one = find_clipped_surfaces(ROOM, codes, np.where(ends, 1, 0), FOOTPRINT)
    assert len(np.unique(one[ends])) == 1
    spots = find_clipped_surfaces(ROOM, codes, np.zeros(len(SIDE), np.int32), FOOTPRINT)
    assert len(np.unique(spots[ends & (spots >= 0)])) == 2


def test_triangles_of_a_model_stand_for_themselves(tmp_path: Path) -> None:
    room = make_room(BOX)
    every = np.arange(len(room.triangles))
    codes = codes_of(tmp_path, every, every == 3)
    label = np.zeros(len(every), np.int32)
    assert np.flatnonzero(find_clipped_surfaces(room, codes, label, FOOTPRINT) >= 0).tolist() == [3]
