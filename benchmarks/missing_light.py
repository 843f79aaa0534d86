"""A capture with ground truth whose photographs or mesh lack what lights it.

    python benchmarks/missing_light.py CAPTURE --output DIR --missing lamps [--views 24]

missing: nothing; behind (no view shows a lamp, the mesh is complete); lamps (the mesh also lacks the lamps
and all that the views don't show); corner (a third of the mesh is cut away, with the cameras in it). The
capture has the FIPT authors' synthetic layout. A fifth of the views is held back; the true maps of held-back
views are empty where the mesh was cut away. DIR/missing.json tells the power of the lamps that no view shows.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.disturb import read_obj
from fipt_blender.core.capture.images import read_ids, read_radiance, write_exr
from fipt_blender.core.device.variant import set_variant
from fipt_blender.core.run.runfolder import write_json

KINDS = ("nothing", "behind", "lamps", "corner")
CORNER = 1.0 / 3.0  # of the mesh's area
HELD_BACK = 5  # every so manieth view
FINER = 3  # rays per pixel along each side that decide what the views show


def make_capture(source: Path, target: Path, missing: str, most_views: int) -> None:
    """Write the capture.

    Args:
        most_views: of them, evenly chosen.
    """
    table = json.loads((source / "train" / "transforms.json").read_text())
    poses = [np.array(frame["transform_matrix"], float) for frame in table["frames"]]
    vertices, triangles = read_obj(source / "scene.obj")
    with np.load(source / "scene.npz") as data:
        scene = {name: data[name] for name in data.files}
    views, keep = list(range(len(poses))), np.ones(len(triangles), bool)
    if missing in ("behind", "lamps"):
        emitted = (read_radiance(_file(source, "Emit", index)) for index in views)
        views = [index for index, image in zip(views, emitted, strict=True) if not (image > 0.0).any()]
    if missing == "corner":
        keep, views = _without_corner(vertices, triangles, poses)
    views = (
        [views[i * len(views) // most_views] for i in range(most_views)] if len(views) > most_views else views
    )
    size = read_radiance(_file(source, "Image", 0)).shape[:2]
    shown = _Shown(vertices, triangles, size, float(table["camera_angle_x"]))
    if missing == "lamps":
        keep = np.zeros(len(triangles), bool)
        for index in views:
            seen = shown.triangles(poses[index], FINER)
            keep[seen[seen >= 0]] = True
        keep &= ~scene["is_emitter"].astype(bool)
    target.mkdir(parents=True)
    _write_mesh(source / "scene.obj", target / "scene.obj", keep)
    np.savez_compressed(target / "scene.npz", **{name: array[keep] for name, array in scene.items()})
    emitters, power = _emitters(json.loads((source / "emitters.json").read_text()), keep, missing == "behind")
    write_json(target / "emitters.json", emitters)
    write_json(target / "missing.json", {"missing": missing, "power": power})
    os.symlink((source / "materials.json").resolve(), target / "materials.json")
    for split, chosen in (
        ("train", [index for place, index in enumerate(views) if place % HELD_BACK != 2]),
        ("val", views[2::HELD_BACK]),
    ):
        (target / split).mkdir()
        frames = [{"transform_matrix": poses[index].tolist()} for index in chosen]
        write_json(target / split / "transforms.json", {**table, "frames": frames})
        for folder in sorted(path.name for path in (source / "train").iterdir() if path.is_dir()):
            (target / split / folder).mkdir()
            for number, index in enumerate(chosen):
                os.symlink(_file(source, folder, index).resolve(), _file(target, folder, number, split))
        if split == "val" and not keep.all():
            for number, index in enumerate(chosen):
                path = _file(target, "IndexMA", number, split)
                material, seen = read_ids(path), shown.triangles(poses[index])
                path.unlink()
                hit = np.append(keep, False)[seen].reshape(material.shape)
                write_exr(path, np.where(hit, material, 0)[..., None].repeat(3, 2).astype(np.float32))


def _file(capture: Path, folder: str, index: int, split: str = "train") -> Path:
    """A view's file in one of the layout's folders."""
    bare = folder in ("albedo", "segmentation")
    return capture / split / folder / (f"{index:03d}.exr" if bare else f"{index:03d}_0001.exr")


def _without_corner(
    vertices: np.ndarray, triangles: np.ndarray, poses: Sequence[np.ndarray]
) -> tuple[np.ndarray, list[int]]:
    """(T,) bool, what is left of a mesh (Y up), and the views whose cameras are within."""
    corners = vertices[triangles]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    along = np.array([1.0, 0.0, 1.0])
    height = corners.mean(axis=1) @ along
    order = np.argsort(-height)
    limit = height[order[np.searchsorted(np.cumsum(area[order]), CORNER * area.sum())]]
    return height < limit, [index for index, pose in enumerate(poses) if pose[:3, 3] @ along < limit]


class _Shown:
    """What the pixels of views see; arguments as of the layout."""

    def __init__(
        self, vertices: np.ndarray, triangles: np.ndarray, size: tuple[int, int], angle: float
    ) -> None:
        set_variant()
        import mitsuba as mi

        self._mi, self._size = mi, size
        self._focal = 0.5 * size[1] / np.tan(0.5 * angle)
        mesh = mi.Mesh("room", len(vertices), len(triangles))
        parameters = mi.traverse(mesh)
        parameters["vertex_positions"] = np.ascontiguousarray(vertices, np.float32).ravel()
        parameters["faces"] = np.ascontiguousarray(triangles, np.uint32).ravel()
        parameters.update()
        self._scene = mi.load_dict({"type": "scene", "mesh": mesh})

    def triangles(self, pose: np.ndarray, finer: int = 1) -> np.ndarray:
        """(H * W * finer^2,) int64 triangle of each ray, -1 without; camera axes X left, Y up, Z forward."""
        mi, (height, width) = self._mi, self._size
        u, v = ((np.arange(side * finer) + 0.5) / finer for side in (width, height))
        x, y = ((0.5 * side - a) / self._focal for side, a in ((width, u), (height, v)))
        local = np.stack([*np.meshgrid(x, y), np.ones((len(y), len(x)))], axis=-1).reshape(-1, 3)
        toward = (local / np.linalg.norm(local, axis=1, keepdims=True)) @ pose[:3, :3].T
        start = np.broadcast_to(pose[:3, 3], toward.shape)
        origin, direction = (
            [mi.Float(np.ascontiguousarray(column, np.float32)) for column in array.T]
            for array in (start, toward)
        )
        hit = self._scene.ray_intersect_preliminary(mi.Ray3f(mi.Point3f(*origin), mi.Vector3f(*direction)))
        return np.where(np.array(hit.is_valid()), np.array(hit.prim_index).astype(np.int64), -1)


def _write_mesh(source: Path, target: Path, keep: np.ndarray) -> None:
    """Copy the triangles `keep` (T,) of an OBJ file, and the vertices that they use."""
    lines = source.read_text(encoding="utf-8").splitlines()
    faces = iter(keep)
    lines = [line for line in lines if not line.startswith("f ") or next(faces)]
    vertex = [index for index, line in enumerate(lines) if line.startswith("v ")]
    used = np.zeros(len(vertex) + 1, bool)
    for line in lines:
        if line.startswith("f "):
            used[[int(word.partition("/")[0]) for word in line.split()[1:]]] = True
    number = np.cumsum(used)
    left_out = {index for index, kept in zip(vertex, used[1:], strict=True) if not kept}
    written = []
    for index, line in enumerate(lines):
        if index in left_out:
            continue
        if line.startswith("f "):
            words = (word.partition("/") for word in line.split()[1:])
            line = "f " + " ".join(f"{number[int(first)]}{slash}{rest}" for first, slash, rest in words)
        written.append(line)
    target.write_text("\n".join(written) + "\n", encoding="utf-8")


def _emitters(
    table: list[dict[str, Any]], keep: np.ndarray, hidden: bool
) -> tuple[list[dict[str, Any]], list[float]]:
    """The lamps that the mesh still has, and the power (3,) in watts of those that no view shows.

    Args:
        hidden: all of them.
    """
    place, left, power = np.concatenate([[0], np.cumsum(keep)]), [], np.zeros(3)
    for lamp in table:
        first, end = (int(place[index]) for index in lamp["triangles"])
        if end > first:
            left.append({**lamp, "triangles": [first, end]})
        if hidden or end == first:
            power += np.pi * lamp["area"] * np.array(lamp["radiance"])
    return left, power.tolist()


def main(argv: Sequence[str]) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("capture", type=Path, metavar="CAPTURE")
    parser.add_argument("--output", type=Path, required=True, metavar="DIR")
    parser.add_argument("--missing", choices=KINDS, required=True)
    parser.add_argument("--views", type=int, default=24, metavar="N", help="at most (default: 24)")
    arguments = parser.parse_args(list(argv))
    make_capture(arguments.capture, arguments.output, arguments.missing, arguments.views)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
