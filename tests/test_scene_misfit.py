"""The misfit of a mesh and a photograph in pixels, by cameras that are off by known amounts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core.alignment.turns import turn_by
from fipt_blender.core.capture.views import View
from fipt_blender.core.checks.misfit import edge_flow, edge_image, image_misfit, view_edges
from fipt_blender.core.pixels.camera_rays import trace_pixels
from fipt_blender.core.surface.room import Room
from samples.camera_poses import look_at
from samples.small_rooms import BOX, block, make_room

WIDTH, HEIGHT, FINER = 320, 240, 4


@pytest.fixture(scope="module")
def room() -> Room:
    """A box with a table, a cupboard and a shelf."""
    parts = [((-1.8, 0.5, 0.0), (-1.0, 1.9, 1.4)), ((0.2, 0.2, 0.0), (1.2, 0.9, 0.7))]
    parts += [((0.5, 1.6, 1.5), (1.8, 2.0, 1.7))]
    return make_room([*BOX, *(quad for part in parts for quad in block(*part)[1:])])


@pytest.fixture(scope="module")
def views() -> list[View]:
    poses = [look_at([0.2, -1.6, 1.6], [0.0, 1.5, 0.9]), look_at([1.5, -1.4, 1.9], [-0.8, 1.6, 0.7])]
    lens = {"width": WIDTH, "height": HEIGHT, "fx": 210.0, "fy": 212.0, "cx": 163.0, "cy": 118.0}
    none = dict.fromkeys(("parts", "semantics", "mask"))
    return [View(str(i), "train", Path("a.exr"), camera_to_world=pose, **lens, **none) for i, pose in enumerate(poses)]


def photograph(room: Room, view: View, seed: int) -> np.ndarray:
    """Faces of different radiance with a soft gradient, averaged over subpixels, with noise."""
    rng = np.random.default_rng(seed)
    lens = {name: FINER * getattr(view, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
    surface = trace_pixels(room, replace(view, **lens))
    face, position = np.array(surface.triangle) // 2, np.array(surface.position).T
    radiance = rng.lognormal(0.0, 0.5, 32)[face] * np.exp(0.15 * position @ [1.0, -0.5, 0.8])
    gray = radiance.reshape(HEIGHT, FINER, WIDTH, FINER).mean(axis=(1, 3))
    return (gray * (1.0 + 0.02 * rng.normal(size=gray.shape)))[..., None].repeat(3, axis=2)


@pytest.fixture(scope="module")
def images(room: Room, views: list[View]) -> list[np.ndarray]:
    return [photograph(room, view, index) for index, view in enumerate(views)]


def displaced(room: Room, view: View, pixels: float, seed: int) -> View:
    """The view with its camera off so that the mesh's edges move by so many pixels on average."""
    rng = np.random.default_rng(seed)
    motion = np.concatenate([rng.normal(size=3), 2.0 * rng.normal(size=3)])
    moved = edge_flow(view_edges(room, view), view.intrinsics) @ motion
    motion *= pixels / np.sqrt((moved**2).sum(axis=1).mean())
    step = np.eye(4)
    step[:3, :3], step[:3, 3] = turn_by(motion[:3]), motion[3:]
    return replace(view, camera_to_world=view.camera_to_world @ step)


@pytest.mark.parametrize("pixels", [0.5, 3.0])
def test_known_displacements_are_found_within_a_third(
    room: Room, views: list[View], images: list[np.ndarray], pixels: float
) -> None:
    for index, (view, image) in enumerate(zip(views, images, strict=True)):
        off = displaced(room, view, pixels, index + 5)
        found = image_misfit(room, off, edge_image(off, image))
        assert found is not None and found[1] == 1
        assert found[0] == pytest.approx(pixels, rel=1.0 / 3.0)
        right = image_misfit(room, view, edge_image(view, image))
        assert right is not None and right[0] < 0.2


def test_without_edges_there_is_no_verdict(room: Room, views: list[View]) -> None:
    rng = np.random.default_rng(0)
    assert image_misfit(room, views[0], edge_image(views[0], np.zeros((HEIGHT, WIDTH, 3)))) is None
    wall = replace(views[0], camera_to_world=look_at([1.0, -1.0, 1.5], [2.0, -1.0, 1.5]))
    plain = edge_image(wall, 1.0 + 0.02 * rng.random((HEIGHT, WIDTH, 3)))
    assert image_misfit(room, wall, plain) is None
    away = replace(views[0], camera_to_world=look_at([0.0, -9.0, 1.5], [0.0, -20.0, 1.5]))
    assert image_misfit(room, away, plain) is None


def test_large_photographs_are_compared_smaller_in_their_own_pixels(
    room: Room, views: list[View], images: list[np.ndarray]
) -> None:
    view = displaced(room, views[0], 2.0, 3)
    image = images[0].repeat(6, axis=0).repeat(6, axis=1)
    large = replace(view, **{name: 6 * getattr(view, name) for name in ("width", "height", "fx", "fy", "cx", "cy")})
    found = image_misfit(room, large, edge_image(large, image))
    assert found is not None and found[1] == 2
    assert found[0] * found[1] == pytest.approx(12.0, rel=1.0 / 3.0)
