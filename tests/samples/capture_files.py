"""Small captures in every format, written from the same cameras of known poses."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap

from fipt_blender.core import conventions
from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.capture.rig import Lens
from samples.camera_poses import look_at


@dataclass
class Sample:
    """One photograph: lens and pose (OpenCV axes, source world)."""

    stem: str
    width: int
    height: int
    lens: Lens
    pose: np.ndarray


def level_pose(rng: np.random.Generator, up: np.ndarray) -> np.ndarray:
    """A camera held roughly level at a random place in a room."""
    forward = rng.normal(size=3)
    place = rng.uniform(-2.0, 2.0, 3)
    return look_at(place, place + forward - 0.8 * (forward @ up) * up, up)


def make_samples(count: int, up=(0.0, 0.0, 1.0), model: str = "PINHOLE") -> list[Sample]:
    """Landscape and portrait in turn, fx != fy, off-centre; distorted with OPENCV."""
    rng = np.random.default_rng(7)
    distortion = {"PINHOLE": (), "OPENCV": (-0.12, 0.02, 0.002, -0.001)}[model]
    samples = []
    for index in range(count):
        width, height = (48, 32) if index % 2 == 0 else (32, 48)
        parameters = (40.0 + index % 2, 44.0, 0.5 * width + 2.5, 0.5 * height - 1.5, *distortion)
        pose = level_pose(rng, np.array(up))
        samples.append(Sample(f"{index:03d}_0001", width, height, Lens(model, parameters), pose))
    return samples


def radiance(index: int, width: int, height: int) -> np.ndarray:
    return np.random.default_rng(index).lognormal(0.0, 1.0, (height, width, 3)).astype(np.float32)


def write_images(folder: Path, samples: list[Sample]) -> None:
    for index, sample in enumerate(samples):
        write_exr(folder / f"{sample.stem}.exr", radiance(index, sample.width, sample.height), half=True)


def write_mesh(path: Path) -> None:
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")


def write_colmap(root: Path, samples: list[Sample], text: bool) -> None:
    """sparse/0 and images/; the model names .jpg files, as if solved on tone-mapped copies."""
    model = pycolmap.Reconstruction()
    for index, sample in enumerate(samples, start=1):
        camera = pycolmap.Camera(
            model=sample.lens.model,
            width=sample.width,
            height=sample.height,
            params=np.array(sample.lens.parameters),
            camera_id=index,
        )
        model.add_camera_with_trivial_rig(camera)
        world_to_camera = np.linalg.inv(sample.pose)
        image = pycolmap.Image(name=f"{sample.stem}.jpg", camera_id=index, image_id=index)
        rotation = pycolmap.Rotation3d(np.ascontiguousarray(world_to_camera[:3, :3]))
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(rotation, world_to_camera[:3, 3]))
    folder = root / "sparse" / "0"
    folder.mkdir(parents=True)
    (model.write_text if text else model.write_binary)(str(folder))
    write_images(root / "images", samples)


def write_transforms(root: Path, samples: list[Sample], **extra) -> None:
    """transforms.json with intrinsics in every frame."""
    frames = []
    for sample in samples:
        names = ("fl_x", "fl_y", "cx", "cy", "k1", "k2", "p1", "p2")
        frames.append(
            {
                "file_path": f"images/{sample.stem}.exr",
                "transform_matrix": conventions.opencv_to_opengl_camera(sample.pose).tolist(),
                "w": sample.width,
                "h": sample.height,
                **dict(zip(names, sample.lens.parameters, strict=False)),
            }
        )
    root.mkdir(parents=True, exist_ok=True)
    (root / "transforms.json").write_text(json.dumps({**extra, "frames": frames}))
    write_images(root / "images", samples)


def write_fipt_real(root: Path, samples: list[Sample]) -> None:
    """cam.txt and K_list.txt."""
    cameras, matrices = [str(len(samples))], [str(len(samples))]
    for sample in samples:
        origin, forward, up = sample.pose[:3, 3], sample.pose[:3, 2], -sample.pose[:3, 1]
        cameras += [" ".join(f"{value:.9f}" for value in row) for row in (origin, origin + 2.0 * forward, up)]
        fx, fy, cx, cy = sample.lens.parameters
        matrices += [f"{fx} 0 {cx}", f"0 {fy} {cy}", "0 0 1"]
    root.mkdir(parents=True, exist_ok=True)
    (root / "cam.txt").write_text("\n".join(cameras))
    (root / "K_list.txt").write_text("\n".join(matrices))
    write_images(root / "Image", samples)


def write_fipt_synthetic(root: Path, splits: dict[str, list[np.ndarray]], named: bool = True) -> None:
    """train and val with one field of view, id images, and images by name or only by number."""
    width, height = 24, 16
    for split, poses in splits.items():
        frames = []
        for index, pose in enumerate(poses):
            frames.append({"transform_matrix": conventions.fipt_to_opencv_camera(pose).tolist()})
            if named:
                frames[-1]["file_path"] = f"Image/{index:03d}_0001.exr"
            write_exr(root / split / "Image" / f"{index:03d}_0001.exr", radiance(index, width, height), half=True)
            write_exr(root / split / "IndexMA" / f"{index:03d}_0001.exr", np.full((height, width, 3), index + 1))
            write_exr(root / split / "segmentation" / f"{index:03d}.exr", np.full((height, width, 3), 50))
        data = {"camera_angle_x": 1.2, "frames": frames}
        if named:
            data.update(width=width, height=height)
        (root / split / "transforms.json").write_text(json.dumps(data))
