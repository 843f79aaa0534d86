# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The closed-form estimate on cells: colours, what white surfaces reflect, and groups in place of parts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core.light.baking import ShadingStore, open_shadings
from fipt_blender.core.light.observations import Observations, observe
from fipt_blender.core.material import training_input as training_input_module
from fipt_blender.core.material.closed_form import CellEstimate, TrainingData, fit_cells, followed_by_paths, white_rows
from fipt_blender.core.material.groups import (
    NO_GROUP,
    color_class,
    material_groups,
    part_units,
    piece_units,
    similarity,
)
from fipt_blender.core.material.mixture import GroupMaterials
from fipt_blender.core.material.projection import color_lines
from fipt_blender.core.material.training_input import training_input
from fipt_blender.core.parts.labels import NO_PART, Parts
from samples.panel_pixels import IS_PANEL, PARTS, ROOM, SETTINGS, make_pixels

LEVELS = np.array([0.1, 0.5, 1.0], np.float32)
WALLS = 6  # parts of the box; the panel is the seventh
COLORS = np.random.default_rng(1).uniform(0.1, 0.9, (WALLS + 1, 3))
METAL = 2  # the part that is a metal


@pytest.fixture
def seen(tmp_path: Path) -> Observations:
    return observe(ROOM, make_pixels(tmp_path / "pixels", 6), PARTS, SETTINGS, tmp_path)


@pytest.fixture
def data(seen: Observations) -> TrainingData:
    """Pixels whose radiance is Eq. 5 of parts of one colour, one of them metallic; the panel is a lamp."""
    pixels, rng = seen.pixels, np.random.default_rng(0)
    part = np.asarray(seen.part)
    metallic = (np.arange(WALLS + 1) == METAL).astype(np.float32)
    roughness = np.linspace(0.1, 1.0, WALLS + 1).astype(np.float32)
    roughness = LEVELS[np.abs(LEVELS - roughness[:, None]).argmin(axis=1)]
    diffuse = rng.uniform(0.5, 1.5, (len(pixels), 3))
    specular = rng.uniform(0.1, 0.5, (len(pixels), 3, 2, 3))
    s0, s1 = np.moveaxis(specular[np.arange(len(part)), np.searchsorted(LEVELS, roughness)[part]], 1, 0)
    color, metal = COLORS[part], metallic[part][:, None]
    kd, ks = color * (1.0 - metal), 0.04 * (1.0 - metal) + color * metal
    radiance = kd * diffuse + ks * s0 + s1
    radiance[IS_PANEL[pixels.triangle]] = 50.0
    pixels.own[:], pixels.weight[:] = radiance, np.where(pixels.pure, 1.0, 0.25)
    materials = GroupMaterials(np.column_stack([roughness, metallic]), np.zeros((len(roughness), 2)))
    return TrainingData(seen, ShadingStore(diffuse, specular), LEVELS, part, materials)


def reflecting(seen: Observations) -> np.ndarray:
    """Pixels of the walls."""
    rows = np.flatnonzero(np.asarray(seen.pixels.triangle) >= 0)
    return rows[~IS_PANEL[seen.pixels.triangle[rows]]]


def test_cells_have_the_colours_of_their_parts(seen, data) -> None:
    cells = fit_cells(data)
    group = cells.group
    walls = group < WALLS
    np.testing.assert_allclose(cells.color[walls], COLORS[group[walls]], atol=2e-3)
    assert (cells.color[~walls] == 1.0).all()
    np.testing.assert_array_equal(ROOM.triangle_object[cells.triangle], group)
    rows = reflecting(seen)
    found = cells.of_pixels(data, rows)
    assert (found >= 0).all() and (cells.entry[found] == seen.entry[rows]).all()


def test_pixels_without_a_group_are_diffuse(seen, data) -> None:
    specular = data.shadings.specular[:, -1]
    seen.pixels.own[:] = 0.5 * data.shadings.diffuse + 0.04 * specular[:, 0] + specular[:, 1]
    none, group = np.zeros((0, 2)), np.full(len(seen.pixels), -1)
    cells = fit_cells(replace(data, group=group, materials=GroupMaterials(none, none)))
    np.testing.assert_array_equal(cells.entry, np.unique(seen.entry[np.asarray(seen.donor) >= 0]))
    np.testing.assert_allclose(cells.values, [[0.5, 0.5, 0.5, 1.0, 0.0]] * len(cells.keys), atol=2e-3)


def test_a_white_surface_reflects_the_most(seen, data) -> None:
    """With the gloss of the group, dielectric or metal, and never less than a diffuse one."""
    rows = reflecting(seen)
    white, diffuse = white_rows(data, rows), np.asarray(data.shadings.diffuse[rows], np.float32)
    assert (white >= np.maximum(seen.pixels.own[rows], diffuse) * 0.99).all()
    slope, offset = color_lines(data.shadings, LEVELS, rows, data.materials.of_pixels[data.group[rows]])
    np.testing.assert_allclose(white, np.maximum(slope, diffuse) + offset, rtol=1e-5)


def test_values_of_an_entry_are_means_over_its_pixels() -> None:
    """Entry 3 has a pixel of no group and three of group 1, entry 5 one of group 0."""
    cells = CellEstimate(
        keys=np.array([9, 11, 16]),
        color=np.array([[0.2] * 3, [0.6] * 3, [0.9] * 3], np.float32),
        pixels=np.array([1.0, 3.0, 1.0]),
        triangle=np.array([7, 8, 9]),
        materials=np.array([[0.4, 1.0], [0.8, 0.0], [1.0, 0.0]]),
    )
    entries, values, triangle = cells.by_entry()
    assert entries.tolist() == [3, 5] and triangle.tolist() == [8, 9]
    np.testing.assert_allclose(values, [[0.5, 0.5, 0.5, 0.85, 0.0], [0.9, 0.9, 0.9, 0.4, 1.0]], rtol=1e-6)


def test_paths_follow_groups_that_may_be_smooth() -> None:
    none = np.zeros(0)
    roughness = np.array([0.86, 0.86, 0.4, 1.0])  # the last is of pixels without a group
    materials = np.column_stack([roughness, np.zeros(4)])
    cells = CellEstimate(none, np.zeros((0, 3)), none, none, materials)
    errors = np.array([0.3, 0.2, 0.3])
    followed = followed_by_paths(cells, errors, limit=0.6).materials[:, 0]
    assert 0.5 < followed[0] < np.float16(0.6)  # tables may be of half precision
    np.testing.assert_array_equal(followed[1:], roughness[1:])


def columns(*rows: tuple[int, int, int, int]) -> list[np.ndarray]:
    """Label, piece, colour and weight 1 of the pixels of (label, piece, colour, count) rows."""
    counts = [row[3] for row in rows]
    return [np.repeat(column, counts) for column in ([row[i] for row in rows] for i in range(3))] + [
        np.ones(sum(counts), int)
    ]


def test_the_finest_group_that_is_large_enough_counts():
    # Two colours of one piece; a piece whose colours have few pixels; small pieces of one class and colour.
    rows = [(0, 0, 7, 50), (0, 0, 8, 50), (1, 1, 7, 20), (1, 1, 8, 25), *((2, 10 + i, 9, 5) for i in range(8))]
    group = material_groups(*columns(*rows), least=40)
    assert (group >= 0).all() and len(np.unique(group)) == 4
    assert len(np.unique(group[:50])) == 1 and group[0] != group[60]
    assert len(np.unique(group[100:145])) == 1 and len(np.unique(group[145:])) == 1


def test_pixels_in_no_large_combination_have_no_group(rng):
    label, piece, color, one = columns((0, 0, 1, 100), (3, 5, 6, 9))
    order = rng.permutation(109)
    group = material_groups(label[order], piece[order], color[order], one, least=10)
    assert (group[label[order] == 3] == NO_GROUP).all() and (group[label[order] == 0] == 0).all()


def test_kinds_of_pixels_are_weighted_by_their_number():
    rows = [(0, 0, 7, 50), (0, 0, 8, 30), (1, 1, 7, 20), (1, 2, 7, 25)]
    each = material_groups(*columns(*rows), least=40)
    kinds = material_groups(*(np.array(column) for column in zip(*rows, strict=True)), least=40)
    assert np.array_equal(each, kinds.repeat([row[3] for row in rows]))


def test_classes_of_one_colour_never_share_a_group():
    group = material_groups(*columns((0, 0, 1, 30), (1, 0, 1, 30)), least=10)
    assert group[0] != group[-1]


def test_color_classes_separate_hue_and_brightness_and_tolerate_noise(rng):
    base = np.array([[0.6, 0.6, 0.6], [0.15, 0.15, 0.15], [0.6, 0.15, 0.08], [0.08, 0.15, 0.6]])
    classes = color_class(base)
    assert len(np.unique(classes)) == 4
    noisy = base.repeat(100, axis=0) * rng.normal(1.0, 0.01, (400, 1))
    assert (color_class(noisy) == classes.repeat(100)).mean() > 0.95
    # A black surface has one class, whatever the chroma of its noise.
    assert len(np.unique(color_class(rng.uniform(0.0, 0.004, (100, 3))))) == 1


def test_similar_groups_are_of_one_class_and_similar_colour():
    color = np.array([[0.85] * 3, [0.9] * 3, [0.6] * 3, [0.85, 0.6, 0.5], [0.85] * 3, [0.01] * 3, [0.0] * 3])
    likeness = similarity(np.array([0, 0, 0, 0, 1, 0, 0]), color)
    np.testing.assert_array_equal(likeness, likeness.T)
    assert (np.diag(likeness) == 1.0).all()
    assert likeness[0, 1] > 0.8 and likeness[5, 6] > 0.1  # noise of bright and of dark colours
    assert (likeness[0, 2:] < 0.1).all()


def test_surfaces_of_one_material_are_units_and_others_belong_to_their_class():
    # Piece 0: two groups of one roughness; 1: a triangle that is half matt, half glossy; 2: hardly any pixel
    # has a group; 3: a tenth are outliers; 4: unseen.
    piece = np.array([0, 0, 1, 2, 3, 4, 1])
    parts = Parts(np.array([0, 0, 0, 1, 1, 1, NO_PART], np.int32), "semantic")
    triangle, group = np.array([0, 1, 2, 2, 3, 3, 4, 4]), np.array([0, 1, 0, 2, NO_GROUP, 0, 2, 0])
    pixels = np.array([50, 50, 50, 50, 90, 10, 95, 5])
    materials = np.array([[0.4, 0.0], [0.45, 0.0], [1.0, 0.0], [1.0, 0.0]])
    units = piece_units(parts, piece, triangle, group, pixels, materials)
    assert units.triangle.tolist() == [2, 2, 0, 1, 3, 1, NO_PART]
    assert units.single.tolist() == [False, False, True, True]
    assert units.is_single(np.array([3, 0, NO_PART])).tolist() == [True, False, False]
    # One triangle of piece 0 is metal: both are units, if a tenth of the piece's pixels see it.
    materials = np.array([[0.4, 0.0], [0.4, 1.0], [1.0, 0.0], [1.0, 0.0]])
    metal = piece_units(parts, piece, triangle, group, pixels, materials)
    assert metal.triangle.tolist() == [2, 4, 0, 1, 3, 1, NO_PART]
    assert metal.single.tolist() == [False, False, True, True, True]
    undivided = piece_units(parts, piece, triangle, group, pixels, materials, divided=False)
    assert undivided.triangle[:2].tolist() == [0, 0] and undivided.single.tolist() == [False, False, True]
    pixels[:2] = 95, 5
    few = piece_units(parts, piece, triangle, group, pixels, materials)
    assert few.triangle[:2].tolist() == [2, 2] and few.single[2]  # an outlier
    assert part_units(parts).single.all()


def test_pixels_outside_the_sample_have_their_own_colour(tmp_path, monkeypatch: pytest.MonkeyPatch):
    """Each surface of the box has one colour, so groups are surfaces, however small the sample is."""
    monkeypatch.setattr(training_input_module, "PROJECTION_PIXELS", 300)
    pixels = make_pixels(tmp_path / "pixels", 6)
    nothing = Parts(np.full(len(ROOM.triangles), NO_PART, np.int32), "none")
    seen = observe(ROOM, pixels, nothing, SETTINGS, tmp_path / "observed")
    shadings = open_shadings(tmp_path / "shadings", len(pixels), 3, create=True)
    shadings.diffuse[:] = 2.0
    levels, pieces = np.array([0.1, 0.5, 1.0], np.float32), ROOM.triangle_object
    data = training_input(seen, pieces, shadings, levels, SETTINGS)
    known = np.asarray(data.group) >= 0
    surface = pieces[pixels.triangle[known]]
    assert known.sum() > 0.9 * len(seen.pool)
    assert (np.bincount(np.unique(np.stack([surface, data.group[known]]), axis=1)[0]) <= 1).all()
