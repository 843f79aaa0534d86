"""Folders of RGB-D frames of a wall, as tsdf-fusion and ScanNet's exporter lay them out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from samples.camera_poses import look_at

WALL = 2.0  # metres in front of the cameras
# Lowest and highest corners in metres: a room, and furniture such that no turn maps it to itself.
BOX_ROOM = (
    ((0.0, 0.0, 0.0), (5.0, 4.0, 2.6)),
    ((0.0, 0.0, 0.0), (0.6, 2.2, 1.9)),
    ((2.0, 0.4, 0.65), (3.6, 1.1, 0.75)),
    ((4.2, 2.6, 0.0), (5.0, 4.0, 0.8)),
    ((1.4, 3.4, 0.9), (2.3, 4.0, 1.3)),
)


def frame_pose(index: int) -> np.ndarray:
    """Camera to world of a frame: the cameras stand side by side and look along Z."""
    matrix = np.eye(4)
    matrix[0, 3] = 0.1 * index
    return matrix


def write_depth(path: Path, size: tuple[int, int], depth: float = WALL) -> None:
    """A depth image in millimetres; eight rows at the top have no measurement, by either code."""
    values = np.full((size[1], size[0]), round(depth * 1000.0), np.uint16)
    values[:4] = 0
    values[4:8] = 65535
    Image.fromarray(values).save(path)


def write_color(path: Path, size: tuple[int, int]) -> None:
    noise = np.random.default_rng(0).integers(60, 180, (size[1], size[0], 3), np.uint8)
    Image.fromarray(noise).save(path)


def write_frames(folder: Path, count: int, size: tuple[int, int], focal: float) -> Path:
    """The layout of tsdf-fusion; the photographs have twice the resolution of the depth images."""
    folder.mkdir(parents=True, exist_ok=True)
    camera = np.array([[focal, 0.0, size[0] / 2], [0.0, focal, size[1] / 2], [0.0, 0.0, 1.0]])
    np.savetxt(folder / "camera-intrinsics.txt", camera, "%.9f")
    for index in range(count):
        stem = f"frame-{index:06d}"
        write_depth(folder / f"{stem}.depth.png", size)
        write_color(folder / f"{stem}.color.png", (2 * size[0], 2 * size[1]))
        np.savetxt(folder / f"{stem}.pose.txt", frame_pose(index), "%.9f")
    return folder


def write_exported_scan(folder: Path, size: tuple[int, int], focal: float) -> Path:
    """The layout of ScanNet's exporter; frame 10 follows 9 although its name sorts before."""
    for name in ("color", "depth", "pose", "intrinsic"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    for kind, length in (("depth", focal), ("color", 2.5 * focal)):
        matrix = np.diag([length, length, 1.0, 1.0])
        matrix[:2, 2] = 30.0, 20.0
        np.savetxt(folder / "intrinsic" / f"intrinsic_{kind}.txt", matrix, "%.9f")
    for index in (9, 10):
        write_depth(folder / "depth" / f"{index}.png", size)
        write_color(folder / "color" / f"{index}.jpg", (160, 120))
        np.savetxt(folder / "pose" / f"{index}.txt", frame_pose(index), "%.9f")
    return folder


def box_room_depth(
    pose: np.ndarray, size: tuple[int, int], focal: float, middle: tuple[float, float] | None = None
) -> np.ndarray:
    """Depths (H, W) in metres that a camera in `BOX_ROOM` measures along its axis."""
    y, x = np.mgrid[: size[1], : size[0]] + 0.5
    cx, cy = middle or (size[0] / 2, size[1] / 2)
    local = np.stack([(x - cx) / focal, (y - cy) / focal, np.ones_like(x)], axis=-1)
    direction = local @ pose[:3, :3].T
    first, *furniture = BOX_ROOM
    with np.errstate(divide="ignore"):
        depth = _slabs(first, pose[:3, 3], direction)[1]
        for box in furniture:
            near, far = _slabs(box, pose[:3, 3], direction)
            depth = np.where((near < far) & (near > 0.0), np.minimum(depth, near), depth)
    return np.asarray(depth)


def _slabs(box: tuple, origin: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where rays enter and leave a box."""
    ends = (np.array(box)[:, None, None] - origin) / direction
    return ends.min(axis=0).max(axis=-1), ends.max(axis=0).min(axis=-1)


def box_room_pose(index: int, count: int) -> np.ndarray:
    """Camera to world (4, 4): one of a circle in the middle of `BOX_ROOM`. Z is up."""
    angle = 2.0 * np.pi * index / count
    place = np.array([2.6 + 0.4 * np.cos(angle), 2.4 + 0.2 * np.sin(angle), 1.5])
    return look_at(place, place + [np.cos(angle), np.sin(angle), -0.35])


def write_box_room(folder: Path, count: int, size: tuple[int, int], focal: float) -> list[np.ndarray]:
    """Frames from the middle of `BOX_ROOM` in all directions; returns their poses."""
    write_frames(folder, count, size, focal)
    rng, poses = np.random.default_rng(0), []
    for index in range(count):
        pose = box_room_pose(index, count)
        stem = folder / f"frame-{index:06d}"
        depth = box_room_depth(pose, size, focal) + 0.003 * rng.normal(size=size[::-1])
        Image.fromarray(np.round(1000.0 * depth).astype(np.uint16)).save(f"{stem}.depth.png")
        np.savetxt(f"{stem}.pose.txt", pose, "%.9f")
        poses.append(pose)
    return poses
