"""The pinhole camera of a view, independent of Blender's data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...core.run.contents import CapturedView


@dataclass(frozen=True)
class ViewGeometry:
    """A pinhole camera: camera-to-world (4,4) with OpenCV axes, intrinsics in pixels."""

    camera_to_world: np.ndarray
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    @property
    def lens(self) -> tuple[float, float, float, float]:
        """Intrinsics fx, fy, cx, cy in pixels."""
        return self.fx, self.fy, self.cx, self.cy

    def ray(self, u: float, v: float) -> tuple[np.ndarray, np.ndarray]:
        """Origin and unit direction through the pixel position (u, v)."""
        pixel = np.array([(u - self.cx) / self.fx, (v - self.cy) / self.fy, 1.0])
        direction = self.camera_to_world[:3, :3] @ pixel
        return self.camera_to_world[:3, 3], direction / np.linalg.norm(direction)


def view_geometry(view: CapturedView) -> ViewGeometry:
    """The camera of an entry of capture.json."""
    pose = np.array(view.camera_to_world)
    return ViewGeometry(pose, view.width, view.height, view.fx, view.fy, view.cx, view.cy)
