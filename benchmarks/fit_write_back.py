# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Measure how much light Cycles' Principled BSDF and the paper's BRDF reflect; write the table that maps one
to the other; print the error of random materials without and with the correction.

Needs bpy; the paper's side runs in a child process, since bpy and mitsuba don't share one.

    python benchmarks/fit_write_back.py          # fit, write, check
    python benchmarks/fit_write_back.py --check  # only check the table that is there
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

ROUGHNESS = [0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0]
SIZE = 64


def paper_functions(samples: int = 1 << 20) -> dict[str, list[float]]:
    """s0 and s1 at ROUGHNESS by importance sampling, directions of view cosine-weighted."""
    import drjit as dr
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")  # DRJIT_LIBLLVM_PATH names an LLVM where the system's is no good
    from fipt_blender.core.material import brdf

    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, samples)
    result: dict[str, list[float]] = {"paper_s0": [], "paper_s1": []}
    for roughness in ROUGHNESS:
        wo = mi.warp.square_to_cosine_hemisphere(sampler.next_2d())
        wi = brdf.sample_visible_normal(sampler.next_2d(), wo, mi.Float(roughness))
        density = brdf.visible_normal_pdf(wi, wo, mi.Float(roughness))
        lobes = brdf.specular_lobes(wi, wo, mi.Float(roughness))
        for name, lobe in zip(result, lobes, strict=True):
            result[name].append(float(dr.mean(dr.select(density > 0.0, lobe / density, 0.0))[0]))
    return result


class Furnace:
    """A sphere in a white world seen by a parallel camera: its mean over the disc is the averaged albedo."""

    def __init__(self) -> None:
        import bpy
        from mathutils import Matrix

        from fipt_blender.blend import materials, renders

        bpy.ops.wm.read_factory_settings(use_empty=True)
        self.renders = renders
        self.scene = bpy.context.scene
        world = bpy.data.worlds.new("White")
        if world.node_tree is None:
            world.use_nodes = True
        self.scene.world = world
        world.node_tree.nodes["Background"].inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
        bpy.ops.mesh.primitive_uv_sphere_add(segments=256, ring_count=128)
        sphere = bpy.context.object
        sphere.data.shade_smooth()
        self.material, nodes = materials.new_material("Furnace")
        self.principled = nodes["FIPT Principled"]
        sphere.data.materials.append(self.material)
        camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
        self.scene.collection.objects.link(camera)
        camera.data.type, camera.data.ortho_scale = "ORTHO", 2.0
        camera.matrix_world = Matrix.Translation((0.0, 0.0, 3.0))
        self.scene.camera = camera
        self.scene.render.resolution_x = self.scene.render.resolution_y = SIZE

    def albedo(self, base_color: float, roughness: float, metallic: float, spp: int = 256) -> float:
        """Averaged albedo of a grey material."""
        self.principled.inputs["Base Color"].default_value = (base_color, base_color, base_color, 1.0)
        self.principled.inputs["Roughness"].default_value = roughness
        self.principled.inputs["Metallic"].default_value = metallic
        image = self.renders.render_pixels(self.scene, spp=spp, seed=0)
        x = (np.arange(SIZE) + 0.5) / SIZE * 2.0 - 1.0
        inside = x[:, None] ** 2 + x[None, :] ** 2 < 0.98
        return float(image[..., :3].mean(axis=2)[inside].mean())


def cycles_functions(furnace: Furnace) -> dict[str, list[float]]:
    """d, t, f0, f1 at ROUGHNESS."""
    result: dict[str, list[float]] = {"cycles_d": [], "cycles_t": [], "cycles_f0": [], "cycles_f1": []}
    for roughness in ROUGHNESS:
        for metallic, constant, slope in ((0.0, "cycles_d", "cycles_t"), (1.0, "cycles_f1", "cycles_f0")):
            black, white = (furnace.albedo(a, roughness, metallic) for a in (0.0, 1.0))
            result[constant].append(black)
            result[slope].append(white - black)
    return result


def check(furnace: Furnace, count: int = 24) -> None:
    """Print the mean relative error of Cycles' albedo for random materials, before and after."""
    from fipt_blender.core.textures import write_back

    random = np.random.default_rng(1)
    before, after = [], []
    for _ in range(count):
        base_color = np.full((1, 3), random.uniform(0.05, 0.9))
        roughness, metallic = random.uniform(0.05, 1.0, 1), random.choice([0.0, 1.0, random.random()], 1)
        wanted = float(write_back.paper_albedo(base_color, roughness, metallic)[0, 0])
        corrected = write_back.cycles_base_color(base_color, roughness, metallic)
        rest = (float(roughness[0]), float(metallic[0]))
        before.append(furnace.albedo(float(base_color[0, 0]), *rest) / wanted - 1.0)
        after.append(furnace.albedo(float(corrected[0, 0]), *rest) / wanted - 1.0)
    for name, errors in (("as fitted", before), ("corrected", after)):
        print(
            f"{name}: mean relative error {np.mean(np.abs(errors)):.4f}, largest {np.abs(errors).max():.4f}"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="only check the table that is there")
    parser.add_argument("--paper", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.paper:
        print(json.dumps(paper_functions()))
        return
    furnace = Furnace()
    if not arguments.check:
        from fipt_blender.core.textures import write_back

        child = subprocess.run(
            [sys.executable, __file__, "--paper"], check=True, capture_output=True, text=True
        )
        values = {
            "roughness": ROUGHNESS,
            **json.loads(child.stdout.splitlines()[-1]),
            **cycles_functions(furnace),
        }
        rows = {name: [round(value, 5) for value in row] for name, row in values.items()}
        write_back.TABLE.write_text(
            "{\n" + ",\n".join(f' "{name}": {json.dumps(row)}' for name, row in rows.items()) + "\n}\n"
        )
    check(furnace)


if __name__ == "__main__":
    main()
