"""A room with a thing that its scan lacks, and photographs of both."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.capture.views import View
from fipt_blender.core.pixels.camera_rays import first_hits, trace_pixels
from fipt_blender.core.surface.room import Room
from samples.part_views import looking_views
from samples.scans import joined

LOW, HIGH = np.array([-0.6, -0.4, 0.3]), np.array([0.6, 0.4, 0.7])


def with_box(room: Room) -> Room:
    """A room with the thing that is lost as one more object."""
    vertices = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * (HIGH - LOW) + LOW
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    return joined(room, vertices, quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3), 1)


def photographed(folder: Path, room: Room, rng: np.random.Generator, glossy: float = 0.0) -> list[View]:
    """Views of a room with a patterned floor and walls and plain things, each with an exposure of its own.

    Args:
        glossy: how much the floor's radiance, as a logarithm, differs between views without any order.
    """
    views = looking_views(folder, room)
    for view in views:
        surface = trace_pixels(room, view)
        triangle, _ = first_hits(surface)
        position = np.array(surface.position).T
        pattern = np.sin(7.0 * position).sum(axis=1) + np.sin(3.1 * position[:, ::-1]).prod(axis=1)
        normal = np.array(surface.geometric_normal).T
        shade = 1.0 + 0.5 * normal[:, 2] + 0.2 * normal[:, 0]
        plain = room.triangle_object[triangle] == 1
        grey = np.where(plain, 3.0 * shade, np.exp(0.4 * pattern))
        grey = grey * np.exp(np.where(position[:, 2] < 0.02, glossy * rng.normal(size=len(grey)), 0.0))
        exposure = np.exp(0.3 * rng.normal(size=3))
        image = grey[:, None] * exposure * np.exp(0.02 * rng.normal(size=(len(grey), 3)))
        write_exr(view.image, image.reshape(view.height, view.width, 3).astype(np.float32))
    return views
