# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Score the textures of a run on photographs of real size: `real_size.py CAPTURE RUN [--factor 8]`.

CAPTURE is what real_photographs.py has rendered. The base colour of the run's textures is looked up in the
held-back views at full size and compared with the truth, where at least one training view sees a surface:

    kd        PSNR of kd at full size (dB), as of benchmarks/metrics.py
    kd light  the same after averaging to the pixels of light
    detail    correlation with the truth of the luminance above the frequency of a pixel of light, on textured
              surfaces more than two pixels from borders
    paint     RMS of the same band on surfaces of one colour, where the truth has nothing
    halo      RMSE of kd within 3 pixels of light of a shadow's edge, on surfaces of one colour
    seams     RMS error of the step of luminance between neighbouring pixels where the UV island, or the view
              that sees the surface best, changes, relative to that of all other neighbours

`--causes` also tells how the squared error of kd is distributed.
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
from fipt_blender.blend.room.islands import uv_islands
from fipt_blender.core.capture.formats.registry import read_rig
from fipt_blender.core.capture.images import read_ids, read_radiance, write_exr
from fipt_blender.core.capture.options import CaptureOptions
from fipt_blender.core.capture.views import View
from fipt_blender.core.conventions import transform_poses
from fipt_blender.core.device.variant import set_variant
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.run_files import read_atlas
from fipt_blender.core.run.runfolder import RunFolder

PLACES = ((-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25))  # lookups in a pixel
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
SHADOW = 1.25  # ratio of L_d within a pixel of light that makes a shadow's edge
BORDER = 2  # pixels
SILHOUETTE = 0.03  # relative difference of the distance of neighbouring pixels


@dataclass(frozen=True)
class Truth:
    """True maps of one held-back view at full size, and the result of :meth:`Textures.labels`."""

    kd: np.ndarray
    material: np.ndarray
    surface: np.ndarray
    light: np.ndarray
    labels: np.ndarray
    distance: np.ndarray


def read_truth(view: View, labels: np.ndarray, distance: np.ndarray) -> Truth:
    """The true maps beside a view's photograph."""
    folder, name = split_folder(view), f"{view.image.stem}.exr"
    kd = read_radiance(folder / "DiffCol" / name)
    material = read_ids(folder / "IndexMA" / name)
    emits = read_radiance(folder / "Emit" / name).max(axis=2) > 0
    surface = (material > 0) & ~emits & (kd.max(axis=2) > 0) & (labels >= 0)
    return Truth(kd, material, surface, read_radiance(folder / "L_d" / name), labels, distance)


class Textures:
    """The textures of a run, looked up at points of its room."""

    def __init__(self, run: RunFolder) -> None:
        from fipt_blender.core.surface.room import load_room

        self.room = load_room(run)
        _, arrays = read_atlas(run, len(self.room.triangles))
        self.uv, self.image = arrays["corner_uv"], arrays["triangle_image"]
        self.island = uv_islands(self.room.triangles, self.uv).astype(np.int64)
        listed = read_document(run.textures_json, dict)["images"]
        self.base_color = [read_radiance(run.root / entry["base_color"]) for entry in listed]
        self.metallic = [read_radiance(run.root / entry["metallic"])[..., 0] for entry in listed]

    def labels(self, view: View, training: list[View]) -> tuple[np.ndarray, np.ndarray]:
        """Of each pixel (H, W) a label of its UV island and the training view with most pixels on its area.

        -1 where no training view sees anything. And metres to what the pixel sees.
        """
        import drjit as dr
        import mitsuba as mi

        from fipt_blender.core.pixels.camera_rays import trace_pixels

        surface = trace_pixels(self.room, view)
        valid, triangle = np.array(surface.valid), np.array(surface.triangle)
        position, normal = np.array(surface.position).T, np.array(surface.geometric_normal).T
        best, most = np.zeros(len(valid), np.int64), np.zeros(len(valid))
        for number, other in enumerate(training, 1):
            pose = other.camera_to_world
            away = position - pose[:3, 3]
            local = away @ pose[:3, :3]
            depth = np.maximum(local[:, 2], 1e-3)
            x, y = other.fx * local[:, 0] / depth + other.cx, other.fy * local[:, 1] / depth + other.cy
            distance = np.linalg.norm(away, axis=1)
            inside = (local[:, 2] > 0) & (x > 0) & (y > 0) & (x < other.width) & (y < other.height)
            direction = away / np.maximum(distance, 1e-9)[:, None]
            hit = self.room.intersect(
                mi.Ray3f(mi.Point3f(pose[:3, 3]), mi.Vector3f(direction.T.astype(np.float32))),
                mi.Bool(inside & valid),
            )
            dr.eval(hit.distance, hit.valid)
            reached = np.array(hit.valid) & (np.array(hit.distance) > distance - 0.01 - 2 * self.room.noise)
            density = other.fx**2 * np.abs((direction * normal).sum(axis=1)) / depth**2
            better = inside & valid & reached & (density > most)
            best[better], most[better] = number, density[better]
        label = self.island[np.where(valid, triangle, 0)] * (len(training) + 1) + best
        shape = (view.height, view.width)
        return np.where(best > 0, label, -1).reshape(shape), np.array(surface.distance).reshape(shape)

    def kd(self, view: View) -> np.ndarray:
        """(H, W, 3) kd in the pixels of a view, means over four places in each."""
        from fipt_blender.core.pixels.camera_rays import trace_pixels

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


def steps(image: np.ndarray, true: Truth, inside: np.ndarray) -> np.ndarray:
    """(2, 2): sums of squared errors of steps between neighbours, and their number; of one label, of two.

    Neighbours on different sides of a silhouette do not count.
    """
    error, result = (image - true.kd) @ LUMINANCE, np.zeros((2, 2))
    for axis in (0, 1):
        one, other = (np.swapaxes(inside, 0, axis)[part] for part in (np.s_[1:], np.s_[:-1]))
        label, distance = np.swapaxes(true.labels, 0, axis), np.swapaxes(true.distance, 0, axis)
        near = np.abs(distance[1:] / np.maximum(distance[:-1], 1e-6) - 1.0) < SILHOUETTE
        step = np.diff(np.swapaxes(error, 0, axis), axis=0)
        for kind, wanted in enumerate((label[1:] == label[:-1], label[1:] != label[:-1])):
            chosen = wanted & one & other & near
            result[kind] += (step[chosen] ** 2).sum(), chosen.sum()
    return result


def near_shadows(truth: Truth, inside: np.ndarray, factor: int) -> np.ndarray:
    """(H, W) bool: within 3 pixels of light of a shadow's edge."""
    light = np.where(inside, truth.light @ LUMINANCE, np.nan)
    high = ndimage.maximum_filter(np.nan_to_num(light, nan=0.0), factor)
    low = ndimage.minimum_filter(np.nan_to_num(light, nan=np.inf), factor)
    edge = inside & (high > SHADOW * low)
    return np.asarray(ndimage.binary_dilation(edge, iterations=3 * factor))


def causes(
    predicted: list[np.ndarray], true: list[Truth], textured: np.ndarray, factor: int
) -> dict[str, tuple[float, float, float]]:
    """By the kind of a pixel its share of all, of the squared error of kd, and how much of that is low.

    Low is the error of means over pixels of light, which the estimate makes.
    """
    rows: dict[str, np.ndarray] = {}
    for image, one in zip(predicted, true, strict=True):
        inside, error = interiors(one.material), image - one.kd
        squares = [
            (part**2).mean(axis=2) for part in (error, ndimage.uniform_filter(error, (factor, factor, 1)))
        ]
        near, fine = near_shadows(one, inside & one.surface, factor), textured[one.material]
        kinds = {
            "border": ~inside,
            "texture by a shadow": near & fine,
            "texture": fine,
            "one colour by a shadow": near,
            "one colour": np.ones_like(near),
        }
        left = one.surface
        for kind, wanted in kinds.items():
            chosen = left & wanted
            left = left & ~wanted
            sums = np.array([chosen.sum(), *(part[chosen].sum() for part in squares)])
            rows[kind] = rows.get(kind, 0.0) + sums
    count, total, _ = sum(rows.values())
    return {kind: (row[0] / count, row[1] / total, row[2] / max(row[1], 1e-12)) for kind, row in rows.items()}


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
    pairs = np.zeros((2, 2))
    for image, one in zip(predicted, true, strict=True):
        inside = interiors(one.material) & one.surface
        mine, other = (high_band(side @ LUMINANCE, inside, factor) for side in (image, one.kd))
        fine = inside & textured[one.material]
        ours.append(mine[fine])
        theirs.append(other[fine])
        plain = inside & ~textured[one.material]
        paint.append(mine[plain] ** 2)
        near = near_shadows(one, inside, factor)
        halo.append(((image - one.kd)[plain & near] ** 2).mean(axis=1))
        pairs += steps(image, one, inside)
    first, second = np.concatenate(ours), np.concatenate(theirs)
    figures["detail"] = float(np.corrcoef(first, second)[0, 1]) if first.any() else 0.0
    figures["contrast"] = float(first.std() / second.std())
    figures["paint"] = float(np.sqrt(np.concatenate(paint).mean()))
    figures["halo"] = float(np.sqrt(np.concatenate(halo).mean()))
    alike, unlike = np.sqrt(pairs[:, 0] / np.maximum(pairs[:, 1], 1))
    figures["seams"] = float(unlike / alike)
    return figures


def main(argv: list[str]) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("capture", type=Path)
    parser.add_argument("run", type=Path)
    parser.add_argument("--factor", type=int, default=8, help="pixels of a photograph along a pixel of light")
    parser.add_argument("--views", type=int, help="only so many held-back views")
    parser.add_argument("--causes", action="store_true", help="print where the squared error of kd is")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--maps", type=Path, help="write kd of the views there")
    options = parser.parse_args(argv)
    set_variant()
    run = RunFolder(options.run)
    placed = np.array(read_document(run.capture_json, dict)["world_from_source"])
    rig = read_rig(options.capture, "auto", CaptureOptions())
    every = [
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
    ]
    views = [view for view in every if view.split == "held_back"][: options.views]
    training = [view for view in every if view.split != "held_back"]
    textures = Textures(run)
    predicted = [textures.kd(view) for view in views]
    true = [read_truth(view, *textures.labels(view, training)) for view in views]
    table = read_document(options.capture / "materials.json", dict)["materials"]
    textured = np.zeros(max(entry["id"] for entry in table) + 1, bool)
    for entry in table:
        textured[entry["id"]] = bool(entry["texture"])
    figures = score(predicted, true, textured, options.factor)
    print("  ".join(f"{name} {value:.4g}" for name, value in figures.items()))
    if options.causes:
        for kind, shares in causes(predicted, true, textured, options.factor).items():
            area, squares, low = shares
            print(f"{kind}: {area:.1%} of the pixels, {squares:.1%} of the squared error, low {low:.1%}")
    if options.maps:
        for view, image in zip(views, predicted, strict=True):
            write_exr(options.maps / f"{view.name.replace('/', '_')}.exr", image)
    if options.json:
        options.json.write_text(json.dumps(figures, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
