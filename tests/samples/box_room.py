"""A box room with smooth patterns on its walls, photographed by ray casting: no renderer, milliseconds."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.capture.rig import Lens
from samples.camera_poses import look_at
from samples.capture_files import Sample

LOW, HIGH = np.array([-1.2, -1.8, 0.0]), np.array([3.8, 2.2, 3.0])  # not symmetric about the origin
WIDTH, HEIGHT, FOCAL = 48, 32, 30.0
CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * (HIGH - LOW) + LOW
QUADS = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
TRIANGLES = np.array([(a, b, c) for a, b, c, d in QUADS] + [(a, c, d) for a, b, c, d in QUADS])


def make_samples(count: int = 12) -> list[Sample]:
    """Cameras on an ellipse, off the room's middle, that look across it, up and down."""
    samples, lens = [], Lens("PINHOLE", (FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2))
    for index in range(count):
        angle = 2.0 * np.pi * index / count
        place = [1.6 + 1.3 * np.cos(angle), 0.0 + 0.9 * np.sin(angle), 1.4 + 0.3 * np.sin(3.0 * angle)]
        target = [0.9 - 1.5 * np.cos(angle + 0.7), -1.2 * np.sin(angle + 0.4), 1.2 + 0.8 * np.cos(2.0 * angle)]
        samples.append(Sample(f"{index:03d}", WIDTH, HEIGHT, lens, look_at(place, target)))
    return samples


def photograph(pose: np.ndarray) -> np.ndarray:
    """(HEIGHT, WIDTH, 3) float32 from a pose (4, 4), OpenCV axes."""
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5 - WIDTH / 2, np.arange(HEIGHT) + 0.5 - HEIGHT / 2)
    rays = np.stack([x / FOCAL, y / FOCAL, np.ones_like(x)], axis=-1) @ pose[:3, :3].T
    with np.errstate(divide="ignore"):
        steps = np.maximum((LOW - pose[:3, 3]) / rays, (HIGH - pose[:3, 3]) / rays)
    points = pose[:3, 3] + rays * steps.min(axis=-1, keepdims=True)
    wall = 2 * steps.argmin(axis=-1) + (np.take_along_axis(rays, steps.argmin(axis=-1)[..., None], -1)[..., 0] > 0)
    rng = np.random.default_rng(5)
    waves, phases = rng.normal(size=(6, 4, 3)), rng.uniform(0.0, 6.3, (6, 4, 3))
    value = np.einsum("hwc,hwkc->hwk", points, 4.0 * waves[wall])[..., None] + phases[wall]
    return np.exp(0.6 * np.sin(value).sum(axis=-2) / 2.0).astype(np.float32)


def write_photographs(folder: Path, samples: list[Sample]) -> None:
    for sample in samples:
        write_exr(folder / f"{sample.stem}.exr", photograph(sample.pose))


def write_mesh(path: Path, corners: np.ndarray = CORNERS) -> None:
    rows = [f"v {x:.9f} {y:.9f} {z:.9f}\n" for x, y, z in corners]
    path.write_text("".join(rows) + "".join(f"f {' '.join(str(i + 1) for i in quad)}\n" for quad in QUADS))
