# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Make a capture with ground truth of a room that is described by a Mitsuba scene file, to be rendered next.

    python benchmarks/other_room.py SCENE.xml benchmarks/rooms/breakfast_room.json --output DIR --seed 31
    python benchmarks/other_materials.py DIR --seed 31
    python examples/render_room.py DIR --seed 31
    python3 dev.py accuracy DIR

Only the meshes of the scene file (version 0.5, OBJ) are used. The plan, a JSON file, tells what the room
gets: scale (metres a unit), lamps, flat panels of light, materials of meshes, textures, where cameras stand.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Vector
from mathutils.bvhtree import BVHTree

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "examples")]

import make_room  # noqa: E402
import room_cameras  # noqa: E402
import room_textures  # noqa: E402
from room_export import ObjectArrays, write_obj, write_tables  # noqa: E402
from room_files import obj_rows  # noqa: E402
from room_materials import RoomMaterial  # noqa: E402

OBJECT_CLASS = 16  # of materials for which the plan names none
EMITTER_CLASS = 1
NEAREST = 0.25  # metres between a camera and a surface
EYE_HEIGHTS = (0.8, 2.3)  # metres above the floor
LOOKS_AT_PLACE = 0.6  # share of the views that look at a point between look_low and look_high
CANDIDATES = 5  # for each view that is chosen
CELL = 0.25  # metres; coverage counts cells of this size


@dataclass(frozen=True)
class Plan:
    """What a room gets besides the meshes of its scene file.

    Attributes:
        scale: metres a unit of the scene file.
        lamps: by name, `meshes` and `radiance`.
        panels: by name, four `corners` in the file's units, a `normal` and `radiance`.
        materials: by name, the meshes that have it; all others keep the material of the file.
        textures: by material, one of room_textures.MAKERS. classes: by material, its semantic class.
        cameras: `low` and `high` bound the cameras, `look_low` and `look_high` what most of them look at.
    """

    scale: float
    lamps: dict[str, dict[str, Any]]
    panels: dict[str, dict[str, Any]]
    materials: dict[str, list[str]]
    textures: dict[str, str]
    classes: dict[str, int]
    cameras: dict[str, list[float]]

    def material(self, mesh: str, written: str) -> str:
        """The material of a mesh whose scene file names `written`."""
        of_meshes = {name: lamp["meshes"] for name, lamp in self.lamps.items()} | self.materials
        return next((name for name, meshes in of_meshes.items() if mesh in meshes), written)

    def made(self, name: str) -> RoomMaterial:
        """The material in the terms of the example room."""
        light = self.lamps.get(name) or self.panels.get(name)
        if light:
            return RoomMaterial(name, EMITTER_CLASS, (0.0, 0.0, 0.0), radiance=tuple(light["radiance"]))
        return RoomMaterial(name, self.classes.get(name, OBJECT_CLASS), texture=self.textures.get(name))


def read_plan(path: Path) -> Plan:
    """The plan in a JSON file; its `source` is for people."""
    table = json.loads(path.read_text())
    table.pop("source", None)
    return Plan(**table)


def blender_axes(points: np.ndarray) -> np.ndarray:
    """(..., 3) points or normals with Y up as Blender has them, Z up."""
    return np.stack([points[..., 0], -points[..., 2], points[..., 1]], -1)


def read_shapes(scene: Path, plan: Plan) -> Iterator[ObjectArrays]:
    """The OBJ meshes of a Mitsuba scene file in metres, Z up; triangles without area are left out."""
    for shape in ElementTree.parse(scene).getroot().iter("shape"):
        if shape.get("type") != "obj":
            continue
        named = {child.get("name"): child for child in shape}
        path = scene.parent / str(named["filename"].get("value"))
        matrix = np.eye(4)
        for element in shape.iter("matrix"):
            matrix = np.array(str(element.get("value")).split(), float).reshape(4, 4)
        vertices, triangles, normals, uv = read_obj(path)
        vertices = vertices @ matrix[:3, :3].T + matrix[:3, 3]
        corners = vertices[triangles]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = np.linalg.norm(across, axis=1)
        kept = area > 1e-12
        flat = np.repeat((across[kept] / area[kept, None])[:, None], 3, axis=1)
        if normals is None or "faceNormals" in named:
            normals = flat
        else:
            normals = normals[kept] @ np.linalg.inv(matrix[:3, :3])
            normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
            turned = ~((normals * flat).sum(-1) > 0).all(1)  # also where a normal is not a number
            normals[turned] = flat[turned]
        reference = shape.find("ref")
        material = plan.material(path.stem, "None" if reference is None else str(reference.get("id")))
        yield ObjectArrays(
            path.stem,
            blender_axes(vertices * plan.scale).astype(np.float32),
            triangles[kept],
            blender_axes(normals).astype(np.float32),
            None if uv is None else uv[kept].astype(np.float32),
            [material] * int(kept.sum()),
        )


def read_obj(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, np.ndarray | None]:
    """Vertices (V, 3), triangles (T, 3), and, if any, normals (T, 3, 3) and UVs (T, 3, 2) of corners."""
    rows, index = obj_rows(path)
    normals = np.array(rows["vn"])[index[..., 2] - 1] if rows["vn"] else None
    uv = np.array(rows["vt"])[index[..., 1] - 1, :2] if rows["vt"] else None
    return np.array(rows["v"]), index[..., 0] - 1, normals, uv


def panel(name: str, described: dict[str, Any], scale: float) -> ObjectArrays:
    """A flat lamp of two triangles that face along `normal`."""
    corners, normal = np.array(described["corners"], float), np.array(described["normal"], float)
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    if np.cross(corners[1] - corners[0], corners[2] - corners[0]) @ normal < 0:
        triangles = triangles[:, ::-1]
    normals = np.broadcast_to(blender_axes(normal), (2, 3, 3)).astype(np.float32)
    return ObjectArrays(
        name, blender_axes(corners * scale).astype(np.float32), triangles, normals, None, [name] * 2
    )


def coverage(tree: BVHTree, position: np.ndarray, target: np.ndarray, aspect: float) -> np.ndarray | None:
    """Ids of the surface cells that a coarse image sees; None if it is too near or looks outside."""
    if tree.find_nearest(Vector(position))[3] < NEAREST:
        return None
    pose = room_cameras.look_at(position, target)
    left, up, forward = (blender_axes(pose[:3, k]) for k in range(3))
    reach = math.tan(room_cameras.FOV_X / 2)
    cells, distances, rays = [], [], 0
    for y in np.linspace(-1, 1, 13) * reach * aspect:
        for x in np.linspace(-1, 1, 22) * reach:
            rays += 1
            hit, normal, _, distance = tree.ray_cast(Vector(position), Vector(forward - x * left + y * up))
            if hit is not None:
                distances.append(distance)
                axis = int(np.argmax(np.abs(normal)))
                key = np.floor(np.array(hit) / CELL).astype(int) + 64
                cells.append(((key[0] * 128 + key[1]) * 128 + key[2]) * 6 + 2 * axis + (normal[axis] > 0))
    inside = len(distances) > 0.85 * rays
    if not inside or np.median(distances) < 0.9 or np.quantile(distances, 0.03) < 0.3:
        return None
    return np.unique(cells)


def drawn_poses(
    tree: BVHTree, plan: Plan, count: int, aspect: float, rng: np.random.Generator
) -> list[np.ndarray]:
    """`count` poses, each of which adds most to what the ones before it see."""
    low, high, look_low, look_high = (
        blender_axes(np.array(plan.cameras[name]) * plan.scale)
        for name in ("low", "high", "look_low", "look_high")
    )
    bounds, looks = np.sort([low, high], axis=0), np.sort([look_low, look_high], axis=0)
    pool: list[tuple[np.ndarray, np.ndarray]] = []
    while len(pool) < CANDIDATES * count:
        position = rng.uniform(bounds[0] + NEAREST, bounds[1] - NEAREST)
        position[2] = bounds[0][2] + rng.uniform(*EYE_HEIGHTS)
        target = rng.uniform(*looks)
        if rng.random() > LOOKS_AT_PLACE:
            yaw, pitch = rng.uniform(0, 2 * math.pi), math.radians(rng.uniform(-45, 40))
            target = position + [
                math.cos(yaw) * math.cos(pitch),
                math.sin(yaw) * math.cos(pitch),
                math.sin(pitch),
            ]
        cells = coverage(tree, position, target, aspect)
        if cells is not None:
            pool.append((room_cameras.look_at(position, target), cells))
    chosen: list[np.ndarray] = []
    seen: dict[int, int] = {}
    while len(chosen) < count:
        gains = [sum(0.4 ** seen.get(cell, 0) for cell in cells) for _, cells in pool]
        pose, cells = pool.pop(int(np.argmax(gains)))
        chosen.append(pose)
        for cell in cells:
            seen[cell] = seen.get(cell, 0) + 1
    return chosen


def relight_corners(plan: Plan) -> np.ndarray:
    """(4, 3) corners of the lamp of relit views: 0.8 m wide, below the ceiling, amid what the cameras see."""
    low, high = np.array(plan.cameras["look_low"]), np.array(plan.cameras["look_high"])
    x, _, z = (low + high) / 2 * plan.scale
    y = plan.cameras["high"][1] * plan.scale - 0.25
    return np.array(
        [(x - 0.4, y, z - 0.4), (x + 0.4, y, z - 0.4), (x + 0.4, y, z + 0.4), (x - 0.4, y, z + 0.4)]
    )


def make(options: argparse.Namespace) -> None:
    """Write scene.obj, its tables, textures and cameras below the output folder."""
    plan, out = read_plan(options.plan), options.output.resolve()
    objects = [*read_shapes(options.scene.resolve(), plan)]
    objects += [panel(name, described, plan.scale) for name, described in plan.panels.items()]
    names = list(dict.fromkeys(item.materials[0] for item in objects))
    objects.sort(key=lambda item: names.index(item.materials[0]))  # the triangles of a lamp are one range
    (out / "textures").mkdir(parents=True, exist_ok=True)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    for name in plan.textures.values():
        pixels = room_textures.encode(room_textures.make_texture(name, options.seed))
        make_room.save_png(out / "textures" / f"{name}.png", pixels)
    write_obj(out / "scene.obj", objects)
    command = f"other_room.py {options.plan.name} --seed {options.seed}"
    write_tables(out, objects, [plan.made(name) for name in names], command)
    starts = np.cumsum([0] + [len(item.vertices) for item in objects])[:-1]
    triangles = np.concatenate([item.triangles + start for item, start in zip(objects, starts, strict=True)])
    tree = BVHTree.FromPolygons(
        np.concatenate([item.vertices for item in objects]).tolist(), triangles.tolist()
    )
    width, height = (int(word) for word in options.size.lower().split("x"))
    held_back: list[np.ndarray] = []
    for stream, (split, count) in enumerate((("train", options.views), ("val", round(options.views * 0.15)))):
        rng = np.random.default_rng([options.seed, stream])
        held_back = drawn_poses(tree, plan, count, height / width, rng)
        make_room.write_cameras(out / split, held_back, width, height)
    make_room.write_relight(out, held_back[:3], relight_corners(plan), [50.0, 38.0, 25.0])
    print(f"{len(objects)} meshes, {len(triangles)} triangles, {options.views} + {len(held_back)} views")


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("scene", type=Path, help="scene file of Mitsuba, version 0.5")
    parser.add_argument("plan", type=Path, help="JSON file, see Plan")
    parser.add_argument("--output", type=Path, required=True, metavar="DIR")
    parser.add_argument("--seed", type=int, default=1, help="of textures and cameras")
    parser.add_argument(
        "--views", type=int, default=50, help="training views; held-back ones are 15 %% of that"
    )
    parser.add_argument("--size", default="224x126", metavar="WxH", help="pixels of an image")
    make(parser.parse_args())
    return 0


if __name__ == "__main__":
    status = main()
    sys.stdout.flush()
    os._exit(status)  # some bpy builds crash in their own clean-up; by now everything is on disk
