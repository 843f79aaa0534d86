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
from fipt_blender.core.estimate.stages import Estimation
from fipt_blender.core.light.baking import CHUNK, HALF_LARGEST
from fipt_blender.core.light.cache import SurfaceLookup, pool
from fipt_blender.core.light.emitters import EmitterPixels, Fixture, emitter_table, side_medians
from fipt_blender.core.light.radiance import CachedRadiance, OutsideLight, RadianceSource, TracedRadiance
from fipt_blender.core.light.shadings import SampleCounts, ShadingPoints, Shadings, bake
from fipt_blender.core.material import losses
from fipt_blender.core.material.emission_mask import EmissionNetwork, emission_mask, mask_at
from fipt_blender.core.material.fields import RoomFields
from fipt_blender.core.material.groups import part_units
from fipt_blender.core.material.networks import BrdfNetwork, Prediction
from fipt_blender.core.material.training import Networks
from fipt_blender.core.optics.lights import AreaLights, EmitterTable
from fipt_blender.core.pixels.store import fill_pixels, open_pixels
from fipt_blender.core.run.settings import Settings, make_settings
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
        self, settings: Settings, levels: int, generator: torch.Generator, device: torch.device
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
    settings: Settings,
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


class ReferenceEstimation(Estimation):
    """The paper's stages: all pixels at their centres, no emitter guide, no pretraining, no correction."""

    # Pixels

    def _trace(self) -> dict[str, Any]:
        self.pixels = open_pixels(self.folder.stage / "pixels", self.views, create=True)
        self.scale = fill_pixels(self.pixels, self.room, self.reporter.progress)
        self.pixels.pure[:] = np.asarray(self.pixels.triangle) >= 0  # no pixel counts as mixed
        self.pixels.own[:], self.pixels.weight[:] = self.pixels.radiance, self.pixels.pure
        self.parts = self._choose_parts()
        self.view_check = ViewCheck()
        self.checkpoints.remember("scale", self.scale)
        self.checkpoints.remember("view_check", self.view_check.facts())
        return {"rays": len(self.pixels)}

    def _prepare(self) -> None:
        super()._prepare()
        self.hit = np.flatnonzero(np.asarray(self.pixels.triangle) >= 0)
        # Nothing is shrunk towards its part: only the product does that.
        units = part_units(self.parts)
        self._find_cells(replace(units, single=np.zeros_like(units.single)))
        self._new_networks(0)

    def _new_networks(self, index: int) -> None:
        generator = torch.Generator().manual_seed(self.settings.seed + index)
        self.brdf = PaperNetwork(self.settings, self.settings.hash_levels, generator, self.device)
        self.mask = EmissionNetwork(generator, self.device)

    def _show(self, name: str) -> None:
        """No previews."""

    # Stages 1 and 3

    def _bake(self) -> dict[str, Any]:
        settings = self.settings
        source = CachedRadiance(self.room, self._cache(), self._outside())
        specular = [settings.specular_spp] * len(self.levels)
        specular[0] = max(1, settings.specular_spp // 2)
        return self._bake_pixels(source, settings.diffuse_spp, specular, settings.seed * 31 + 1)

    def _refine(self, name: str, index: int) -> dict[str, Any]:
        settings = self.settings
        source = TracedRadiance(
            self.room,
            self._cache(),
            SurfaceLookup(self.observations.grid, self._material_values()),
            None,
            AreaLights(self.room.vertices, self.room.triangles, emitter_table(self.fixtures)),
            self._outside(),
            settings.cache_roughness,
            settings.refine_depth,
        )
        specular = [settings.refine_specular_spp] * len(self.levels)
        return self._bake_pixels(
            source, settings.refine_diffuse_spp, specular, settings.seed * 31 + 1 + index
        )

    def _cache(self) -> SurfaceLookup:
        """The cache of all photographs, lamps included; the paper never updates it."""
        return SurfaceLookup(self.observations.grid, self.observations.cache())

    def _outside(self) -> OutsideLight | None:
        environment = self.observations.environment
        return None if environment is None else OutsideLight(environment)

    def _bake_pixels(
        self, source: RadianceSource, diffuse: int, specular: list[int], seed: int
    ) -> dict[str, Any]:
        """Bake every pixel that sees the mesh, chunk by chunk."""
        store = self._open_shadings(create=True)
        normals = triangle_normals(self.room.vertices, self.room.triangles).astype(np.float32)
        hit = self.hit
        for start in range(0, len(hit), CHUNK):
            rows = hit[start : start + CHUNK]
            points = shading_points(self.pixels, rows, normals)
            found = bake_apart(points, source, self.levels, diffuse, specular, seed * 100003 + start)
            store.diffuse[rows] = found.diffuse.clip(0.0, HALF_LARGEST)
            store.specular[rows] = found.specular.clip(0.0, HALF_LARGEST)
            self.reporter.progress((start + len(rows)) / len(hit))
        return {"rays": len(hit) * (diffuse + sum(specular))}

    def _material_values(self) -> np.ndarray:
        """(M * 6, 5) base colour, roughness and metallic of each cache entry, by the network."""
        entries, points, triangles = self._places
        fields, seen = RoomFields(self._fields(), self.units, self.cells), triangles < 0
        values = np.empty((len(entries), 5), np.float32)
        none = np.full(int(seen.sum()), -1)
        values[seen] = fields.fields.query(points[seen], none)
        values[~seen] = np.column_stack(fields.query(points[~seen], triangles[~seen]))
        return pool(self.observations.grid, entries, values)[0]

    # Stage 2, in each round

    def _estimate(self, name: str, refined: bool) -> dict[str, Any]:
        index = int(name.rpartition("-")[2])
        self._new_networks(index)
        self._optimise(index, self.settings.training_steps, self.reporter.progress)
        if index == 0:  # the paper's emitters are found once
            self._group_fixtures(self._masked_triangles())
        return {"steps": self.settings.training_steps, "hash_levels": self.settings.hash_levels}

    def _train(self) -> dict[str, Any]:
        """Nothing is left to do after the last round."""
        self._save_networks("training", Networks(self.brdf, self.mask))
        return {}

    def _optimise(self, index: int, steps: int, progress: Callable[[float], None]) -> None:
        """Adam on random pixels; both networks change in place."""
        settings = self.settings
        parameters = [*self.brdf.parameters(), *self.mask.parameters()]
        optimiser = torch.optim.Adam(parameters, lr=settings.learning_rate, fused=True)
        levels = torch.from_numpy(self.levels).to(self.device)
        part = self.parts.triangle_part[np.asarray(self.pixels.triangle)]  # only hits are looked up
        store = self._open_shadings()
        rng = np.random.default_rng([settings.seed, 5, index])
        size = min(settings.batch_size, len(self.hit))
        for step in range(steps):
            rows = np.sort(self.hit[rng.integers(0, len(self.hit), size)])  # files read in order
            batch = Batch(
                *(
                    torch.from_numpy(values).to(self.device)
                    for values in (
                        self.box.normalise(np.asarray(self.pixels.position[rows])),
                        np.asarray(self.pixels.radiance[rows]),
                        part[rows].astype(np.int64),
                        store.diffuse[rows].astype(np.float32),
                        store.specular[rows].astype(np.float32),
                    )
                )
            )
            partners = torch.from_numpy(rng.integers(0, size, min(_PARTNERS, size))).to(self.device)
            loss = reference_loss(self.brdf, self.mask, batch, levels, self.parts.kind, settings, partners)
            optimiser.zero_grad(set_to_none=True)
            loss.backward()
            optimiser.step()
            progress((step + 1) / steps)

    def _masked_triangles(self) -> np.ndarray:
        """(T,) bool, triangles whose mean mask is above the threshold, without any further test."""
        return masked_triangles(
            self.room,
            lambda positions: mask_at(self.mask, self.box, positions),
            EMITTER_THRESHOLD,
            EMITTER_SAMPLES,
            np.random.default_rng([self.settings.seed, 3, 0]),
        )

    def _group_fixtures(self, emitting: np.ndarray) -> None:
        """A fixture per triangle, with the median radiance of its pixels; black ones are dropped."""
        ids = np.flatnonzero(emitting)
        emitter = np.full(len(emitting), -1, np.int64)
        emitter[ids] = np.arange(len(ids))
        medians, _ = side_medians(EmitterPixels.of(self.pixels), emitter)
        middle = self.room.vertices[self.room.triangles].mean(axis=1)
        self.fixtures = [
            Fixture(np.array([t]), front, back, float(self.room.areas[t]), middle[t])
            for t, (front, back) in zip(ids[: len(medians)], medians, strict=True)
            if max(front.max(), back.max()) > 0.0 and self.room.areas[t] > 0.0
        ]
