"""Camera files read and compared with the shots that they were written from."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fipt_blender.core.capture.distortion import lens_camera
from fipt_blender.core.capture.formats.registry import read_rig
from fipt_blender.core.capture.options import CaptureOptions
from fipt_blender.core.capture.rig import Rig
from samples import rig_writers as write

CENTRED = (0.0, 0.0)


def read(path: Path, **options) -> Rig:
    return read_rig(path, "auto", CaptureOptions(**options))


def room_points(shot: write.Shot) -> np.ndarray:
    """Points over the whole image of a shot, corners included, at different depths."""
    x, y = np.meshgrid(np.linspace(-0.9, 0.9, 9), np.linspace(-0.9, 0.9, 9))
    rays = np.stack([x * shot.width / 2 / shot.fx, y * shot.height / 2 / shot.fy, np.ones_like(x)], axis=-1)
    depth = np.linspace(1.0, 5.0, 81).reshape(9, 9, 1)
    return (rays * depth).reshape(-1, 3) @ shot.rotation + shot.centre


def assert_same(rig: Rig, shots: list[write.Shot], pixels: float = 1e-4) -> None:
    """The rig's views see the room's points where the shots do."""
    assert len(rig.views) == len(shots)
    for view, shot in zip(rig.views, shots, strict=True):
        assert Path(view.name).name == Path(shot.name).stem and view.image.is_file()
        assert (view.width, view.height) == (shot.width, shot.height)
        np.testing.assert_allclose(view.camera_to_world, shot.pose, atol=1e-5)
        points = room_points(shot)
        camera = lens_camera(view.lens, view.width, view.height)
        local = (points - view.camera_to_world[:3, 3]) @ view.camera_to_world[:3, :3]
        expected = np.stack([shot.pixel(point) for point in points])
        np.testing.assert_allclose(np.asarray(camera.img_from_cam(local)), expected, atol=pixels)
