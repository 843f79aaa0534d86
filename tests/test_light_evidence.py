# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What single pixels testify about emission, and where their light may be another surface's."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from fipt_blender.core.capture.views import View
from fipt_blender.core.light.baking import ShadingStore
from fipt_blender.core.light.emitter_surfaces import LEAST_RESIDUAL, LEAST_RESIDUAL_SCAN, emitter_surfaces
from fipt_blender.core.light.evidence import (
    extend_to_components,
    find_emission,
    most_nearby,
    most_reflected,
    neighbourhood_maximum,
    relative_residual,
    spill_free_fraction,
)
from fipt_blender.core.material.losses import factorised_rendering
from fipt_blender.core.material.networks import Prediction
from fipt_blender.core.scene.labels import Parts
from fipt_blender.core.scene.pixels import NO_TRIANGLE, PixelStore, open_pixels
from samples.small_rooms import make_room

# Three quads apart, two triangles each; the views below show the first of each.
WALL, LAMP, BAR = 0, 2, 4
QUAD = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
ROOM = make_room([(QUAD + [2.0 * i, 0.0, 0.0]).tolist() for i in range(3)])
OPTIONS = {".": (WALL, True), "L": (LAMP, True), "l": (LAMP, False), "B": (BAR, True), "b": (BAR, False)}


def store(
    folder: Path, pictures: list[tuple[list[str], list[list[float]]]], weight: float = 0.5
) -> PixelStore:
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


def emission(
    pixels: PixelStore,
    marked: tuple[int, ...] = (),
    constant: tuple[int, ...] = (),
    estimate: float = 0.5,
    gloss: float = 0.0,
    diffuse: np.ndarray | float = 1.0,
    reach: int = 0,
    least: float = LEAST_RESIDUAL,
) -> list[int]:
    """Triangles that emit where L_d is 1, or as given for each pixel, and L_s0 is `gloss` everywhere."""
    count, ids = len(pixels), np.arange(len(ROOM.triangles))
    surfaces = emitter_surfaces(ROOM, Parts(ids, "none"), 0.01)
    specular = np.zeros((count, 2, 2, 3), np.float16)
    specular[:, 0, 0] = gloss
    light = np.broadcast_to(np.reshape(diffuse, (-1, 1)), (count, 3)).astype(np.float16)
    shadings = ShadingStore(light, specular)
    found = find_emission(
        ROOM,
        pixels,
        shadings,
        np.isin(ids, marked),
        np.isin(ids, constant).astype(np.int8),
        lambda rows: np.full((len(rows), 3), estimate),
        replace(surfaces, reach=reach, least_residual=least),
    )
    return np.flatnonzero(found).tolist()


def test_no_material_reflects_more_than_the_bound() -> None:
    rng = np.random.default_rng(0)
    shadings = rng.random((50, 3)), rng.random((50, 4, 2, 3))
    bound = most_reflected(*shadings)
    levels = np.linspace(0.02, 1.0, 4)
    diffuse, specular = (torch.from_numpy(each) for each in shadings)
    highest = np.zeros((50, 3))
    for color in (0.0, 0.5, 1.0):
        for metallic in (0.0, 0.5, 1.0):
            for roughness in (*levels, 0.4):
                size = torch.ones(50, dtype=torch.float64)
                material = Prediction(color * size[:, None].expand(50, 3), roughness * size, metallic * size)
                made = factorised_rendering(material, diffuse, specular, torch.from_numpy(levels)).numpy()
                highest = np.maximum(highest, made)
    assert (highest <= bound + 1e-9).all()
    assert highest == pytest.approx(bound, abs=1e-9)  # and some material reaches it


def test_light_is_unexplained_channel_by_channel() -> None:
    """A red lamp under white light is as bright as a grey wall."""
    lamp, wall = np.array([[3.0, 0.1, 0.1]]), np.full((1, 3), 0.8)
    assert relative_residual(lamp, np.ones((1, 3)))[0] > 0.5
    assert relative_residual(wall, np.ones((1, 3)))[0] == 0.0
    assert relative_residual(np.zeros((1, 3)), np.zeros((1, 3)))[0] == 0.0


def test_a_dim_lamp_emits_though_the_mask_misses_it(tmp_path: Path) -> None:
    """Twice what a white surface reflects; a wall may have 1.3 times that before it counts."""
    view = (["..BBLL"], [[0.8, 0.8, 1.3, 1.3, 2.0, 2.0]])
    assert emission(store(tmp_path, [view] * 2)) == [LAMP, LAMP + 1]
    # Gloss may explain it, where the mask says nothing; and in one view it may be a highlight.
    assert emission(store(tmp_path, [view] * 2), gloss=1.8) == []
    assert emission(store(tmp_path, [view] * 2), gloss=1.8, marked=(LAMP,)) == [LAMP, LAMP + 1]
    assert emission(store(tmp_path, [view])) == []
    assert emission(store(tmp_path, [view]), marked=(LAMP,)) == [LAMP, LAMP + 1]


def test_mixed_pixels_alone_show_bright_lamps_only(tmp_path: Path) -> None:
    """At a bevel the unmixed radiance may be four times that of white; a strip of light is brighter."""
    assert emission(store(tmp_path / "bevel", [(["..bb"], [[0.8, 0.8, 4.0, 4.0]])] * 2, weight=0.9)) == []
    strip = store(tmp_path / "strip", [(["..bb"], [[0.8, 0.8, 40.0, 40.0]])] * 2, weight=0.9)
    assert emission(strip) == [BAR, BAR + 1]
    # A pure pixel needs no such radiance.
    assert emission(store(tmp_path / "pure", [(["..BB"], [[0.8, 0.8, 4.0, 4.0]])] * 2)) == [BAR, BAR + 1]


def test_shadings_of_a_scan_may_be_wrong_by_a_factor_of_two(tmp_path: Path) -> None:
    """A panel of 2.6 times a white surface emits; what 1.9 times as much light would explain does not."""
    view = (["BBBLLL"], [[1.9, 1.9, 1.9, 2.6, 2.6, 2.6]])
    pixels = store(tmp_path, [view] * 2)
    assert emission(pixels, least=LEAST_RESIDUAL_SCAN) == [LAMP, LAMP + 1]
    assert emission(pixels) == [LAMP, LAMP + 1, BAR, BAR + 1]


def test_what_the_mask_marks_emits_where_the_estimate_falls_short(tmp_path: Path) -> None:
    pixels = store(tmp_path, [(["..LL"], [[0.8, 0.8, 0.9, 0.9]])])
    assert emission(pixels, marked=(WALL, LAMP), estimate=0.5) == [0, 1, 2, 3]
    assert emission(pixels, marked=(WALL, LAMP), estimate=0.6) == [LAMP, LAMP + 1]
    assert emission(pixels, marked=(WALL, LAMP), estimate=0.7) == []
    assert emission(pixels, constant=(LAMP, LAMP + 1)) == [LAMP, LAMP + 1]


def test_stray_pixels_do_not_decide(tmp_path: Path) -> None:
    """A highlight on the wall in one view, a dark pixel on the lamp in another."""
    views = [(["...LLL"], [[9.0, 0.8, 0.8, 5.0, 5.0, 0.1]]), (["...LLL"], [[0.8, 0.8, 0.8, 5.0, 5.0, 5.0]])]
    assert emission(store(tmp_path, views)) == [LAMP, LAMP + 1]


def test_a_bar_before_a_lamp_is_no_lamp_in_however_many_views(tmp_path: Path) -> None:
    """No pixel sees it alone. What is left when the lamp is subtracted is uncertain, however bright it is."""
    rows, grey = ["LLbLL"] * 3, [[20.0, 20.0, 19.0, 20.0, 20.0]] * 3
    assert emission(store(tmp_path, [(rows, grey)] * 4, weight=0.08)) == [LAMP, LAMP + 1]
    # Where it crosses a narrower lamp it may even be the brightest around; or the sky is behind it.
    for row in ("LLbLL", "  b  "):
        rows, grey = [row] * 3, [[15.0, 15.0, 19.0, 15.0, 15.0]] * 3
        lamp = [LAMP, LAMP + 1] if "L" in row else []
        assert emission(store(tmp_path, [(rows, grey)] * 4, weight=0.08), marked=(BAR,)) == lamp
    # Light that a lens spreads from the lamp is none of its own, even where the remainder is certain.
    rows, grey = ["LLbLL"] * 3, [[20.0, 20.0, 9.0, 20.0, 20.0]] * 3
    assert emission(store(tmp_path, [(rows, grey)] * 4, weight=0.9)) == [LAMP, LAMP + 1]


def test_light_that_spills_into_a_pure_pixel_is_no_emission(tmp_path: Path) -> None:
    """The bar is as bright as half the lamp beside it, in one column of pixels; two columns are proof."""
    near = store(tmp_path, [(["LB.."] * 2, [[20.0, 9.0, 0.8, 0.8]] * 2)] * 2)
    assert emission(near, marked=(BAR,)) == [LAMP, LAMP + 1]
    wide = store(tmp_path, [(["LBBB"] * 2, [[20.0, 9.0, 9.0, 9.0]] * 2)] * 2)
    assert emission(wide) == [LAMP, LAMP + 1, BAR, BAR + 1]


def test_a_bulb_that_no_pixel_sees_alone_is_found(tmp_path: Path) -> None:
    """The wall beside it, of which other pixels know more, is none."""
    rows = ["....", ".b..", "...."]
    grey = [[0.8, 0.8, 0.8, 0.8], [3.0, 40.0, 12.0, 0.8], [0.8, 5.0, 0.8, 0.8]]
    assert emission(store(tmp_path, [(rows, grey)] * 2)) == [BAR, BAR + 1]
    # In one view it may be a highlight, whatever the mask says.
    assert emission(store(tmp_path, [(rows, grey)]), marked=(BAR,)) == []
    # Where a pixel of the wall is brighter, the bulb's own says nothing.
    grey[1][2] = 60.0
    assert emission(store(tmp_path, [(rows, grey)] * 2)) == []


def test_the_share_that_is_a_pixels_own() -> None:
    light = np.array([1.0, 1.0, 1.0, 0.0])
    assert spill_free_fraction(light, np.array([1.0, 1.5, 3.0, 2.0])).tolist() == [1.0, 0.5, 0.0, 0.0]


def test_the_brightest_of_nine() -> None:
    rng = np.random.default_rng(0)
    light = rng.random((7, 9))
    found = neighbourhood_maximum(light.reshape(-1), (7, 9)).reshape(7, 9)
    for row, column in ((0, 0), (3, 4), (6, 8), (0, 5)):
        around = light[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2]
        assert found[row, column] == around.max()


def test_unjudged_triangles_join_a_piece_that_mostly_emits() -> None:
    areas, piece = np.array([1.0, 1.0, 2.0, 1.0, 1.0]), np.array([0, 0, 0, 1, 1])
    emits, judged = np.array([[1, 0, 0, 0, 0], [1, 1, 0, 1, 0]], bool)
    assert extend_to_components(areas, piece, emits, judged).tolist() == [True, False, False, False, False]
    judged[1] = False
    assert extend_to_components(areas, piece, emits, judged).tolist() == [True, True, True, False, False]
    judged[2] = True  # a dark side of twice the area
    assert extend_to_components(areas, piece, emits, judged).tolist() == [True, False, False, False, False]


def test_a_rim_that_faces_sideways_on_a_scan_may_show_the_paper_beside_it(tmp_path: Path) -> None:
    """A rim, on which the scan lets little light fall, is as bright as the lit paper beside it."""
    light = np.array([1.0, 1.0, 0.2, 0.2, 1.0, 1.0])
    rim = store(tmp_path, [(["..LL.."], [[0.8, 0.8, 0.9, 0.9, 0.8, 0.8]])] * 2)
    assert emission(rim, diffuse=np.tile(light, 2)) == [LAMP, LAMP + 1]
    assert emission(rim, diffuse=np.tile(light, 2), reach=1) == []
    lamp = store(tmp_path, [(["..LL.."], [[0.8, 0.8, 4.0, 4.0, 0.8, 0.8]])] * 2)
    assert emission(lamp, diffuse=np.tile(light, 2), reach=1) == [LAMP, LAMP + 1]


def test_light_beside_is_that_of_the_mesh_in_each_channel() -> None:
    reflected = np.array([[1.0, 5.0, 0.0], [2.0, 1.0, 0.0], [9.0, 9.0, 9.0], [0.0, 0.0, 0.0]])
    hit = np.array([True, True, False, True])
    expected = [[2.0, 5.0, 0.0], [2.0, 5.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 0.0]]
    assert most_nearby(reflected, hit, (1, 4), 1).tolist() == expected
