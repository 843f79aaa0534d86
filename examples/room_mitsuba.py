"""The example room in Mitsuba: its path integrator for images, ray queries for the ground-truth maps.

Import after a Mitsuba variant was set.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pyoidn
from PIL import Image
from room_files import Capture

from benchmarks.tracer.bsdf import PLUGIN_NAME, register
from fipt_blender.core.optics import brdf, factorised

MAX_DEPTH = 16
CHUNK = 64  # paths a pixel in one kernel launch
GRID = 5  # the maps take GRID x GRID positions in a pixel, unless told otherwise


def linear(path: Path) -> np.ndarray:
    """An sRGB image file as linear float32 (H, W, 3)."""
    value = np.asarray(Image.open(path).convert("RGB"), np.float32) / 255
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4).astype(np.float32)


def denoise(radiance: np.ndarray, albedo: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Open Image Denoise with guides, (H, W, 3) each.

    The images are mirrored beyond their borders first: in the outermost pixels, which have neighbours on one
    side only, the denoiser leaves fireflies standing.
    """
    margin = min(24, *(size - 1 for size in radiance.shape[:2]))
    beyond = [(margin, margin), (margin, margin), (0, 0)]
    guided = (np.maximum(radiance, 0), np.clip(albedo, 0, 1), normal)
    padded = [np.pad(image, beyond, mode="reflect").astype(np.float32) for image in guided]
    return np.maximum(pyoidn.denoise(*padded, hdr=True)[margin:-margin, margin:-margin], 0)


@dataclass
class Surfaces:
    """What rays hit, on the host; N rays. Everything is zero where nothing is hit.

    Attributes:
        triangle: (N,) int, -1 where nothing is hit. distance: (N,). normal: (N, 3) shading normal.
        cosine: (N,) of the angle between normal and ray. base_color: (N, 3). front: (N,) bool.
    """

    triangle: np.ndarray
    distance: np.ndarray
    normal: np.ndarray
    cosine: np.ndarray
    base_color: np.ndarray
    front: np.ndarray


@dataclass
class LoadedRoom:
    """A capture's room in Mitsuba, one mesh a material.

    Attributes:
        triangle_at: ids of the capture's triangles in the order of the meshes, -1 at the end.
        first_of: by Mitsuba's id of a mesh, where its triangles begin in `triangle_at`; -1 for others.
        radiance: (material ids + 1, 3).
        light: the added light of relight.json where the room's own are off.
    """

    capture: Capture
    scene: Any
    triangle_at: np.ndarray
    first_of: np.ndarray
    radiance: np.ndarray
    light: dict[str, Any] | None
    lobes: dict[float, np.ndarray] = field(default_factory=dict)

    def sensor(self, pose: np.ndarray) -> Any:
        """A Mitsuba camera; the files' camera axes are Mitsuba's own."""
        capture = self.capture
        return mi.load_dict(
            {
                "type": "perspective",
                "fov": float(np.degrees(capture.fov_x)),
                "fov_axis": "x",
                "near_clip": 1e-3,
                "to_world": mi.ScalarTransform4f(pose.tolist()),
                "film": {
                    "type": "hdrfilm",
                    "width": capture.width,
                    "height": capture.height,
                    "pixel_format": "rgb",
                    "component_format": "float32",
                    "rfilter": {"type": "box"},
                },
            }
        )

    def image(self, pose: np.ndarray, maps: dict[str, np.ndarray], spp: int, seed: int) -> np.ndarray:
        """Radiance (H, W, 3): reflected light path-traced and denoised, plus the emission map.

        Paths of length 1 with the same random numbers are taken away first, so that the denoiser never sees
        the bulb, a thousand times brighter than what is around it.
        """
        sensor = self.sensor(pose)
        paths = mi.load_dict({"type": "path", "max_depth": MAX_DEPTH, "rr_depth": 3})
        direct = mi.load_dict({"type": "path", "max_depth": 1})
        total = np.zeros((self.capture.height, self.capture.width, 3), np.float32)
        left = spp
        while left > 0:
            count = min(left, CHUNK)
            args = {"sensor": sensor, "spp": count, "seed": (seed * 4096 + left) % 2**31}
            whole = mi.render(self.scene, integrator=paths, **args).numpy()
            total += count * (whole - mi.render(self.scene, integrator=direct, **args).numpy())
            left -= count
        return denoise(total / spp, maps["albedo"], maps["_normal"]) + maps["Emit"]

    def trace(self, origins: np.ndarray, directions: np.ndarray) -> Surfaces:
        """First hits of rays (N, 3), (N, 3)."""
        ray = mi.Ray3f(mi.Point3f(origins.T.astype(np.float32)), mi.Vector3f(directions.T.astype(np.float32)))
        si = self.scene.ray_intersect(ray)
        color = si.shape.eval_attribute_3("base_color", si, si.is_valid()).numpy().T
        first = self.first_of[dr.reinterpret_array(mi.UInt32, si.shape).numpy()]
        known = si.is_valid().numpy() & (first >= 0)
        triangle = self.triangle_at[np.where(known, first + si.prim_index.numpy(), -1)]
        hit = triangle >= 0
        normal = si.sh_frame.n.numpy().T
        cosine = -(normal * directions).sum(1)
        front = -(si.n.numpy().T * directions).sum(1) > 0
        distance = np.where(hit, si.t.numpy(), 0)
        return Surfaces(triangle, distance, normal * hit[:, None], np.abs(cosine), color, front & hit)

    def rays(self, pose: np.ndarray, shift: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rays through every pixel at `shift` (..., 2) in [0, 1): origins and unit directions (H * W, 3)."""
        width, height = self.capture.width, self.capture.height
        y, x = np.divmod(np.arange(width * height), width)
        focal = width / 2 / np.tan(self.capture.fov_x / 2)
        along = (
            np.stack(
                [-(x + shift[..., 0] - width / 2), -(y + shift[..., 1] - height / 2), np.full(len(x), focal)],
                -1,
            )
            @ pose[:3, :3].T
        )
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        return np.repeat(pose[None, :3, 3], len(along), 0), along

    def maps(self, pose: np.ndarray, seed: int, grid: int = GRID) -> dict[str, np.ndarray]:
        """Ground truth of one view by name; colours are means over the pixel, ids are those of its centre."""
        capture = self.capture
        shape = (capture.height, capture.width)
        table = {m["id"]: m for m in capture.materials}
        ids = np.arange(len(table) + 1)
        roughness = np.array([0.0] + [table[i]["roughness"] for i in ids[1:]])
        metallic = np.array([0.0] + [table[i]["metallic"] for i in ids[1:]])[:, None]
        semantic = np.array([0] + [table[i]["semantic"] for i in ids[1:]])
        material_of = np.append(capture.material, 0)  # triangle -1: nothing
        rng = np.random.default_rng([seed, 3])
        sums = {
            name: 0.0
            for name in ("BaseColor", "DiffCol", "Metallic", "Roughness", "Emit", "albedo", "_normal")
        }
        for cell in range(grid * grid):
            shift = (np.array(divmod(cell, grid)) + rng.random((shape[0] * shape[1], 2))) / grid
            hit = self.trace(*self.rays(pose, shift))
            material = material_of[hit.triangle]
            a, m = hit.base_color, metallic[material]
            ks = factorised.specular_reflectance(a, m) * (material > 0)[:, None]
            black = self.radiance[material].any(1) | (material == 0)
            lobes = self.directional_lobes(roughness[material], hit.cosine)
            values = {
                "BaseColor": a,
                "DiffCol": a * (1 - m),
                "Metallic": np.repeat(m, 3, 1),
                "Roughness": np.repeat(roughness[material][:, None], 3, 1),
                "Emit": self.radiance[material] * hit.front[:, None] * (self.light is None),
                "albedo": np.where(black[:, None], 0, a * (1 - m) + ks * lobes[:, :1] + lobes[:, 1:]),
                "_normal": hit.normal,
            }
            if self.light is not None:
                values["Emit"] += self.added_light(pose, shift, hit.distance)
            for name, value in values.items():
                sums[name] = sums[name] + value / grid**2
        centre = self.trace(*self.rays(pose, np.array([0.5, 0.5])))
        material = material_of[centre.triangle]
        part = np.append(capture.part, 0)[centre.triangle]
        sums |= {
            "IndexMA": np.repeat(material[:, None], 3, 1),
            "IndexOB": np.repeat(part[:, None], 3, 1),
            "segmentation": np.repeat(semantic[material][:, None], 3, 1),
            "Normal": centre.normal,
        }
        maps = {name: np.asarray(value, np.float32).reshape(*shape, 3) for name, value in sums.items()}
        return maps | {
            "Depth": centre.distance.astype(np.float32).reshape(shape),
            "_triangle": centre.triangle.reshape(shape),
            "_front": centre.front.reshape(shape),
        }

    def directional_lobes(self, roughness: np.ndarray, cosine: np.ndarray) -> np.ndarray:
        """(N, 2) integrals of the two specular lobes, from one table a roughness."""
        nodes = np.linspace(0, 1, 65)  # of sqrt(cosine): dense towards grazing angles
        out = np.zeros((len(roughness), 2))
        for value in np.unique(roughness[roughness > 0]):
            if value not in self.lobes:
                self.lobes[value] = lobe_albedos(value, nodes**2)
            mine = roughness == value
            at = np.sqrt(np.clip(cosine[mine], 0, 1))
            out[mine] = np.stack([np.interp(at, nodes, self.lobes[value][:, k]) for k in range(2)], -1)
        return out

    def added_light(self, pose: np.ndarray, shift: np.ndarray, distance: np.ndarray) -> np.ndarray:
        """(N, 3) radiance of the added rectangle where it is seen from its front and nothing is before it."""
        origins, along = self.rays(pose, shift)
        corners = np.array(self.light["vertices"])
        edge_1, edge_2, normal = (
            corners[1] - corners[0],
            corners[3] - corners[0],
            np.array(self.light["normal"]),
        )
        facing = along @ normal
        t = (corners[0] - origins) @ normal / np.where(facing == 0, 1, facing)
        offset = origins + t[:, None] * along - corners[0]
        u, v = offset @ edge_1 / (edge_1 @ edge_1), offset @ edge_2 / (edge_2 @ edge_2)
        inside = (u >= 0) & (u <= 1) & (v >= 0) & (v <= 1) & (t > 0) & (facing < 0)
        seen = inside & ((distance == 0) | (t < distance))
        return seen[:, None] * np.array(self.light["radiance"])


def load_room(
    capture: Capture, light: dict[str, Any] | None = None, added: dict[str, Any] | None = None
) -> LoadedRoom:
    """The room with its own emitters, or with them off (black) and `light` (of relight.json) instead.

    Args:
        capture: the capture.
        light: see above.
        added: more shapes, by name, as in Mitsuba's dictionaries; with the attribute "base_color".
    """
    register()
    radiance = np.zeros((len(capture.materials) + 1, 3))
    for emitter in capture.emitters:
        radiance[capture.material[emitter["triangles"][0]]] = emitter["radiance"]
    description: dict[str, Any] = {"type": "scene"}
    triangles: dict[str, np.ndarray] = {}
    with tempfile.TemporaryDirectory() as scratch:
        for material in capture.materials:
            mine = np.flatnonzero(capture.material == material["id"])
            if len(mine) == 0:
                continue
            path = Path(scratch) / f"{material['id']}.ply"
            write_mesh(capture, mine, path)
            shape: dict[str, Any] = {"type": "ply", "filename": str(path)}
            emitted = radiance[material["id"]]
            if emitted.any():
                shape["bsdf"] = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}
                if light is None:
                    shape["emitter"] = {
                        "type": "area",
                        "radiance": {"type": "rgb", "value": emitted.tolist()},
                    }
            else:
                shape["bsdf"] = {
                    "type": PLUGIN_NAME,
                    "base_color": describe_color(capture, material),
                    "roughness": material["roughness"],
                    "metallic": material["metallic"],
                }
                shape["base_color"] = describe_color(capture, material)  # for the maps
            name = f"m{material['id']:03d}"
            description[name], triangles[name] = shape, mine
        if light is not None:
            path = Path(scratch) / "light.ply"
            write_light(light, path)
            description["added_light"] = {
                "type": "ply",
                "filename": str(path),
                "face_normals": True,
                "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}},
                "emitter": {"type": "area", "radiance": {"type": "rgb", "value": light["radiance"]}},
            }
        scene = mi.load_dict(description | (added or {}), optimize=False)  # else alike meshes are merged
    number = {
        shape.id(): int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))[0]) for shape in scene.shapes()
    }
    first_of = np.full(max(number.values()) + 1, -1, np.int64)
    at = 0
    for name, mine in triangles.items():
        first_of[number[name]] = at
        at += len(mine)
    triangle_at = np.concatenate([*triangles.values(), [-1]])
    return LoadedRoom(capture, scene, triangle_at, first_of, radiance, light)


def describe_color(capture: Capture, material: dict[str, Any]) -> dict[str, Any]:
    """Mitsuba's dictionary of a material's base colour."""
    if not material["texture"]:
        return {"type": "srgb", "color": material["base_color"]}
    return {"type": "bitmap", "bitmap": mi.Bitmap(linear(capture.folder / material["texture"])), "raw": True}


def write_mesh(capture: Capture, mine: np.ndarray, path: Path) -> None:
    """The triangles `mine` as a PLY with unshared corners; Mitsuba's V points down."""
    count = len(mine)
    mesh = mi.Mesh(path.stem, 3 * count, count, has_vertex_normals=True, has_vertex_texcoords=True)
    uv = capture.uv[mine].reshape(-1, 2)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = mi.Float(capture.corners[mine].ravel())
    parameters["vertex_normals"] = mi.Float(capture.normals[mine].ravel())
    parameters["vertex_texcoords"] = mi.Float(np.stack([uv[:, 0], 1 - uv[:, 1]], -1).ravel())
    parameters["faces"] = mi.UInt32(np.arange(3 * count, dtype=np.uint32))
    parameters.update()
    mesh.write_ply(str(path))


def write_light(light: dict[str, Any], path: Path) -> None:
    """The added light's triangles as a PLY."""
    corners = np.array(light["vertices"], np.float32)
    mesh = mi.Mesh("light", len(corners), len(light["faces"]))
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = mi.Float(corners.ravel())
    parameters["faces"] = mi.UInt32(np.array(light["faces"], np.uint32).ravel())
    parameters.update()
    mesh.write_ply(str(path))


def lobe_albedos(roughness: float, cosines: np.ndarray, samples: int = 4096) -> np.ndarray:
    """(n, 2): integrals over the hemisphere of the F0 and F1 lobes seen at `cosines`, converged.

    With them a' = kd + ks * [0] + [1] (paper Sec. 5, the albedo that its tables compare).
    """
    n = len(cosines)
    cosine = mi.Float(np.repeat(np.maximum(cosines, 1e-3), samples).astype(np.float32))
    view = mi.Vector3f(dr.safe_sqrt(1.0 - cosine * cosine), 0.0, cosine)
    step = np.arange(samples)
    # Hammersley points
    bits = np.array([int(f"{k:032b}"[::-1], 2) for k in step]) / 2.0**32
    pair = mi.Point2f(
        np.tile((step + 0.5) / samples, n).astype(np.float32), np.tile(bits, n).astype(np.float32)
    )
    light = brdf.sample_visible_normal(pair, view, mi.Float(roughness))
    density = brdf.visible_normal_pdf(light, view, mi.Float(roughness))
    lobes = brdf.specular_lobes(light, view, mi.Float(roughness))
    valid = (light.z > 0.0) & (density > 0.0)
    means = [dr.select(valid, lobe / density, 0.0).numpy().reshape(n, samples).mean(1) for lobe in lobes]
    return np.stack(means, -1)
