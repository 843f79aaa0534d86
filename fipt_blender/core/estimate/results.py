"""Results of an estimation in open formats: fields, parts, fixtures, the environment and the statistics."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
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
from ..material.hints import SurfaceHints, values_of_hints
from ..parts.labels import Parts
from ..photometry.encoded_photographs import Photometry
from ..pixels.store import PixelStore
from ..report.pictures import write_quality
from ..run.messages import Reporter, peak_memory_gb
from ..run.replacing import atomic_folder
from ..run.result_contents import EmitterEnvironment, EmitterFixture, Emitters
from ..run.run_files import LeftAlone
from ..run.runfolder import RunFolder, explained_write_errors, write_json
from ..run.store import write_arrays
from ..surface.cleaning import Holes
from ..surface.room import Room
from ..textures.detail import SolvedLight, remember_light, write_resolution
from .doubts import write_doubts
from .input import EstimationInput
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
    surface_hints: SurfaceHints
    shadings: ShadingStore
    data: TrainingData
    cells: CellEstimate
    units: Units
    probability: np.ndarray
    fixtures: list[Fixture]
    room_fields: RoomFields
    photometry: Photometry | None = None
    quality: Quality | None = None


def write_solution(
    given: EstimationInput, solution: Solution, stages: Sequence[Mapping[str, Any]], reporter: Reporter
) -> dict[str, Any]:
    """Write all results in place of earlier ones; returns the statistics.

    Args:
        stages: their facts (:meth:`..run.chain.Chain.facts`).
    """
    run, observations = given.folder, solution.observations
    pixels, room, hints = solution.pixels, solution.room, solution.surface_hints
    fields = solution.room_fields
    if solution.quality is not None:
        fields = fields.with_errors(no_better_than(fields.errors, solution.quality.deviation))
    areas = area_names(hints, solution.units)
    statistics = summary(given, solution, stages)
    with atomic_folder(run.results) as new:
        folder = RunFolder(run.root, results=new.name)
        write_results(folder, fields, solution.fixtures, observations.environment, solution.scale, reporter)
        if solution.quality is not None:
            write_quality(folder, solution.quality)
        names = write_part_list(folder, room, solution.parts, solution.views, pixels, fields, areas)
        if given.prepared.scan is not None:
            write_arrays(folder.scan_npz, given.prepared.scan)
        if observations.left_alone.any():
            write_arrays(folder.left_alone_npz, LeftAlone(observations.left_alone))
        decided = hints.of_triangles(hints.decides)
        of_triangle = np.array([*names, ""], object)[fields.units.triangle]
        write_doubts(folder, solution.data, solution.cells, solution.probability, decided, of_triangle)
        remember_light(folder, SolvedLight(pixels, solution.shadings))
        write_resolution(folder, len(room.triangles))
        write_json(folder.statistics_json, statistics)
        with explained_write_errors(folder.results):
            shutil.copyfile(run.stages_json, folder.results / run.stages_json.name)
    return statistics


def write_results(
    folder: RunFolder,
    fields: RoomFields,
    fixtures: Sequence[Fixture],
    environment: Environment | None,
    scale: float,
    reporter: Reporter,
) -> None:
    """Write the estimate and what lights the room.

    Args:
        fixtures, environment: radiance in units of the capture's median.
        scale: the capture's median radiance, in the photographs' units.
        reporter: gets the warning ``no-emitter`` if nothing lights the room.
    """
    fields.save(folder)
    described = None
    if environment is not None and environment.image.any():
        write_exr(folder.environment_exr, environment.image * scale)
        described = EmitterEnvironment(folder.environment_exr.name, environment.observed_share)
    if not fixtures and environment is None:
        reporter.warning("no-emitter")
    listed = tuple(
        _described(fixture, f"Fixture.{number:03d}", scale)
        for number, fixture in enumerate(fixtures, start=1)
    )
    missing = tuple(
        replace(lamp, radiance=(scale * np.asarray(lamp.radiance)).tolist())
        for lamp in (environment.lamps if environment is not None else ())
    )
    write_json(folder.emitters_json, Emitters(listed, described, missing))


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


def summary(
    given: EstimationInput, solution: Solution, stages: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    """The statistics of the run: times and rays of the stages, memory, counts, settings."""
    check, photometry = solution.view_check, solution.photometry
    hints = solution.surface_hints
    return {
        "stages": list(stages),
        "peak_memory_gb": round(peak_memory_gb(), 3),
        "pixels": len(solution.pixels),
        "light_resolution": given.plan.resolution,
        "expected": given.plan.cost,
        "triangles": len(solution.room.triangles),
        "fixtures": len(solution.fixtures),
        "part_kind": solution.parts.kind,
        "radiance_scale": solution.scale,
        "variant": mi.variant(),
        "views": check.facts() | {"used": len(solution.views) - len(check.left_out)},
        "settings": asdict(given.settings),
        **({"photometry": photometry.facts} if photometry else {}),
        **(_hole_facts(given.prepared.holes) if given.prepared.holes else {}),
        **({"hints": hint_facts(hints, solution.units)} if hints.names else {}),
    }


def hint_facts(hints: SurfaceHints, units: Units) -> list[dict[str, Any]]:
    """One entry per hint for the statistics: its surface, and the values that it has decided."""
    triangles = np.bincount(hints.triangle[hints.triangle >= 0], minlength=len(hints.names))
    unit = values_of_hints(hints, units.triangle)
    none = np.full((1, 2), np.nan)
    fixed = np.concatenate([none[:0] if units.fixed is None else units.fixed, none])
    fixed = fixed[np.where(unit < len(fixed) - 1, unit, -1)]
    return [
        {
            "name": name,
            "triangles": int(triangles[row]),
            "roughness": None if np.isnan(fixed[row, 0]) else round(float(fixed[row, 0]), 4),
            "metallic": None if np.isnan(fixed[row, 1]) else round(float(fixed[row, 1]), 4),
            "emits": {0: None, 1: True, -1: False}[int(hints.emits[row])],
            "left_alone": bool(hints.left_alone[row]),
        }
        for row, name in enumerate(hints.names)
    ]


def area_names(hints: SurfaceHints, units: Units) -> dict[int, str]:
    """The hints' names of the units that they have made."""
    unit = values_of_hints(hints, units.triangle)
    return {int(unit[row]): name for row, name in enumerate(hints.names) if hints.own[row] and unit[row] >= 0}


def result_files(folder: RunFolder) -> list[Path]:
    """The results in open formats that exist."""
    results = [folder.fields_npz, folder.parts_json, folder.emitters_json]
    results += [folder.environment_exr, folder.statistics_json]
    return [path for path in results if path.exists()]


def _hole_facts(holes: Holes) -> dict[str, Any]:
    return {
        "closed_holes": holes.closed,
        "closed_holes_m2": round(holes.closed_area, 4),
        "open_holes": holes.left,
        "open_holes_m2": round(holes.open_area, 4),
    }
