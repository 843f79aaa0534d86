# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The stages after the last training: the estimate on all surfaces, and how good it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..capture.views import View
from ..checks.quality import Quality, judge
from ..checks.rerender import Estimate
from ..light.emitters import Fixture, emitter_table
from ..light.lamp_doubt import HardlySeen, hardly_seen, light_errors, power_errors
from ..light.observations import Observations
from ..material.cell_errors import DrawnPixels, add_light_errors, cell_errors, draw_pixels, lit_cells
from ..material.closed_form import TrainingData
from ..material.fields import RoomFields
from ..material.groups import Units
from ..material.inference import Fields
from ..material.part_colors import room_detail
from ..material.seen import Box, SeenCells, find_seen_cells
from ..photometry.encoded_photographs import Photometry
from ..pixels.store import PixelStore
from ..report.fixture_names import fixture_names
from ..run.chain import Tools
from ..run.messages import Reporter
from ..run.stage_settings import ResultSettings, Seeded
from ..surface.room import Room


@dataclass(frozen=True)
class RoomFieldInputs:
    """The trained fields, and the pixels by which they are judged; fields as of the other stages."""

    room: Room
    pixels: PixelStore
    observations: Observations
    data: TrainingData
    units: Units
    fixtures: list[Fixture]
    emitting: np.ndarray
    fields: Fields
    box: Box


@dataclass(frozen=True)
class EstimatedRoom:
    """Materials on seen and unseen surfaces, and their errors."""

    room_fields: RoomFields


def find_room_fields(inputs: RoomFieldInputs, settings: ResultSettings, tools: Tools) -> EstimatedRoom:
    """The estimate on all surfaces, from the pixels of all triangles that reflect and are not left alone."""
    units, box, data, fields = inputs.units, inputs.box, inputs.data, inputs.fields
    left_alone = inputs.observations.left_alone
    unused = inputs.emitting if left_alone is None else inputs.emitting | left_alone
    cells = find_seen_cells(inputs.pixels, units, box)
    drawn = draw_pixels(inputs.pixels, units, box, cells, unused, settings.seed)
    errors = _cell_errors(inputs, cells, drawn, settings, tools.reporter)
    detail = None
    if settings.shrink_detail:
        detail = room_detail(drawn, data, units, fields, cells, errors)
    return EstimatedRoom(RoomFields(fields, units, cells, errors, inputs.room.place, detail))


def _cell_errors(
    inputs: RoomFieldInputs,
    cells: SeenCells,
    drawn: DrawnPixels,
    settings: ResultSettings,
    reporter: Reporter,
) -> np.ndarray:
    """(C, 3) standard errors in the seen cells."""
    room, fixtures, seed = inputs.room, inputs.fixtures, settings.seed
    data, fields = inputs.data, inputs.fields
    errors = cell_errors(drawn, data, inputs.units, fields, cells)
    if not settings.lamp_doubt:
        return errors
    doubted = hardly_seen(fixtures, inputs.pixels, len(room.triangles))
    if not fixtures or not (room.place or doubted):
        return errors
    lit = lit_cells(drawn, data, fields, cells)
    if doubted:
        _warn_of_lamps(room, fixtures, doubted, reporter)
        of_power = power_errors(room, fixtures, doubted, (lit.points, lit.normals), seed)
        errors = add_light_errors(errors, lit, of_power)
    if not room.place:
        return errors
    of_light = light_errors(room, fixtures, (lit.points, lit.normals), room.place, seed)
    return add_light_errors(errors, lit, of_light)


def _warn_of_lamps(
    room: Room, fixtures: Sequence[Fixture], doubted: Sequence[HardlySeen], reporter: Reporter
) -> None:
    """Say which lamps photographs hardly show."""
    names = fixture_names(room, fixtures)
    listed = ", ".join(f"{names[lamp.index]} ({lamp.pixels} pixels)" for lamp in doubted)
    reporter.warning(
        "lamp-hardly-seen",
        f"The photographs hardly show these lamps: {listed}. Their light and the colors near them may be"
        " wrong: glow may have become paint.",
        "Add photographs that show these lamps from near, most of all their bright insides.",
    )


@dataclass(frozen=True)
class JudgeInputs:
    """A finished estimate, and photographs at full size that it was not made of."""

    room: Room
    pixels: PixelStore
    observations: Observations
    room_fields: RoomFields
    fixtures: list[Fixture]
    scale: float
    held_back: list[View]
    photometry: Photometry | None = None


@dataclass(frozen=True)
class Judgement:
    """How good the estimate is; None where no photograph can be used."""

    quality: Quality | None


def judge_result(inputs: JudgeInputs, settings: Seeded, tools: Tools) -> Judgement:
    """Render the photographs that were held back, and project the others onto the mesh."""
    lamps, environment = emitter_table(inputs.fixtures), inputs.observations.environment
    estimate = Estimate(inputs.room, inputs.room_fields.query, lamps, environment)
    photometry = {} if inputs.photometry is None else inputs.photometry.facts
    given = inputs.pixels, inputs.held_back, estimate, photometry, inputs.scale, settings.seed
    return Judgement(judge(*given, tools.reporter.progress))
