"""A range image: what one shot of a depth camera has measured, with its camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class RangeImage:
    """Depths of one camera."""

    # (H, W) float32 metres along the camera's axis, not along the ray; 0 where nothing was measured
    depth: np.ndarray
    # fx, fy, cx, cy: pinhole intrinsics in pixels; the centre of the first pixel is (0.5, 0.5)
    fx: float
    fy: float
    cx: float
    cy: float
    camera_to_world: np.ndarray  # (4, 4) float64, OpenCV axes
    color: np.ndarray | None = None  # (H, W, 3) float32 of the surfaces, or None
    # (H, W) float32 of the measurements, inverse to their variances; None for 1
    weight: np.ndarray | None = None

    def points(self, step: int = 1) -> tuple[np.ndarray, np.ndarray]:
        """Measured points and the directions of their rays.

        Args:
            step: every how manieth row and column counts.

        Returns:
            (N, 3) float64 world positions, and (N, 3) float64 world directions of one metre of depth.
        """
        height, width = self.depth.shape
        depth = self.depth[step // 2 :: step, step // 2 :: step].astype(np.float64)
        y, x = np.mgrid[step // 2 : height : step, step // 2 : width : step]
        known = depth > 0.0
        local = np.stack(
            [
                (x[known] + 0.5 - self.cx) / self.fx,
                (y[known] + 0.5 - self.cy) / self.fy,
                np.ones(known.sum()),
            ],
            axis=1,
        )
        direction = local @ self.camera_to_world[:3, :3].T
        return self.camera_to_world[:3, 3] + direction * depth[known][:, None], direction
