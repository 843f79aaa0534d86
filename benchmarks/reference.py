# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's algorithm with its authors' sample counts on the engine's kernels: the reference for speed.

Ratios to it thus compare algorithms, not implementations. Known defects of the authors' code (densities mixed
in the weights of stage 3, black voxels, hash grid positions below zero) are not reproduced: they change
results, not times. Mitsuba's variant must be set before this module is imported.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from benchmarks.shading_error import shading_points
from fipt_blender.core.checks.view_check import ViewCheck
from fipt_blender.core.device.variant import torch_device
from fipt_blender.core.estimate.judge_stages import find_room_fields
from fipt_blender.core.estimate.light_stages import BakedShadings, infer_outside, observe_pixels
from fipt_blender.core.estimate.material_stages import fit_closed_form, honour_hints
from fipt_blender.core.estimate.pixel_stages import TraceInputs, parts_of
from fipt_blender.core.estimate.training_stages import TrainedFields
from fipt_blender.core.light.baking import CHUNK, HALF_LARGEST, ShadingStore, open_shadings
from fipt_blender.core.light.cache import SurfaceLookup, pool
from fipt_blender.core.light.emitters import EmitterPixels, Fixture, emitter_table, side_medians
from fipt_blender.core.light.environment import Environment
from fipt_blender.core.light.observations import Observations
from fipt_blender.core.light.radiance import CachedRadiance, OutsideRadiance, RadianceSource, TracedRadiance
from fipt_blender.core.light.shadings import (
    SampleCounts,
    ShadingPoints,
    Shadings,
    bake,
    roughness_levels,
)
from fipt_blender.core.material import losses
from fipt_blender.core.material.emission_mask import EmissionNetwork, emission_mask, mask_at
from fipt_blender.core.material.fields import RoomFields
from fipt_blender.core.material.groups import Units, part_units
from fipt_blender.core.material.inference import Fields
from fipt_blender.core.material.networks import BrdfNetwork, Prediction
from fipt_blender.core.material.seen import Box, find_seen_cells, room_box
from fipt_blender.core.optics.lights import AreaLights, EmitterTable
from fipt_blender.core.parts.labels import Parts
from fipt_blender.core.pixels.store import PixelStore, fill_pixels, open_pixels
from fipt_blender.core.run.chain import Stage, Tools
from fipt_blender.core.run.settings import Settings, make_settings
from fipt_blender.core.run.stage_settings import (
    NetworkSettings,
    NoSettings,
    RefinementSettings,
    ShadingSettings,
    TrainingSettings,
)
from fipt_blender.core.surface.room import Room, triangle_normals

# A triangle is an emitter if its mean mask at so many points is above the threshold (paper, Sec. 4.4).
EMITTER_THRESHOLD, EMITTER_SAMPLES = 0.01, 100
# The authors' code: 6 linear levels; 256 cosine rays and 64 + 5 x 128 visible-normal ones, then 128 and
# 6 x 64; three trainings, each anew. Two of their epochs would be too few steps on small captures, so the
# steps are those that they take on their own ones.
AUTHORS: dict[str, Any] = {
    "rounds": 2,
    "masking": "schlick",
    "voxel_resolution": 256,
    "roughness_levels": 6,
    "roughness_spacing": 1.0,
    "roughness_min": 0.02,
    "diffuse_spp": 256,
    "specular_spp": 128,
    "refine_diffuse_spp": 128,
    "refine_specular_spp": 64,
    "refine_depth": 5,
    "refine_cache": True,
    "cache_roughness": 0.6,
    "training_steps": 10_000,
    "batch_size": 8192,
    "learning_rate": 1e-3,
    "lambda_diffuse": 5e-4,
    "lambda_part": 5e-3,
    "lambda_semantic": 1e-3,
    "sigma_albedo": 0.05 / 3.0,
    "sigma_position": 0.3 / 3.0,
    "hash_levels": 32,
    "hash_features": 2,
    "hash_log2_size": 19,
    "hash_base_resolution": 16,
    "hash_growth": 1.3,
    "brdf_width": 64,
    "brdf_depth": 2,
    "denoise": False,
    "denoise_specular": False,
    "reject_views": False,
    "correct_exposure": False,
}
_SAMPLES = ("diffuse_spp", "specular_spp", "refine_diffuse_spp", "refine_specular_spp")
# Added to the weight of each pixel in sigma' and m' (authors' code; Eq. 19 leaves groups without highlights
# undefined).
LEAST_WEIGHT = 1e-4
_PARTNERS = 1024


def reference_settings(steps: int, samples: float, changes: dict[str, Any]) -> Settings:
    """Settings of the reference.

    Args:
        steps: of each training.
        samples: share of the authors' sample counts, for quick looks; at least one sample each remains.
        changes: of other settings, such as seed and view_share.

    Raises:
        FiptError: ``setting-unknown`` or ``setting-invalid``.
    """
    counts = {name: max(1, round(AUTHORS[name] * samples)) for name in _SAMPLES}
    return make_settings("high", {**AUTHORS, **counts, "training_steps": steps, **changes})


def bake_apart(
    points: ShadingPoints,
    source: RadianceSource,
    levels: np.ndarray,
    diffuse: int,
    specular: Sequence[int],
    seed: int,
) -> Shadings:
    """L_d from cosine samples only, and each roughness level from its visible-normal samples only.

    Args:
        levels: (K,) roughness levels.
        diffuse: samples per point for L_d.
        specular: samples per point for each level.
    """
    no_lights = AreaLights(np.zeros((0, 3)), np.zeros((0, 3), np.int64), EmitterTable.empty())
    streams = (seed * 1009 + k for k in range(len(levels) + 1))
    first = bake(points, source, no_lights, levels[:0], SampleCounts(diffuse, 0, 0), next(streams))
    lobes = [
        bake(points, source, no_lights, levels[k : k + 1], SampleCounts(0, count, 0), next(streams)).specular
        for k, count in enumerate(specular)
    ]
    return Shadings(first.diffuse, np.concatenate(lobes, axis=1))


@dataclass
class Batch:
    """Pixels to train on, as tensors: (N, 3) positions in the unit cube, radiance, (N,) part, shadings."""

    position: torch.Tensor
    radiance: torch.Tensor
    part: torch.Tensor
    diffuse: torch.Tensor
    specular: torch.Tensor


class PaperNetwork(BrdfNetwork):
    """MLP_brdf as in the paper: it knows nothing of units, and starts anywhere."""

    def __init__(
        self, settings: NetworkSettings, levels: int, generator: torch.Generator, device: torch.device
    ) -> None:
        super().__init__(settings, levels, np.full((1, 5), 0.5), generator, device)

    def forward(self, positions: torch.Tensor, units: torch.Tensor | None = None) -> Prediction:
        """Evaluate at (N, 3) positions in [0, 1]."""
        return super().forward(positions, torch.full_like(positions[:, 0], -1, dtype=torch.int64))


def batch_means(values: torch.Tensor, weight: torch.Tensor, part: torch.Tensor) -> torch.Tensor:
    """(N, C) weighted mean of the values over the batch's pixels of the same part (paper Eq. 19).

    Args:
        values: (N, C).
        weight: (N,) w of Eq. 19, without gradient.
        part: (N,) int64; negative ids make a group of their own.
    """
    _, group = torch.unique(part, return_inverse=True)
    count = int(group.max()) + 1
    total = torch.zeros(count, device=values.device).index_add_(0, group, weight)
    sums = torch.zeros((count, values.shape[1]), device=values.device)
    sums = sums.index_add(0, group, values * weight[:, None])
    return (sums / total[:, None])[group]


def masked_triangles(
    room: Room,
    mask: Callable[[np.ndarray], np.ndarray],
    threshold: float,
    samples: int,
    rng: np.random.Generator,
) -> np.ndarray:
    """(T,) bool, triangles whose mean emission mask over random points exceeds the threshold.

    Args:
        mask: (N, 3) world positions to (N,) alpha.
        samples: points per triangle.
    """
    marked = np.zeros(len(room.triangles), bool)
    asked = np.arange(len(marked))
    for start in range(0, len(asked), 4096):
        chunk = asked[start : start + 4096]
        u, v = rng.random((2, len(chunk), samples), dtype=np.float32)
        alpha = mask(room.points_on(chunk[:, None], u, v).reshape(-1, 3))
        marked[chunk] = alpha.reshape(-1, samples).mean(axis=1) > threshold
    return marked


def reference_loss(
    brdf: PaperNetwork,
    emission: EmissionNetwork,
    batch: Batch,
    levels: torch.Tensor,
    part_kind: str,
    settings: TrainingSettings,
    partners: torch.Tensor,
) -> torch.Tensor:
    """l + l_e + l_d + l_p of one batch, sigma' and m' being the batch's means (paper Eq. 15 to 20)."""
    prediction = brdf(batch.position)
    raw = emission(batch.position)
    kd, ks = losses.reflectances(prediction)
    s0, s1 = losses.interpolate_specular(batch.specular, prediction.roughness, levels)
    highlight = ks * s0 + s1
    loss = losses.rendering_loss(kd * batch.diffuse + highlight, emission_mask(raw), batch.radiance)
    loss = loss + settings.lambda_emission * losses.emission_loss(raw)
    loss = loss + settings.lambda_diffuse * losses.diffuse_loss(prediction)
    if part_kind == "part":
        weight = highlight.detach().abs().sum(dim=1) + LEAST_WEIGHT
        values = torch.stack([prediction.roughness, prediction.metallic], dim=1)
        distance = (values - batch_means(values, weight, batch.part)).abs().sum(dim=1)
        loss = loss + settings.lambda_part * (distance * (batch.part >= 0)).mean()
    elif part_kind == "semantic":
        loss = loss + settings.lambda_semantic * losses.semantic_loss(
            prediction,
            batch.position,
            batch.part,
            partners,
            settings.sigma_albedo,
            settings.sigma_position,
        )
    return loss


@dataclass(frozen=True)
class ReferencePixels:
    """Pixels at their centres, of which none counts as mixed, and no view is checked."""

    pixels: PixelStore
    parts: Parts
    scale: float
    view_check: ViewCheck


def trace_centres(inputs: TraceInputs, settings: NoSettings, tools: Tools) -> ReferencePixels:
    """Intersect the pixels' centres with the mesh."""
    pixels = open_pixels(tools.folder, inputs.views, create=True)
    scale = fill_pixels(pixels, inputs.room, tools.reporter.progress)
    pixels.pure[:] = np.asarray(pixels.triangle) >= 0
    pixels.own[:], pixels.weight[:] = pixels.radiance, pixels.pure
    tools.facts["rays"] = len(pixels)
    return ReferencePixels(pixels, parts_of(inputs.room, pixels), scale, ViewCheck())


@dataclass(frozen=True)
class ReferenceShadingInputs:
    """What stage 1 bakes with."""

    pixels: PixelStore
    room: Room
    observed: Observations
    environment: Environment | None


def bake_reference(inputs: ReferenceShadingInputs, settings: ShadingSettings, tools: Tools) -> BakedShadings:
    """Stage 1: every ray ends in the cache of all photographs, lamps included, which is never updated."""
    source = CachedRadiance(inputs.room, _cache(inputs.observed), _outside(inputs.environment))
    specular = [settings.specular_spp] * settings.roughness_levels
    specular[0] = max(1, settings.specular_spp // 2)
    return _bake_pixels(inputs, source, settings.diffuse_spp, specular, settings, 0, tools)


@dataclass(frozen=True)
class ReferenceRefinementInputs(ReferenceShadingInputs):
    """What stage 3 traces paths with."""

    index: int
    emitters: EmitterTable
    units: Units
    fields: Fields
    box: Box


def refine_reference(
    inputs: ReferenceRefinementInputs, settings: RefinementSettings, tools: Tools
) -> BakedShadings:
    """Stage 3: paths end in the cache at rough surfaces."""
    room, observed = inputs.room, inputs.observed
    places = observed.places(room, np.random.default_rng([settings.seed, 4]))
    values = _material_values(inputs, observed, places)
    source = TracedRadiance(
        room,
        _cache(observed),
        SurfaceLookup(observed.grid, values),
        None,
        AreaLights(room.vertices, room.triangles, inputs.emitters),
        _outside(inputs.environment),
        settings.cache_roughness,
        settings.refine_depth,
    )
    specular = [settings.refine_specular_spp] * settings.roughness_levels
    return _bake_pixels(inputs, source, settings.refine_diffuse_spp, specular, settings, inputs.index, tools)


def _cache(observed: Observations) -> SurfaceLookup:
    return SurfaceLookup(observed.grid, observed.cache())


def _outside(environment: Environment | None) -> OutsideRadiance | None:
    return None if environment is None else OutsideRadiance(environment)


def _bake_pixels(
    inputs: ReferenceShadingInputs,
    source: RadianceSource,
    diffuse: int,
    specular: list[int],
    settings: ShadingSettings | RefinementSettings,
    index: int,
    tools: Tools,
) -> BakedShadings:
    """Bake every pixel that sees the mesh, chunk by chunk."""
    room, pixels, seed = inputs.room, inputs.pixels, settings.seed * 31 + 1 + index
    levels = roughness_levels(settings.roughness_levels, settings.roughness_min, settings.roughness_spacing)
    store = open_shadings(tools.folder, len(pixels), len(levels), create=True)
    normals = triangle_normals(room.vertices, room.triangles).astype(np.float32)
    hit = np.flatnonzero(np.asarray(pixels.triangle) >= 0)
    for start in range(0, len(hit), CHUNK):
        rows = hit[start : start + CHUNK]
        points = shading_points(pixels, rows, normals)
        found = bake_apart(points, source, levels, diffuse, specular, seed * 100003 + start)
        store.diffuse[rows] = found.diffuse.clip(0.0, HALF_LARGEST)
        store.specular[rows] = found.specular.clip(0.0, HALF_LARGEST)
        tools.reporter.progress((start + len(rows)) / len(hit))
    tools.facts["rays"] = len(hit) * (diffuse + sum(specular))
    return BakedShadings(store, levels, np.zeros(len(room.triangles), bool))


def _material_values(
    inputs: ReferenceRefinementInputs,
    observed: Observations,
    places: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> np.ndarray:
    """(M * 6, 5) base colour, roughness and metallic of each cache entry, by the network."""
    entries, points, triangles = places
    cells = find_seen_cells(inputs.pixels, inputs.units, inputs.box)
    fields, seen = RoomFields(inputs.fields, inputs.units, cells), triangles < 0
    values = np.empty((len(entries), 5), np.float32)
    values[seen] = fields.fields.query(points[seen], np.full(int(seen.sum()), -1))
    values[~seen] = np.column_stack(fields.query(points[~seen], triangles[~seen]))
    return pool(observed.grid, entries, values)[0]


@dataclass(frozen=True)
class ReferenceTrainingInputs:
    """Pixels and shadings; `emitting` (T,) bool of the first round, None in it."""

    pixels: PixelStore
    room: Room
    parts: Parts
    shadings: ShadingStore
    levels: np.ndarray
    number: int
    emitting: np.ndarray | None = None
    fixtures: list[Fixture] | None = None


@dataclass(frozen=True)
class ReferenceEstimate:
    """Trained networks, and the lamps, which the paper finds once."""

    brdf: dict[str, np.ndarray]
    units: Units
    probability: np.ndarray
    fixtures: list[Fixture]
    emitters: EmitterTable
    emitting: np.ndarray


def train_reference(
    inputs: ReferenceTrainingInputs, settings: TrainingSettings, tools: Tools
) -> ReferenceEstimate:
    """Stage 2, anew in each round."""
    generator = torch.Generator().manual_seed(settings.seed + inputs.number)
    device, box = torch.device(torch_device()), room_box(inputs.room.bounds)
    brdf = PaperNetwork(settings, settings.hash_levels, generator, device)
    mask = EmissionNetwork(generator, device)
    _optimise(brdf, mask, inputs, settings, tools.reporter.progress)
    fixtures = inputs.fixtures
    if fixtures is None:
        marked = masked_triangles(
            inputs.room,
            lambda positions: mask_at(mask, box, positions),
            EMITTER_THRESHOLD,
            EMITTER_SAMPLES,
            np.random.default_rng([settings.seed, 3, 0]),
        )
        fixtures = _triangle_fixtures(inputs.room, inputs.pixels, marked)
    emitting = np.zeros(len(inputs.room.triangles), bool)
    emitting[emitter_table(fixtures).triangles] = True
    tools.facts.update(steps=settings.training_steps, hash_levels=settings.hash_levels)
    weights = {key: tensor.cpu().numpy() for key, tensor in brdf.state_dict().items()}
    # Nothing is shrunk towards its part: only the product does that.
    units = part_units(inputs.parts)
    units = replace(units, single=np.zeros_like(units.single))
    probability = emitting.astype(np.float32)
    return ReferenceEstimate(weights, units, probability, fixtures, emitter_table(fixtures), emitting)


def _optimise(
    brdf: PaperNetwork,
    mask: EmissionNetwork,
    inputs: ReferenceTrainingInputs,
    settings: TrainingSettings,
    progress: Callable[[float], None],
) -> None:
    """Adam on random pixels; both networks change in place."""
    device, pixels, store = brdf.typical.device, inputs.pixels, inputs.shadings
    box, steps = room_box(inputs.room.bounds), settings.training_steps
    parameters = [*brdf.parameters(), *mask.parameters()]
    optimiser = torch.optim.Adam(parameters, lr=settings.learning_rate, fused=True)
    levels = torch.tensor(inputs.levels).to(device)
    part = inputs.parts.triangle_part[np.asarray(pixels.triangle)]  # only hits are looked up
    hit = np.flatnonzero(np.asarray(pixels.triangle) >= 0)
    rng = np.random.default_rng([settings.seed, 5, inputs.number])
    size = min(settings.batch_size, len(hit))
    for step in range(steps):
        rows = np.sort(hit[rng.integers(0, len(hit), size)])  # files read in order
        batch = Batch(
            *(
                torch.from_numpy(values).to(device)
                for values in (
                    box.normalise(np.asarray(pixels.position[rows])),
                    np.asarray(pixels.radiance[rows]),
                    part[rows].astype(np.int64),
                    store.diffuse[rows].astype(np.float32),
                    store.specular[rows].astype(np.float32),
                )
            )
        )
        partners = torch.from_numpy(rng.integers(0, size, min(_PARTNERS, size))).to(device)
        loss = reference_loss(brdf, mask, batch, levels, inputs.parts.kind, settings, partners)
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        optimiser.step()
        progress((step + 1) / steps)


def _triangle_fixtures(room: Room, pixels: PixelStore, emitting: np.ndarray) -> list[Fixture]:
    """A fixture per triangle, with the median radiance of its pixels; black ones are dropped."""
    ids = np.flatnonzero(emitting)
    emitter = np.full(len(emitting), -1, np.int64)
    emitter[ids] = np.arange(len(ids))
    medians, _ = side_medians(EmitterPixels.of(pixels), emitter)
    middle = room.vertices[room.triangles].mean(axis=1)
    return [
        Fixture(np.array([t]), front, back, float(room.areas[t]), middle[t])
        for t, (front, back) in zip(ids[: len(medians)], medians, strict=True)
        if max(front.max(), back.max()) > 0.0 and room.areas[t] > 0.0
    ]


@dataclass(frozen=True)
class ReferenceFieldInputs:
    """Weights of the last training."""

    room: Room
    brdf: dict[str, np.ndarray]


def reference_fields(inputs: ReferenceFieldInputs, settings: NetworkSettings, tools: Tools) -> TrainedFields:
    """The materials of the last training."""
    box = room_box(inputs.room.bounds)
    device = torch.device(torch_device())
    network = PaperNetwork(settings, settings.hash_levels, torch.Generator(), device)
    network.load_state_dict({key: torch.from_numpy(np.array(array)) for key, array in inputs.brdf.items()})
    return TrainedFields(Fields(network, box), box)


def reference_pipeline(rounds: int) -> list[Stage]:
    """The paper's stages: all pixels at their centres, no emitter guide, no pretraining, no correction."""
    stages = [
        Stage("pixels", trace_centres, "Tracing pixels", 0.5),
        Stage("observed", observe_pixels),
        Stage("outside", infer_outside, "Finding the environment", 0.05),
        Stage("hints", honour_hints),
        Stage("shadings", bake_reference, "Baking shadings", 1.0),
    ]
    for index in range(rounds + 1):
        if index:
            takes, before = (
                {"index": f"round_{index}"},
                f"refinement-{index - 1}" if index > 1 else "shadings",
            )
            stages.append(Stage(f"refinement-{index}", refine_reference, "Refining", 1.6, takes, before))
        takes = {"number": f"round_{index}"}
        stages.append(Stage(f"estimate-{index}", train_reference, "Training", 1.2, takes))
        stages.append(Stage(f"fields-{index}", reference_fields))
    return [*stages, Stage("closed-form", fit_closed_form), Stage("room-fields", find_room_fields)]
