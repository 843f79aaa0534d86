# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Photographs of real size of a room of examples/make_room.py: few paths a pixel, and all its fine textures.

Diffuse and specular shadings of the first surface are traced and denoised, and a photograph is composed of
them with the true maps, L = kd L_d + ks L_s0 + L_s1 (paper Eq. 5): so the denoiser can't touch a texture.
Then the blur and the noise of a camera are added.

    python examples/make_room.py --no-render --size 1536x864 --views 18 --out DIR
    python benchmarks/real_photographs.py DIR
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "examples")]

from benchmarks.fine_textures import write_fine_textures  # noqa: E402

BLUR = 0.5  # standard deviation of a camera's blur, pixels
SHOT_NOISE, READ_NOISE = 0.008, 0.002  # standard deviations at the median radiance, relative to it
GRID = 3  # true maps are means over GRID x GRID positions in a pixel
MAX_DEPTH = 8
TRAIN_MAPS = ("IndexMA", "segmentation", "DiffCol")  # written of training views


def shadings(room: Any, pose: np.ndarray, spp: int, seed: int) -> np.ndarray:
    """(3, H, W, 3) L_d, L_s0 and L_s1 of the first surface, means over the pixel.

    Each pass takes one direction by the cosine, one by visible normals and one towards an emitter, combined
    by the balance heuristic.
    """
    import drjit as dr
    import mitsuba as mi

    from fipt_blender.core.optics import brdf

    scene, capture = room.scene, room.capture
    path = mi.load_dict({"type": "path", "max_depth": MAX_DEPTH, "rr_depth": 3})
    by_id = {material["id"]: material["roughness"] for material in capture.materials}
    material_of = np.append(capture.material, 0)[room.triangle_at[room.first_of]]
    roughness_of = mi.Float(np.array([max(by_id.get(int(k), 1.0), brdf.MIN_ROUGHNESS) for k in material_of]))
    height, width = capture.height, capture.width
    total = np.zeros((3, height * width, 3), np.float32)
    rng = np.random.default_rng(seed)
    for _ in range(spp):
        origins, directions = room.rays(pose, rng.random((height * width, 2)))
        ray = mi.Ray3f(mi.Point3f(origins.T.astype(np.float32)), mi.Vector3f(directions.T.astype(np.float32)))
        si = scene.ray_intersect(ray)
        valid = si.is_valid()
        normal = mi.Vector3f(dr.select(dr.dot(si.sh_frame.n, ray.d) > 0.0, -si.sh_frame.n, si.sh_frame.n))
        geometric = mi.Vector3f(dr.select(dr.dot(si.n, ray.d) > 0.0, -si.n, si.n))
        frame = mi.Frame3f(normal)
        wo = frame.to_local(-ray.d)
        wo.z = dr.maximum(wo.z, 1e-3)
        wo = dr.normalize(wo)
        roughness = dr.gather(mi.Float, roughness_of, dr.reinterpret_array(mi.UInt32, si.shape), valid)
        roughness = dr.select(valid, roughness, 1.0)
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(int(rng.integers(2**31)), height * width)
        sums = [mi.Color3f(0.0) for _ in range(3)]

        def add(wi: Any, radiance: Any, density: Any, active: Any) -> None:
            weight = dr.select(active & (wi.z > 0.0) & (density > 1e-12), 1.0 / density, 0.0)
            s0, s1 = brdf.specular_lobes(wi, wo, roughness)  # noqa: B023
            for k, lobe in enumerate((dr.maximum(wi.z, 0.0) * dr.inv_pi, s0, s1)):
                sums[k] += radiance * weight * lobe  # noqa: B023

        def surface_pdf(wi: Any) -> Any:
            cosine = dr.maximum(wi.z, 0.0) * dr.inv_pi
            return cosine + brdf.visible_normal_pdf(wi, wo, roughness)  # noqa: B023

        for technique in range(2):
            pair = sampler.next_2d()
            if technique:
                wi = brdf.sample_visible_normal(pair, wo, roughness)
            else:
                wi = mi.warp.square_to_cosine_hemisphere(pair)
            onward = si.spawn_ray(frame.to_world(wi))
            active = valid & (wi.z > 0.0) & (dr.dot(geometric, onward.d) > 0.0)
            hit = scene.ray_intersect(onward, active)
            emitter = hit.emitter(scene, active)
            there = active & (emitter != None)  # noqa: E711 - an array of pointers
            emitted = dr.select(there, emitter.eval(hit, there), 0.0)
            target = mi.DirectionSample3f(scene, hit, si)
            emitter_pdf = dr.select(there, scene.pdf_emitter_direction(si, target, there), 0.0)
            radiance = path.sample(scene, sampler, onward, active=active)[0]
            add(wi, radiance - emitted, surface_pdf(wi), active)
            add(wi, emitted, surface_pdf(wi) + emitter_pdf, active)
        target, weight = scene.sample_emitter_direction(si, sampler.next_2d(), True, valid)
        wi = frame.to_local(target.d)
        lit = valid & (target.pdf > 0.0) & (dr.dot(geometric, target.d) > 0.0)
        add(wi, weight * target.pdf, surface_pdf(wi) + target.pdf, lit)
        dr.eval(sums)
        for k in range(3):
            total[k] += np.array(sums[k]).T / spp
    return np.nan_to_num(total).reshape(3, height, width, 3)


def composed(room: Any, maps: dict[str, np.ndarray], parts: np.ndarray) -> np.ndarray:
    """The photograph without blur and noise, (H, W, 3), of its denoised shadings (3, H, W, 3)."""
    specular = 0.04 * (1 - maps["Metallic"]) + maps["BaseColor"] * maps["Metallic"]
    reflects = (maps["albedo"].max(axis=-1, keepdims=True) > 0).astype(np.float32)
    return reflects * (maps["DiffCol"] * parts[0] + specular * parts[1] + parts[2]) + maps["Emit"]


def photographed(radiance: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The radiance (H, W, 3) as a camera records it: blurred and noisy, not negative."""
    blurred = ndimage.gaussian_filter(radiance, (BLUR, BLUR, 0.0))
    middle = float(np.median(blurred))
    deviation = np.sqrt((SHOT_NOISE**2) * np.maximum(blurred, 0) * middle + (READ_NOISE * middle) ** 2)
    return np.maximum(blurred + deviation * rng.normal(size=blurred.shape), 0.0)


def render(folder: Path, spp: int, seed: int) -> None:
    """Photographs and true maps of all views of a capture folder; finished views stay."""
    import room_mitsuba
    from room_files import read_capture, write_exr

    capture = read_capture(folder)
    room = room_mitsuba.load_room(capture)
    started, done = time.time(), 0
    for split, poses in capture.poses.items():
        for k, pose in enumerate(poses):
            done += 1
            path = folder / split / "Image" / f"{k:03d}_0001.exr"
            if path.exists():
                continue
            maps = room.maps(pose, seed=seed + 1000, grid=GRID)
            white = np.ones_like(maps["albedo"])
            parts = shadings(room, pose, spp, seed * 100003 + done)
            clean = np.stack([room_mitsuba.denoise(part, white, maps["_normal"]) for part in parts])
            for name, values in maps.items():
                if name.startswith("_") or (split == "train" and name not in TRAIN_MAPS):
                    continue
                kind = np.float32 if name in ("IndexMA", "IndexOB", "segmentation") else np.float16
                stem = f"{k:03d}" if name in ("albedo", "segmentation") else f"{k:03d}_0001"
                write_exr(folder / split / name / f"{stem}.exr", values.astype(kind))
            write_exr(folder / split / "L_d" / path.name, clean[0].astype(np.float16))
            rng = np.random.default_rng([seed, done])
            write_exr(path, photographed(composed(room, maps, clean), rng).astype(np.float16))
            print(f"{split} {k}: {done}, {time.time() - started:.0f} s", flush=True)


def main(argv: list[str]) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--spp", type=int, default=4, help="directions of each kind a pixel")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args(argv)
    from fipt_blender.core.device.variant import set_variant

    set_variant()
    folder = options.folder.resolve()
    marker = folder / "textures" / "fine.json"
    if not marker.exists():
        write_fine_textures(folder / "textures", options.seed)
        marker.write_text(json.dumps({"seed": options.seed}) + "\n")
    render(folder, options.spp, options.seed)
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
