# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""python3 benchmarks/shading_error.py CAPTURE RUN: how far baked shadings are from path-traced ones.

The truth is L_d, L_s0 and L_s1 (paper Eq. 6) of the pixels of some views, path-traced with the capture's
true materials and emitters (the layout of examples/). The shadings in RUN, which are those of stage 3, and
those of stage 1, baked again from the same photographs with the same settings, are compared with it. All are
denoised: the measure is bias, not noise, since training averages over thousands of pixels.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "examples"))

from benchmarks.prepared import copy_input
from fipt_blender.bridge.interpreter import engine_command
from fipt_blender.core.device.variant import set_variant
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.runfolder import RunFolder, write_json

# Samples of the truth: cosine-distributed, for each roughness level, and towards emitters.
SAMPLES = (128, 16, 128)
TERMS = ("L_d", "L_s0", "L_s1")
# Roughness at which shadings of different levels are compared, interpolated as stage 2 does.
COMMON_LEVELS = (0.05, 0.15, 0.3, 0.5, 0.7, 0.9)


@dataclass
class Views:
    """The shadings of some views, rows of a run's pixel store.

    Attributes:
        diffuse: (N, 3), specular: (N, K, 2, 3), in the photographs' units.
    """

    diffuse: np.ndarray
    specular: np.ndarray


def make_parser() -> argparse.ArgumentParser:
    """The command's options."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    add = parser.add_argument
    add("capture", type=Path, metavar="CAPTURE", help="capture with true materials (examples/room)")
    add("run", type=Path, metavar="RUN", help="a finished run of it with at least one round of stage 3")
    add("--views", type=int, default=2, help="training views, evenly spread (default: 2)")
    add("--json", type=Path, metavar="FILE", help="write all figures there")
    return parser


def main(argv: Sequence[str]) -> int:
    """Run the command; 0, or 1 for a failure."""
    arguments = make_parser().parse_args(list(argv))
    try:
        result = evaluate(arguments.capture, RunFolder(arguments.run), arguments.views)
    except FiptError as error:
        print(f"error: {error.text} {error.remedy}", file=sys.stderr)
        return 1
    print(format_table(result))
    if arguments.json:
        write_json(arguments.json.absolute(), result)
    return 0


def evaluate(capture: Path, run: RunFolder, count: int) -> dict[str, Any]:
    """Errors of both stages and of a second truth with other random numbers, by term and roughness level."""
    settings = run.read()
    if not settings.rounds:
        raise FiptError("run-foreign", "That run has no stage 3.", "Run it with --rounds 1 or more.")
    set_variant(settings.device)
    from fipt_blender.core.capture.views import load_capture
    from fipt_blender.core.light.shadings import roughness_levels
    from fipt_blender.core.textures.detail import solved_light

    levels = roughness_levels(settings.roughness_levels, settings.roughness_min, settings.roughness_spacing)
    train = load_capture(run).train
    pixels = solved_light(run, train).pixels
    fixtures = read_document(run.emitters_json, dict)["fixtures"]
    emitting = [t for fixture in fixtures for t in fixture["triangles"]]
    lit = true_room(capture, load_capture(run).world_from_source)
    stages = {"stage 1": bake_stage_1(run), "stage 3": run}
    names = (*stages, "truth, other seed")
    collected: dict[str, list[Views]] = {name: [] for name in ("truth", *names)}
    chosen = [i * len(train) // count for i in range(min(count, len(train)))]
    for index in chosen:
        rows = np.arange(pixels.ranges[index], pixels.ranges[index + 1])
        triangle = np.asarray(pixels.triangle[rows])
        seen = (triangle >= 0) & ~np.isin(triangle, emitting)
        found = {name: read_shadings(folder, rows, train) for name, folder in stages.items()}
        for seed, name in enumerate(("truth", "truth, other seed")):
            found[name] = trace_truth(lit, run, pixels, rows, levels, seed)
        size = (train[index].height, train[index].width)
        for name, shadings in found.items():
            smooth = denoised(shadings, np.asarray(pixels.normal[rows]), size)
            collected[name].append(Views(smooth.diffuse[seen], smooth.specular[seen]))
    whole = {
        name: Views(
            *(np.concatenate([getattr(each, part) for each in parts]) for part in ("diffuse", "specular"))
        )
        for name, parts in collected.items()
    }
    result: dict[str, Any] = {"views": [train[i].name for i in chosen], "levels": [float(x) for x in levels]}
    result |= {"pixels": len(whole["truth"].diffuse)}
    return result | {name: errors(whole[name], whole["truth"]) for name in names}


def denoised(shadings: Views, normal: np.ndarray, size: tuple[int, int]) -> Views:
    """Every term of one view through Open Image Denoise, guided by normals as in the engine."""
    from fipt_blender.core.optics.denoise import Denoiser

    shape = (*size, 3)
    with Denoiser(np.ones(shape, np.float32), normal.reshape(shape), clean_guides=True) as run:
        diffuse = run(shadings.diffuse.reshape(shape)).reshape(-1, 3)
        specular = np.empty_like(shadings.specular)
        for level in range(specular.shape[1]):
            for term in range(2):
                values = np.ascontiguousarray(shadings.specular[:, level, term]).reshape(shape)
                specular[:, level, term] = run(values).reshape(-1, 3)
    return Views(diffuse, specular)


def bake_stage_1(run: RunFolder) -> RunFolder:
    """A second run beside the first that ends after stage 1 (and a single step of training).

    Raises:
        FiptError: ``run-failed``.
    """
    first = RunFolder(run.root.with_name(run.root.name + "-stage-1"))
    copy_input(run, first, replace(run.read(), rounds=0, training_steps=1))
    command = engine_command(Path(sys.executable), "estimate", str(first.root))
    with open(first.log, "ab") as log:
        ended = subprocess.run(command, stdout=log, stderr=log, check=False)
    if ended.returncode:
        raise FiptError("run-failed", "Stage 1 could not be baked.", f"{first.log} tells why.")
    return first


def read_shadings(run: RunFolder, rows: np.ndarray, views: list[Any]) -> Views:
    """Baked shadings of some pixels of the views in the photographs' units."""
    from fipt_blender.core.textures.detail import solved_light

    scale = float(read_document(run.statistics_json, dict)["radiance_scale"])
    store = solved_light(run, views).shadings
    diffuse, specular = (
        np.asarray(array[rows], np.float32) * scale for array in (store.diffuse, store.specular)
    )
    return Views(diffuse, specular)


def trace_truth(
    lit: Any, run: RunFolder, pixels: Any, rows: np.ndarray, levels: np.ndarray, seed: int
) -> Views:
    """Path-traced shadings of some pixels of a run's `PixelStore`; zero where they miss the room."""
    from fipt_blender.core.light.shadings import SampleCounts, bake
    from fipt_blender.core.surface.room import triangle_normals

    seen = np.asarray(pixels.triangle[rows]) >= 0
    result = Views(np.zeros((len(rows), 3), np.float32), np.zeros((len(rows), len(levels), 2, 3), np.float32))
    rows = rows[seen]
    with np.load(run.room_npz, allow_pickle=False) as room:
        normals = triangle_normals(room["vertices"], room["triangles"])
    points = shading_points(pixels, rows, normals)
    shadings = bake(points, PathTraced(lit), lit.lights, levels, SampleCounts(*SAMPLES), seed)
    result.diffuse[seen], result.specular[seen] = shadings.diffuse, shadings.specular
    return result


def shading_points(pixels: Any, rows: np.ndarray, normals: np.ndarray) -> Any:
    """Where the centres of some pixels of a `PixelStore` meet the room, as `ShadingPoints`.

    Args:
        rows: (N,) pixels that see the mesh.
        normals: (T, 3) geometric normals of its triangles.
    """
    from fipt_blender.core.light.shadings import ShadingPoints

    position = np.asarray(pixels.position[rows])
    toward = pixels.camera_positions()[pixels.view_of(rows)] - position
    toward /= np.maximum(np.linalg.norm(toward, axis=1, keepdims=True), 1e-12)
    side = np.where(pixels.front[rows], 1.0, -1.0)[:, None]
    geometric = normals[pixels.triangle[rows]] * side
    return ShadingPoints(position, np.asarray(pixels.normal[rows]), geometric, toward)


def true_room(capture: Path, world_from_source: np.ndarray) -> Any:
    """The capture's room with its true materials and emitters (`LitRoom`), in Blender's world."""
    from room_files import read_capture
    from room_mitsuba import linear

    from benchmarks.tracer.forward import LitRoom
    from benchmarks.tracer.surfaces import LatticeMaterials
    from fipt_blender.core import conventions
    from fipt_blender.core.optics.lights import AreaLights, EmitterTable
    from fipt_blender.core.surface.room import Room

    truth = read_capture(capture)
    count = len(truth.corners)
    none = np.zeros(count, np.int32)
    vertices = conventions.transform_points(world_from_source, truth.corners.reshape(-1, 3))
    turned = conventions.transform_normals(world_from_source, truth.normals.reshape(-1, 3))
    room = Room(
        vertices.astype(np.float32),
        np.arange(3 * count, dtype=np.int32).reshape(-1, 3),
        np.asarray(turned, np.float32).reshape(-1, 3, 3),
        none,
        none,
    )
    corners = room.vertices.astype(np.float64)[room.triangles]
    inverse = np.linalg.pinv(np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=2))
    by_id = {entry["id"]: entry for entry in truth.materials}
    images = {
        entry["id"]: linear(capture / entry["texture"]) for entry in truth.materials if entry["texture"]
    }

    def query(position: np.ndarray, triangle: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        weights = np.einsum("nij,nj->ni", inverse[triangle], position - corners[triangle, 0])
        corner_uv = truth.uv[triangle]
        uv = corner_uv[:, 0] + np.einsum("ni,nij->nj", weights, corner_uv[:, 1:] - corner_uv[:, :1])
        color, value = np.zeros((len(position), 3), np.float32), np.zeros((len(position), 2), np.float32)
        for name in np.unique(truth.material[triangle]):
            mine = truth.material[triangle] == name
            entry = by_id[int(name)]
            value[mine] = entry["roughness"], entry["metallic"]
            color[mine] = sample(images[int(name)], uv[mine]) if entry["texture"] else entry["base_color"]
        return color, value[:, 0], value[:, 1]

    with np.load(capture / "scene.npz", allow_pickle=False) as table:
        emitters = np.flatnonzero(table["is_emitter"]).astype(np.int32)
        radiance = table["radiance"][emitters]
    lights = AreaLights(
        room.vertices, room.triangles, EmitterTable(emitters, radiance, np.zeros_like(radiance))
    )
    return LitRoom(room, LatticeMaterials(room, query, 0.005, 12_000_000), lights)


def sample(image: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Nearest texels (N, 3) of a tiling image at UV coordinates (N, 2), V up."""
    height, width = image.shape[:2]
    column = np.floor(uv[:, 0] * width).astype(np.int64) % width
    row = np.floor((1.0 - uv[:, 1]) * height).astype(np.int64) % height
    return image[row, column]


class PathTraced:
    """Radiance source for baking: the radiance of full paths, including directly visible emission."""

    def __init__(self, lit: Any) -> None:
        import mitsuba as mi

        from benchmarks.tracer.forward import RenderSettings

        # The room makes its arrays on first use, which is impossible while a loop is recorded.
        lit.room.intersect(mi.Ray3f([0, 0, 0], [0, 0, 1]))
        self._lit, self._settings = lit, RenderSettings()
        self.offset = lit.room.offset

    def intersect(self, ray: Any, active: Any) -> Any:
        """First surface along the ray."""
        return self._lit.room.intersect(ray, active)

    def step(self, path: Any, direction: Any, hit: Any, rng: Any, active: Any) -> tuple[Any, Any, Any]:
        """The radiance of a full path along the ray; the path ends."""
        import drjit as dr
        import mitsuba as mi

        from benchmarks.tracer.forward import trace_paths

        # A generator of its own: a loop inside a loop would not advance the outer one's.
        generator = mi.PCG32(
            initstate=mi.UInt64(rng.next_uint32()),
            initseq=mi.UInt64(rng.next_uint32()) + dr.arange(mi.UInt64, 1),
        )
        radiance = trace_paths(
            self._lit, mi.Ray3f(path.origin, direction), generator, self._settings
        ).radiance
        path.radiance = dr.select(active, radiance, mi.Color3f(0.0))
        return path, direction, mi.Bool(False)


def errors(found: Views, truth: Views, second: Views | None = None) -> dict[str, Any]:
    """{"L_d": relative RMSE, "L_s0": one a roughness level, "L_s1": likewise}.

    Args:
        second: the truth with other random numbers, see :func:`relative_rmse`.
    """
    second = second or truth

    def at(k: int, term: int) -> float:
        return relative_rmse(*(views.specular[:, k, term] for views in (found, truth, second)))

    by_level = range(truth.specular.shape[1])
    return {
        "L_d": relative_rmse(found.diffuse, truth.diffuse, second.diffuse),
        "L_s0": [at(k, 0) for k in by_level],
        "L_s1": [at(k, 1) for k in by_level],
    }


def relative_rmse(found: np.ndarray, truth: np.ndarray, second: np.ndarray | None = None) -> float:
    """RMSE of display values (γ = 1/2.2, clipped at 1) over the truth's root mean square.

    Linear values would be dominated by the few pixels next to a bulb. With a `second` truth of independent
    noise, the two differences are multiplied instead of one squared, so that the truth's noise cancels.
    """
    shown, true, other = (
        np.clip(values.astype(np.float64), 0.0, 1.0) ** (1.0 / 2.2)
        for values in (found, truth, truth if second is None else second)
    )
    squared = max(float(np.mean((shown - true) * (shown - other))), 0.0)
    return float(np.sqrt(squared / max(float(np.mean(true * other)), 1e-12)))


def has_true_materials(capture: Path) -> bool:
    """Whether a capture has true materials with all of their textures."""
    if not (capture / "scene.npz").is_file() or not (capture / "materials.json").is_file():
        return False
    textures = [
        entry.get("texture") for entry in read_document(capture / "materials.json", dict)["materials"]
    ]
    return all((capture / texture).is_file() for texture in textures if texture)


def baked_errors(
    capture: Path, run: RunFolder, kept: np.ndarray, found: Mapping[str, tuple[Views, np.ndarray]], count: int
) -> dict[str, Any]:
    """Errors of baked shadings, noise included, at COMMON_LEVELS; the truth's noise cancels.

    Args:
        run: finished; with the pixel store. Mixed pixels and pixels on emitters don't count.
        kept: (M,) pixels, the rows of all `found`.
        found: by name the shadings and their (K,) roughness levels.
        count: pixels that are compared, at most.

    Returns:
        {"pixels": number, "levels": COMMON_LEVELS, name: as of :func:`errors`}.
    """
    from fipt_blender.core.capture.views import load_capture
    from fipt_blender.core.estimate.input import estimation_views
    from fipt_blender.core.textures.detail import solved_light

    captured = load_capture(run)
    pixels = solved_light(run, estimation_views(run, run.read())).pixels
    fixtures = read_document(run.emitters_json, dict)["fixtures"]
    emitting = [t for fixture in fixtures for t in fixture["triangles"]]
    triangle = np.asarray(pixels.triangle[kept])
    usable = (triangle >= 0) & np.asarray(pixels.pure[kept]) & ~np.isin(triangle, emitting)
    chosen = np.random.default_rng(0).permutation(np.flatnonzero(usable))[:count]
    levels = np.array(COMMON_LEVELS, np.float32)
    result: dict[str, Any] = {"pixels": len(chosen), "levels": list(COMMON_LEVELS)}
    if not len(chosen):
        return result
    lit = true_room(capture, captured.world_from_source)
    truths = [trace_truth(lit, run, pixels, kept[chosen], levels, seed) for seed in range(2)]
    for name, (shadings, own) in found.items():
        at_levels = Views(shadings.diffuse[chosen], interpolated(shadings.specular[chosen], own, levels))
        result[name] = errors(at_levels, truths[0], truths[1])
    return result


def interpolated(specular: np.ndarray, levels: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """(N, W, 2, 3) specular shadings at `wanted` roughness, linear between `levels` (paper Eq. 8)."""
    upper = np.clip(np.searchsorted(levels, wanted), 1, len(levels) - 1)
    t = ((wanted - levels[upper - 1]) / (levels[upper] - levels[upper - 1]))[:, None, None]
    return specular[:, upper - 1] * (1.0 - t) + specular[:, upper] * t


def format_table(result: dict[str, Any]) -> str:
    """The errors as text, one line per term and level."""
    names = [name for name in result if isinstance(result[name], dict)]
    lines = [f"{'relative RMSE, γ = 1/2.2':28s}" + "".join(f"{name:>20s}" for name in names)]
    lines.append(f"{'L_d':28s}" + "".join(f"{result[name]['L_d']:20.4f}" for name in names))
    for term in TERMS[1:]:
        for k, level in enumerate(result["levels"]):
            label = f"{term} at σ = {level:.2f}"
            lines.append(f"{label:28s}" + "".join(f"{result[name][term][k]:20.4f}" for name in names))
    lines.append(f"{result['pixels']} pixels of {', '.join(result['views'])}")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
