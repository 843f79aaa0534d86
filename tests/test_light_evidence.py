# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What pixels testify about emission, and the probability that follows from it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core.capture.views import View
from fipt_blender.core.light.baking import ShadingStore
from fipt_blender.core.light.emission import constancy, emission_probability, log_evidence
from fipt_blender.core.light.emitter_surfaces import EmitterSurfaces, emitter_surfaces
from fipt_blender.core.light.evidence import log_ratio
from fipt_blender.core.parts.labels import Parts
from fipt_blender.core.pixels.store import NO_TRIANGLE, PixelStore, open_pixels
from samples.small_rooms import make_room

# Three quads apart, two triangles each; the views below show the first of each.
WALL, LAMP, BAR = 0, 2, 4
QUAD = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
ROOM = make_room([(QUAD + [2.0 * i, 0.0, 0.0]).tolist() for i in range(3)])
OPTIONS = {".": (WALL, True), "L": (LAMP, True), "l": (LAMP, False), "B": (BAR, True), "b": (BAR, False)}


def store(folder: Path, pictures: list[tuple[list[str], list[list[float]]]], weight: float = 0.5) -> PixelStore:
    """Views of one letter a pixel (OPTIONS: what its centre sees, and capitals where it sees that alone; a
    blank looks outside) and of its grey radiance, which is its own; mixed pixels have the given weight."""
    views = [
        View(f"train/{i}", "train", Path(), len(rows[0]), len(rows), 1.0, 1.0, 0.0, 0.0, np.eye(4))
        for i, (rows, _) in enumerate(pictures)
    ]
    pixels = open_pixels(folder / "pixels", views, create=True)
    for index, (rows, grey) in enumerate(pictures):
        seen = [OPTIONS.get(letter, (NO_TRIANGLE, True)) for letter in "".join(rows)]
        place = pixels.rows(index)
        pixels.triangle[place], pixels.pure[place] = np.array(seen).T
        pixels.radiance[place] = pixels.own[place] = np.array(grey, np.float32).reshape(-1, 1)
        pixels.weight[place] = np.where(pixels.pure[place], 1.0, weight)
    return pixels


def probability(
    pixels: PixelStore,
    told: tuple[int, ...] = (),
    diffuse: np.ndarray | float = 1.0,
    hdr: bool = True,
    **changes: object,
) -> np.ndarray:
    """(T,) probability to emit where L_d is 1, or as given for each pixel, and surfaces are diffuse."""
    ids = np.arange(len(ROOM.triangles))
    surfaces: EmitterSurfaces = replace(emitter_surfaces(ROOM, Parts(ids, "none"), 0.01), **changes)
    light = np.broadcast_to(np.reshape(diffuse, (-1, 1)), (len(pixels), 3)).astype(np.float16)
    shadings = ShadingStore(light, np.zeros((len(pixels), 2, 2, 3), np.float16))
    none, hints = np.zeros(len(ids), bool), np.isin(ids, told).astype(np.int8)
    return emission_probability(
        ROOM, pixels, shadings, lambda rows: light[rows].astype(np.float32), surfaces, hints, none, hdr
    )


def emission(pixels: PixelStore, **options: object) -> list[int]:
    """Triangles that emit; options of :func:`probability`."""
    return np.flatnonzero(probability(pixels, **options) > 0.5).tolist()  # type: ignore[arg-type]


def test_brighter_than_white_is_evidence_and_what_white_explains_is_none() -> None:
    ratio = np.log([0.02, 0.3, 1.0, 1.2, 2.0, 4.0, 40.0])
    found = log_evidence(ratio - 0.02, ratio + 0.02, np.full(7, 0.15))
    assert (found[:4] < 0.0).all() and (found[4:] > 0.0).all() and (np.diff(found) > 0.0).all()
    rough = log_evidence(ratio - 0.02, ratio + 0.02, np.full(7, 0.6))
    assert (rough[4:] < found[4:]).all()  # light that is known less well explains more
    # An interval that may be anything tells nothing, one that is cut off below by white a little.
    assert log_evidence(np.array([-14.0]), np.array([7.0]), np.array([0.15]))[0] == pytest.approx(0.0, abs=0.01)


def test_light_is_unexplained_channel_by_channel() -> None:
    """A red lamp under white light is as bright as a grey wall."""
    lamp, wall = np.array([[3.0, 0.1, 0.1]]), np.full((1, 3), 0.8)
    assert log_ratio(lamp, np.ones((1, 3)))[0] > np.log(2.0)
    assert log_ratio(wall, np.ones((1, 3)))[0] == pytest.approx(np.log(0.8))
    assert log_ratio(2.0 * wall, np.ones((1, 3)))[0] == pytest.approx(np.log(1.6))


def test_constant_radiance_in_varying_light_is_emitted(rng: np.random.Generator) -> None:
    """A panel against a wall, a textured wall and a surface in even light; few pixels say little."""
    count = 400
    light, noise = np.log(rng.uniform(1.0, 3.0, count)), 0.02 * rng.normal(size=count)
    texture = np.log(rng.uniform(0.2, 0.8, count))
    even = np.full(count, 0.7)
    radiance = np.concatenate([noise, light + noise, light + texture, even + noise])
    found = constancy(radiance, np.concatenate([light, light, light, even]), np.repeat([0, 1, 2, 3], count), 5)
    assert found[0] > 20.0 and found[1] < -20.0 and abs(found[2]) < 8.0 and abs(found[3]) < 0.5
    assert found[4] == 0.0
    few = constancy(noise[:20], light[:20], np.zeros(20, np.int64), 1)
    assert 0.0 < few[0] < 0.3 * found[0]


def test_a_lamp_much_brighter_than_white_emits(tmp_path: Path) -> None:
    view = (["..BBLL"], [[0.8, 0.8, 1.3, 1.3, 5.0, 5.0]])
    found = probability(store(tmp_path, [view] * 4))
    assert (found[[LAMP, LAMP + 1]] > 0.9).all() and (found[[WALL, BAR]] < 0.05).all()
    assert found[LAMP + 1] == found[LAMP]  # no pixel judged the other triangle of the quad
    # Fewer views and a dimmer lamp are less certain, and no step lies between.
    less = probability(store(tmp_path / "two", [view] * 2))[LAMP]
    dim = (["..BBLL"], [[0.8, 0.8, 1.3, 1.3, 3.0, 3.0]])
    assert 0.02 < less < found[LAMP] and probability(store(tmp_path / "dim", [dim] * 4))[LAMP] < found[LAMP]


def test_light_that_may_be_brighter_explains_more(tmp_path: Path) -> None:
    pixels = store(tmp_path, [(["..LL"], [[0.8, 0.8, 5.0, 5.0]])] * 4)
    found = [probability(pixels, **options)[LAMP] for options in ({}, {"unseen": 0.5}, {"hdr": False})]
    assert found[0] > 0.9 and found[0] > found[1] and found[0] > found[2]
    assert emission(pixels, told=(WALL, WALL + 1)) == [WALL, WALL + 1, LAMP, LAMP + 1]


def test_a_dim_lamp_emits_as_a_part_of_constant_radiance(tmp_path: Path) -> None:
    """As bright as the wall beside it, in light that varies by a factor of four."""
    light = np.linspace(1.0, 4.0, 60)
    dim, wall = np.full(60, 0.9), 0.5 * light
    pixels = store(tmp_path, [(["L" * 60, "." * 60], [dim, wall])] * 3)  # type: ignore[list-item]
    part = np.arange(len(ROOM.triangles)) // 2
    assert emission(pixels, diffuse=np.tile(light, 6), part=part) == [LAMP, LAMP + 1]
    # Clipped photographs are constant, too.
    assert emission(pixels, diffuse=np.tile(light, 6), part=part, hdr=False) == []


def test_stray_pixels_do_not_decide(tmp_path: Path) -> None:
    """A highlight on the wall in one view, a dark pixel on the lamp in another."""
    bright = (["...LLL"], [[0.8, 0.8, 0.8, 9.0, 9.0, 9.0]])
    views = [(["...LLL"], [[9.0, 0.8, 0.8, 9.0, 9.0, 0.1]]), *[bright] * 5]
    assert emission(store(tmp_path, views)) == [LAMP, LAMP + 1]


def test_a_bar_before_a_lamp_is_no_lamp_in_however_many_views(tmp_path: Path) -> None:
    """No pixel sees it alone. What is left when the lamp is subtracted is uncertain, however bright it is."""
    rows, grey = ["LLbLL"] * 3, [[20.0, 20.0, 19.0, 20.0, 20.0]] * 3
    assert emission(store(tmp_path, [(rows, grey)] * 6, weight=0.08)) == [LAMP, LAMP + 1]
    # Light that a lens spreads from the lamp is none of its own, even where the remainder is certain.
    rows, grey = ["LLbLL"] * 3, [[20.0, 20.0, 9.0, 20.0, 20.0]] * 3
    assert emission(store(tmp_path / "lens", [(rows, grey)] * 6, weight=0.9)) == [LAMP, LAMP + 1]


def test_light_that_spills_into_a_pure_pixel_is_no_emission(tmp_path: Path) -> None:
    """The bar is as bright as half the lamp beside it, in one column of pixels; two columns are proof."""
    near = store(tmp_path, [(["LB.."] * 2, [[20.0, 9.0, 0.8, 0.8]] * 2)] * 6)
    assert emission(near) == [LAMP, LAMP + 1]
    wide = store(tmp_path / "wide", [(["LBBB"] * 2, [[20.0, 9.0, 9.0, 9.0]] * 2)] * 6)
    assert emission(wide) == [LAMP, LAMP + 1, BAR, BAR + 1]


def test_unjudged_triangles_are_lamps_as_their_piece_is(tmp_path: Path) -> None:
    pixels = store(tmp_path, [(["LL"], [[9.0, 9.0]])] * 6)
    one = np.zeros(len(ROOM.triangles), np.int64)  # all quads are one piece
    found = probability(pixels, component=one)
    assert found == pytest.approx(found[LAMP])
    apart = probability(pixels)
    assert apart[LAMP + 1] == apart[LAMP] and not apart[[WALL, BAR]].any()


def test_a_rim_that_faces_sideways_on_a_scan_may_show_the_paper_beside_it(tmp_path: Path) -> None:
    """A rim, on which the scan lets little light fall, is as bright as the lit paper beside it."""
    light = np.array([1.0, 1.0, 0.2, 0.2, 1.0, 1.0])
    rim = store(tmp_path, [(["..LL.."], [[0.8, 0.8, 0.9, 0.9, 0.8, 0.8]])] * 6)
    assert emission(rim, diffuse=np.tile(light, 6)) == [LAMP, LAMP + 1]
    assert emission(rim, diffuse=np.tile(light, 6), reach=1) == []
