# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Composites into photographs, as arrays: what stays, shadows, light, and half covered or noisy pixels."""

from __future__ import annotations

import numpy as np

from fipt_blender.blend.pictures import composite


def layers(shape=(6, 8), alpha=0.0):
    rng = np.random.default_rng(1)
    photo, empty = rng.random((2, *shape, 3)).astype(np.float32) + 0.1
    return composite.Layers(photo, empty.copy(), empty, np.full((*shape, 4), alpha, np.float32))


def test_without_any_change_the_composite_is_the_photograph():
    image = layers()
    np.testing.assert_array_equal(composite.compose(image), image.photograph)


def test_with_a_perfect_estimate_the_composite_is_the_render():
    image = layers()
    smooth = np.linspace(0.5, 1.5, 8)[None, :, None] * image.empty  # shading on a texture
    perfect = composite.Layers(image.empty, smooth.astype(np.float32), image.empty, image.added)
    np.testing.assert_allclose(composite.compose(perfect), smooth, rtol=0.02)


def test_shadows_multiply_light_is_added_and_objects_cover():
    grey = np.full((5, 5, 3), 0.4, np.float32)
    nothing = np.zeros((5, 5, 4), np.float32)
    shadow = composite.compose(composite.Layers(0.5 * grey, 0.25 * grey, grey, nothing))
    np.testing.assert_allclose(shadow, 0.125 * grey, rtol=1e-5)  # never below zero
    light = composite.compose(composite.Layers(0.5 * grey, 1.5 * grey, grey, nothing))
    np.testing.assert_allclose(light, grey, rtol=1e-5)
    object_ = np.concatenate([3.0 * grey, np.ones((5, 5, 1), np.float32)], axis=-1)
    cover = composite.compose(composite.Layers(grey, 3.0 * grey, grey, object_))
    np.testing.assert_allclose(cover, 3.0 * grey, rtol=1e-5)


def test_half_covered_pixels_mix_object_and_photograph():
    photo, empty = np.full((3, 3, 3), 0.2, np.float32), np.full((3, 3, 3), 0.6, np.float32)
    half = np.full((3, 3, 4), 0.5, np.float32)  # colour 1, half coverage
    full = 0.5 + 0.5 * empty
    np.testing.assert_allclose(composite.compose(composite.Layers(photo, full, empty, half)), 0.6, atol=1e-5)


def test_noisy_pixels_and_invisible_changes_leave_the_photograph():
    image = layers((9, 9))
    full = image.empty.copy()
    full[4, 4] += 50.0
    full[1, 1] *= 1.002
    noisy = composite.Layers(image.photograph, full, image.empty, image.added)
    np.testing.assert_array_equal(composite.compose(noisy), image.photograph)
