# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Results of an estimation in open formats: fields, parts, fixtures, the environment and the statistics."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from ..capture.images import write_exr
from ..capture.views import View
from ..checks.quality import Quality
from ..checks.view_check import ViewCheck
from ..light.baking import ShadingStore
from ..light.emitters import Fixture
from ..light.environment import Environment
from ..light.observations import Observations
from ..material.closed_form import CellEstimate, TrainingData
from ..material.confidence import no_better_than
from ..material.fields import RoomFields
from ..material.groups import Units
from ..material.hints import SurfaceHints
from ..parts.labels import Parts
from ..photometry.encoded_photographs import Photometry
from ..pixels.store import PixelStore
from ..report.pictures import write_quality
from ..run.light_size import LightPlan
from ..run.messages import Reporter, peak_memory_gb
from ..run.replacing import atomic_folder
from ..run.result_contents import EmitterEnvironment, EmitterFixture, Emitters, MissingLamp
from ..run.run_files import ScanHoles
from ..run.runfolder import RunFolder, explained_write_errors, write_json
from ..run.settings import Settings
from ..surface.room import Room
from ..textures.detail import SolvedLight, remember_light, write_resolution
from .doubts import write_doubts
from .hinted import area_names, hint_facts, write_left_alone
from .part_list import write_part_list


@dataclass(frozen=True)
class Solution:
    """The outputs of the stages from which results are written; fields as of the stages."""

    room: Room
    views: list[View]
    pixels: PixelStore
    parts: Parts
    scale: float
    view_check: ViewCheck
    observations: Observations
    surface_hints: SurfaceHints | None
    shadings: ShadingStore
    levels: np.ndarray
    data: TrainingData
    cells: CellEstimate
    units: Units
    probability: np.ndarray
    fixtures: list[Fixture]
    room_fields: RoomFields
    photometry: Photometry | None = None
    quality: Quality | None = None


@dataclass(frozen=True)
class RunFacts:
    """What the statistics say beside the solution: of the plan, the scan, the settings and the stages."""

    plan: LightPlan
    holes: ScanHoles | None
    settings: Settings
    stages: Sequence[Mapping[str, Any]]


@dataclass(frozen=True)
class RoomLight:
    """What lights the room; radiance in units of the capture's median.

    Attributes:
        fixtures: lamps on the mesh.
        environment: light from outside the mesh, if any.
    """

    fixtures: Sequence[Fixture]
    environment: Environment | None


def write_solution(run: RunFolder, solution: Solution, facts: RunFacts, reporter: Reporter) -> dict[str, Any]:
    """Write all results in place of earlier ones; returns the statistics.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    observations, pixels, room = solution.observations, solution.pixels, solution.room
    left_alone = observations.left_alone
    fields = solution.room_fields
    if solution.quality is not None:
        fields = fields.with_errors(no_better_than(fields.errors, solution.quality.deviation))
    light = RoomLight(solution.fixtures, observations.environment)
    areas = area_names(solution.surface_hints, solution.units)
    statistics = summary(solution, facts)
    with atomic_folder(run.results) as new:
        folder = RunFolder(run.root, results=new.name)
        write_results(folder, fields, light, solution.scale, reporter)
        if solution.quality is not None:
            write_quality(folder, solution.quality)
        names = write_part_list(folder, room, solution.parts, solution.views, pixels, fields, areas)
        write_left_alone(folder, left_alone)
        decided = np.zeros((len(room.triangles), 3), bool)
        if solution.surface_hints is not None:
            decided = solution.surface_hints.of_triangles(solution.surface_hints.decides)
        of_triangle = np.array([*names, ""], object)[fields.units.triangle]
        write_doubts(folder, solution.data, solution.cells, solution.probability, decided, of_triangle)
        remember_light(folder, SolvedLight(pixels, solution.shadings, solution.levels))
        write_resolution(folder, len(room.triangles))
        write_json(folder.statistics_json, statistics)
        with explained_write_errors(folder.results):
            shutil.copyfile(run.stages_json, folder.results / run.stages_json.name)
    return statistics


def write_results(
    folder: RunFolder, fields: RoomFields, light: RoomLight, scale: float, reporter: Reporter
) -> None:
    """Write the results folder except for the statistics.

    Args:
        scale: the capture's median radiance, in the photographs' units.
        reporter: gets the warning ``no-emitter`` if nothing lights the room.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    fields.save(folder)
    environment, described = light.environment, None
    if environment is not None and environment.image.any():
        write_exr(folder.environment_exr, environment.image * scale)
        described = EmitterEnvironment(folder.environment_exr.name, environment.observed_share)
    if not light.fixtures and environment is None:
        reporter.warning(
            "no-emitter",
            "No surface was found to emit light, and no view looks outside.",
            "Check that the photographs show the lamps and that the lamps are not over-exposed.",
        )
    fixtures = tuple(
        _described(fixture, f"Fixture.{number:03d}", scale)
        for number, fixture in enumerate(light.fixtures, start=1)
    )
    missing = tuple(
        MissingLamp(
            lamp["position"],
            lamp["radius"],
            (scale * np.asarray(lamp["radiance"])).tolist(),
            lamp.get("inferred", False),
            lamp.get("facing"),
            lamp.get("share", 0.0),
        )
        for lamp in (environment.lamps if environment is not None else ())
    )
    write_json(folder.emitters_json, Emitters(fixtures, described, missing))


def _described(fixture: Fixture, name: str, scale: float) -> EmitterFixture:
    """A fixture's entry in emitters.json, in the photographs' units; power: pi A L of both sides (watts)."""
    front, back = fixture.radiance * scale, fixture.back_radiance * scale
    return EmitterFixture(
        name=name,
        triangles=fixture.triangles.tolist(),
        radiance=front.tolist(),
        back_radiance=back.tolist(),
        area=fixture.area,
        centroid=fixture.centroid.tolist(),
        power=(np.pi * fixture.area * (front + back)).tolist(),
        probability=round(fixture.probability, 3),
    )


def summary(solution: Solution, facts: RunFacts) -> dict[str, Any]:
    """The statistics of the run: times and rays of the stages, memory, counts, settings."""
    check, photometry = solution.view_check, solution.photometry
    hints = solution.surface_hints
    return {
        "stages": list(facts.stages),
        "peak_memory_gb": round(peak_memory_gb(), 3),
        "pixels": len(solution.pixels),
        "light_resolution": facts.plan.resolution,
        "expected": facts.plan.cost,
        "triangles": len(solution.room.triangles),
        "fixtures": len(solution.fixtures),
        "part_kind": solution.parts.kind,
        "radiance_scale": solution.scale,
        "variant": mi.variant(),
        "views": check.facts() | {"used": len(solution.views) - len(check.left_out)},
        "settings": asdict(facts.settings),
        **({"photometry": photometry.facts} if photometry else {}),
        **(_hole_facts(facts.holes) if facts.holes else {}),
        **({"hints": hint_facts(hints, solution.units)} if hints else {}),
    }


def result_files(folder: RunFolder) -> list[Path]:
    """The results in open formats that exist."""
    results = [folder.fields_npz, folder.parts_json, folder.emitters_json]
    results += [folder.environment_exr, folder.statistics_json]
    return [path for path in results if path.exists()]


def _hole_facts(holes: ScanHoles) -> dict[str, Any]:
    return {
        "closed_holes": holes.closed,
        "closed_holes_m2": round(holes.closed_area, 4),
        "open_holes": holes.left,
        "open_holes_m2": round(holes.open_area, 4),
    }
