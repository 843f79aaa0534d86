"""Colours of the coverage over the room."""

from __future__ import annotations

import numpy as np
import pytest

from fipt_blender.blend.capture.survey import coverage_colors

# Linear RGB as people without one kind of cones see it (Machado, Oliveira, Fernandes 2009, severity 1).
COLOR_BLINDNESS = {
    "none": np.eye(3),
    "protanopia": [[0.1523, 1.0526, -0.2049], [0.1145, 0.7863, 0.0992], [-0.0039, -0.0481, 1.0520]],
    "deuteranopia": [[0.3673, 0.8606, -0.2280], [0.2801, 0.6725, 0.0474], [-0.0118, 0.0429, 0.9689]],
    "tritanopia": [[1.2555, -0.0767, -0.1788], [-0.0784, 0.9308, 0.1476], [0.0047, 0.6914, 0.3039]],
}


def lab(linear: np.ndarray) -> np.ndarray:
    """CIELAB of linear sRGB, (N, 3)."""
    xyz_from_rgb = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    xyz = linear @ xyz_from_rgb.T / xyz_from_rgb.sum(axis=1)
    x, y, z = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16.0 / 116.0).T
    return np.stack([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)], axis=1)


@pytest.mark.parametrize("blindness", COLOR_BLINDNESS)
def test_everyone_can_tell_the_colors_of_the_coverage_apart(blindness):
    colors = coverage_colors(np.array([0, 1, 2, 3, 5]))
    linear = np.where(colors <= 0.04045, colors / 12.92, ((colors + 0.055) / 1.055) ** 2.4)
    seen = lab((linear @ np.array(COLOR_BLINDNESS[blindness]).T).clip(0.0, 1.0))
    distance = np.linalg.norm(seen[:, None] - seen[None], axis=2) + 100.0 * np.eye(5)
    assert distance.min() > 20.0
    assert (np.diff(seen[1:, 0]) > 15.0).all()  # more views are lighter
