"""From the Blender scene to the capture's files: scene.obj (Y up) and the tables beside it."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
from room_cameras import y_up
from room_materials import SEMANTIC_CLASSES, RoomMaterial


@dataclass
class ObjectArrays:
    """One evaluated object: vertices (V, 3) and corner normals (T, 3, 3) in Blender's world, Z up."""

    name: str
    vertices: np.ndarray
    triangles: np.ndarray
    normals: np.ndarray
    uv: np.ndarray | None
    materials: list[str]


def read_objects() -> list[ObjectArrays]:
    """All meshes of the scene with their modifiers applied; every polygon is a triangle already."""
    graph = bpy.context.evaluated_depsgraph_get()
    found = []
    for thing in bpy.context.scene.objects:
        if thing.type != "MESH":
            continue
        mesh = thing.evaluated_get(graph).data
        count = len(mesh.polygons)
        vertices = np.empty(len(mesh.vertices) * 3, np.float32)
        mesh.vertices.foreach_get("co", vertices)
        corners = np.empty(count * 3, np.int32)
        mesh.loops.foreach_get("vertex_index", corners)
        normals = np.empty(count * 9, np.float32)
        mesh.corner_normals.foreach_get("vector", normals)
        slots = np.empty(count, np.int32)
        mesh.polygons.foreach_get("material_index", slots)
        uv = None
        if mesh.uv_layers:
            uv = np.empty(count * 6, np.float32)
            mesh.uv_layers[0].uv.foreach_get("vector", uv)
            uv = uv.reshape(-1, 3, 2)
        names = [slot.material.name for slot in thing.material_slots]
        order = np.argsort(slots, kind="stable")  # one usemtl a material
        triangles, normals = corners.reshape(-1, 3)[order], normals.reshape(-1, 3, 3)[order]
        uv = None if uv is None else uv[order]
        found.append(
            ObjectArrays(
                thing.name, vertices.reshape(-1, 3), triangles, normals, uv, [names[k] for k in slots[order]]
            )
        )
    return found


def write_obj(path: Path, objects: list[ObjectArrays]) -> None:
    """Triangles with positions, normals and, where an object has them, UVs; Y up, metres."""
    lines = [
        "# The example room of fipt_blender (CC0): metres, Y up, triangles only; written by make_room.py"
    ]
    first_v = first_t = first_n = 1
    for item in objects:
        lines.append(f"o {item.name.replace(' ', '_')}")
        lines += [f"v {x:.5f} {y:.5f} {z:.5f}" for x, y, z in y_up(item.vertices)]
        normals, n_of = np.unique(
            np.round(y_up(item.normals).reshape(-1, 3), 3) + 0.0, axis=0, return_inverse=True
        )
        lines += [f"vn {x:g} {y:g} {z:g}" for x, y, z in normals]
        corners = [item.triangles.reshape(-1) + first_v, None, n_of.reshape(-1) + first_n]
        if item.uv is not None:
            uv, t_of = np.unique(np.round(item.uv.reshape(-1, 2), 4) + 0.0, axis=0, return_inverse=True)
            lines += [f"vt {u:g} {v:g}" for u, v in uv]
            corners[1] = t_of.reshape(-1) + first_t
            first_t += len(uv)
        words = (
            [f"{v}/{t}/{n}" for v, t, n in zip(*corners, strict=True)]
            if item.uv is not None
            else [f"{v}//{n}" for v, n in zip(corners[0], corners[2], strict=True)]
        )
        last = None
        for k, material in enumerate(item.materials):
            if material != last:
                lines.append(f"usemtl {material}")
                last = material
            lines.append("f " + " ".join(words[3 * k : 3 * k + 3]))
        first_v += len(item.vertices)
        first_n += len(normals)
    path.write_text("\n".join(lines) + "\n")


def write_tables(
    folder: Path, objects: list[ObjectArrays], materials: list[RoomMaterial], command: str
) -> None:
    """materials.json, emitters.json and scene.npz; ids of materials count from 1, those of objects from 0."""
    number = {material.name: k + 1 for k, material in enumerate(materials)}
    material = np.concatenate([[number[name] for name in item.materials] for item in objects]).astype(
        np.int32
    )
    part = np.repeat(np.arange(len(objects)), [len(item.materials) for item in objects]).astype(np.int32)
    corners = np.concatenate([y_up(item.vertices)[item.triangles] for item in objects])
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    radiance = np.zeros((len(material), 3), np.float32)
    emitters, rows = [], []
    for made in materials:
        mine = np.flatnonzero(material == number[made.name])
        rows.append(
            {
                "name": made.name,
                "id": number[made.name],
                "base_color": list(made.base_color),
                "texture": f"textures/{made.texture}.png" if made.texture else None,
                "roughness": made.roughness,
                "metallic": made.metallic,
                "semantic": made.semantic,
                "triangles": len(mine),
            }
        )
        if made.radiance is not None:
            radiance[mine] = made.radiance
            emitters.append(
                {
                    "name": made.name,
                    "radiance": list(made.radiance),
                    "triangles": [int(mine[0]), int(mine[-1]) + 1],
                    "centre": corners[mine].mean((0, 1)).round(5).tolist(),
                    "area": round(float(area[mine].sum()), 8),
                }
            )
    table = {
        "materials": rows,
        "semantic_classes": {str(k): v for k, v in SEMANTIC_CLASSES.items()},
        "parts": [item.name.replace(" ", "_") for item in objects],
        "room": [corners.min((0, 1)).round(5).tolist(), corners.max((0, 1)).round(5).tolist()],
        "command": command,
    }
    (folder / "materials.json").write_text(json.dumps(table, indent=1) + "\n")
    (folder / "emitters.json").write_text(json.dumps(emitters, indent=1) + "\n")
    np.savez_compressed(
        folder / "scene.npz", material=material, part=part, is_emitter=radiance.any(1), radiance=radiance
    )
