# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Score the textures of a run on photographs of real size: `real_size.py CAPTURE RUN [--factor 8]`.

CAPTURE is what real_photographs.py has rendered. The base colour of the run's textures is looked up in the
held-back views at full size and compared with the truth:

    kd        PSNR of kd at full size (dB), as of benchmarks/metrics.py
    kd light  the same after averaging to the pixels of light
    detail    correlation with the truth of the luminance above the frequency of a pixel of light, on textured
              surfaces more than two pixels from borders
    paint     RMS of the same band on surfaces of one colour, where the truth has nothing
    halo      RMSE of kd within 3 pixels of light of a shadow's edge, on surfaces of one colour
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import ndimage

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks import metrics
from benchmarks.truth import split_folder
from fipt_blender.core.capture.formats import read_rig
from fipt_blender.core.capture.images import read_ids, read_radiance, write_exr
from fipt_blender.core.capture.rig import ReadOptions
from fipt_blender.core.capture.views import View
from fipt_blender.core.conventions import transform_poses
from fipt_blender.core.device.variant import set_variant
from fipt_blender.core.run.documents import read_json
from fipt_blender.core.run.run_files import read_atlas
from fipt_blender.core.run.runfolder import RunFolder

PLACES = ((-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25))  # lookups in a pixel
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
SHADOW = 1.25  # ratio of L_d within a pixel of light that makes a shadow's edge
BORDER = 2  # pixels


@dataclass(frozen=True)
class Truth:
    """True maps of one held-back view at full size."""

    kd: np.ndarray
    material: np.ndarray
    surface: np.ndarray
    light: np.ndarray


def read_truth(view: View) -> Truth:
    """The true maps beside a view's photograph."""
    folder, name = split_folder(view), f"{view.image.stem}.exr"
    kd = read_radiance(folder / "DiffCol" / name)
    material = read_ids(folder / "IndexMA" / name)
    emits = read_radiance(folder / "Emit" / name).max(axis=2) > 0
    return Truth(
        kd, material, (material > 0) & ~emits & (kd.max(axis=2) > 0), read_radiance(folder / "L_d" / name)
    )


class Textures:
    """The textures of a run, looked up at points of its room."""

    def __init__(self, run: RunFolder) -> None:
        from fipt_blender.core.scene.room import load_room

        self.room = load_room(run)
        _, arrays = read_atlas(run, len(self.room.triangles))
        self.uv, self.image = arrays["corner_uv"], arrays["triangle_image"]
        listed = read_json(run.textures_json)["images"]
        self.base_color = [read_radiance(run.root / entry["base_color"]) for entry in listed]
        self.metallic = [read_radiance(run.root / entry["metallic"])[..., 0] for entry in listed]

    def kd(self, view: View) -> np.ndarray:
        """(H, W, 3) kd in the pixels of a view, means over four places in each."""
        from fipt_blender.core.scene.camera_rays import trace_pixels

        surface = trace_pixels(self.room, view, PLACES)
        valid = np.array(surface.valid)
        triangle = np.where(valid, np.array(surface.triangle), 0)
        position = np.array(surface.position).T
        corners = self.room.vertices[self.room.triangles[triangle]].astype(np.float64)
        across, along, to = (
            corners[:, 1] - corners[:, 0],
            corners[:, 2] - corners[:, 0],
            position - corners[:, 0],
        )
        aa, ab, bb = (across**2).sum(1), (across * along).sum(1), (along**2).sum(1)
        pa, pb = (to * across).sum(1), (to * along).sum(1)
        scale = 1.0 / np.maximum(aa * bb - ab * ab, 1e-30)
        v, w = (bb * pa - ab * pb) * scale, (aa * pb - ab * pa) * scale
        uv = np.einsum("nk,nkc->nc", np.stack([1 - v - w, v, w], axis=1), self.uv[triangle])
        result = np.zeros((len(triangle), 3))
        for index, (color, metallic) in enumerate(zip(self.base_color, self.metallic, strict=True)):
            mine = np.flatnonzero(valid & (self.image[triangle] == index))
            height, width = metallic.shape
            place = [(1.0 - uv[mine, 1]) * height - 0.5, uv[mine, 0] * width - 0.5]
            share = ndimage.map_coordinates(metallic, place, order=1, mode="nearest")
            for channel in range(3):
                value = ndimage.map_coordinates(color[..., channel], place, order=1, mode="nearest")
                result[mine, channel] = value * (1.0 - share)
        return result.reshape(view.height, view.width, len(PLACES), 3).mean(axis=2)


def high_band(image: np.ndarray, inside: np.ndarray, factor: int) -> np.ndarray:
    """(H, W) what is left of an image without its mean over about a pixel of light, within a region."""
    sigma = 0.5 * factor
    share = ndimage.gaussian_filter(inside.astype(float), sigma)
    return np.where(
        inside, image - ndimage.gaussian_filter(image * inside, sigma) / np.maximum(share, 1e-9), 0.0
    )


def interiors(material: np.ndarray) -> np.ndarray:
    """(H, W) bool: no other material within `BORDER` pixels."""
    size = 2 * BORDER + 1
    return ndimage.maximum_filter(material, size) == ndimage.minimum_filter(material, size)


def averaged(image: np.ndarray, factor: int) -> np.ndarray:
    """Means over squares of pixels."""
    height, width = image.shape[0] // factor, image.shape[1] // factor
    part = image[: height * factor, : width * factor]
    return part.reshape(height, factor, width, factor, *image.shape[2:]).mean(axis=(1, 3))


def score(
    predicted: list[np.ndarray], true: list[Truth], textured: np.ndarray, factor: int
) -> dict[str, float]:
    """The figures of some views; `textured` (materials + 1,) bool by id."""
    figures = {
        "kd": metrics.pooled_psnr(predicted, [one.kd for one in true], [one.surface for one in true], True)
    }
    small = [[averaged(image, factor) for image in side] for side in (predicted, [one.kd for one in true])]
    whole = [averaged(one.surface.astype(float), factor) > 0.99 for one in true]
    figures["kd_light"] = metrics.pooled_psnr(*small, whole, True)
    ours, theirs, paint, halo = [], [], [], []
    for image, one in zip(predicted, true, strict=True):
        inside = interiors(one.material) & one.surface
        mine, other = (high_band(side @ LUMINANCE, inside, factor) for side in (image, one.kd))
        fine = inside & textured[one.material]
        ours.append(mine[fine])
        theirs.append(other[fine])
        plain = inside & ~textured[one.material]
        paint.append(mine[plain] ** 2)
        light = np.where(inside, one.light @ LUMINANCE, np.nan)
        high = ndimage.maximum_filter(np.nan_to_num(light, nan=0.0), factor)
        low = ndimage.minimum_filter(np.nan_to_num(light, nan=np.inf), factor)
        near = ndimage.binary_dilation(inside & (high > SHADOW * low), iterations=3 * factor)
        halo.append(((image - one.kd)[plain & near] ** 2).mean(axis=1))
    first, second = np.concatenate(ours), np.concatenate(theirs)
    figures["detail"] = float(np.corrcoef(first, second)[0, 1]) if first.any() else 0.0
    figures["contrast"] = float(first.std() / second.std())
    figures["paint"] = float(np.sqrt(np.concatenate(paint).mean()))
    figures["halo"] = float(np.sqrt(np.concatenate(halo).mean()))
    return figures


def main(argv: list[str]) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("capture", type=Path)
    parser.add_argument("run", type=Path)
    parser.add_argument("--factor", type=int, default=8, help="pixels of a photograph along a pixel of light")
    parser.add_argument("--views", type=int, help="only so many held-back views")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--maps", type=Path, help="write kd of the views there")
    options = parser.parse_args(argv)
    set_variant()
    run = RunFolder(options.run)
    placed = np.array(read_json(run.capture_json)["world_from_source"])
    rig = read_rig(options.capture, "auto", ReadOptions())
    views = [
        View(
            view.name,
            view.split,
            view.image,
            view.width,
            view.height,
            *view.lens.parameters,
            transform_poses(placed, view.camera_to_world),
        )
        for view in rig.views
        if view.split == "held_back"
    ][: options.views]
    textures = Textures(run)
    predicted = [textures.kd(view) for view in views]
    true = [read_truth(view) for view in views]
    table = read_json(options.capture / "materials.json")["materials"]
    textured = np.zeros(max(entry["id"] for entry in table) + 1, bool)
    for entry in table:
        textured[entry["id"]] = bool(entry["texture"])
    figures = score(predicted, true, textured, options.factor)
    print("  ".join(f"{name} {value:.4g}" for name, value in figures.items()))
    if options.maps:
        for view, image in zip(views, predicted, strict=True):
            write_exr(options.maps / f"{view.name.replace('/', '_')}.exr", image)
    if options.json:
        options.json.write_text(json.dumps(figures, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
