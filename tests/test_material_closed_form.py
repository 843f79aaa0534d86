# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The closed-form estimate on cells: colours, and what white surfaces reflect."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core.light.baking import ShadingStore
from fipt_blender.core.light.observations import Observations, observe
from fipt_blender.core.material.closed_form import CellEstimate, TrainingData, fit_cells, followed_by_paths, white_rows
from fipt_blender.core.material.mixture import GroupMaterials
from fipt_blender.core.material.projection import color_lines
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
