"""The stages after the last training: the estimate on all surfaces, and how good it is."""

from __future__ import annotations

import numpy as np

from ..capture.views import View
from ..checks.quality import Quality, judge
from ..checks.rerender import Estimate
from ..light.emitters import Fixture
from ..light.lamp_doubt import hardly_seen, light_errors, power_errors
from ..light.observations import Observations
from ..material.cell_errors import add_light_errors, cell_errors, draw_pixels, lit_cells
from ..material.closed_form import TrainingData
from ..material.fields import RoomFields
from ..material.groups import Units
from ..material.networks import Fields
from ..material.reliability import room_detail
from ..material.seen import find_seen_cells
from ..optics.lights import EmitterTable
from ..photometry.encoded_photographs import Photometry
from ..pixels.store import PixelStore
from ..report.fixture_names import fixture_names
from ..run.chain import Tools
from ..run.stage_settings import ResultSettings, Seeded
from ..surface.room import Room


def find_room_fields(
    room: Room,
    pixels: PixelStore,
    observations: Observations,
    data: TrainingData,
    units: Units,
    fixtures: list[Fixture],
    emitting: np.ndarray,
    fields: Fields,
    *,
    settings: ResultSettings,
    tools: Tools,
) -> RoomFields:
    """The estimate on all surfaces, and its errors.

    From the pixels of all triangles that reflect and are not left alone.
    """
    cells, unused = find_seen_cells(pixels, units, fields.box), emitting | observations.left_alone
    drawn = draw_pixels(pixels, units, fields.box, cells, unused, settings.seed)
    errors = cell_errors(drawn, data, units, fields, cells)
    doubted = hardly_seen(fixtures, pixels, len(room.triangles)) if settings.lamp_doubt else []
    if settings.lamp_doubt and fixtures and (room.place or doubted):
        lit = lit_cells(drawn, data, fields, cells)
        places = lit.points, lit.normals
        if doubted:
            names = fixture_names(room, fixtures)
            listed = ", ".join(f"{names[lamp]} ({count} pixels)" for lamp, count, _ in doubted)
            tools.reporter.warning("lamp-hardly-seen", listed=listed)
            of_power = power_errors(room, fixtures, doubted, places, settings.seed)
            errors = add_light_errors(errors, lit, of_power)
        if room.place:
            of_light = light_errors(room, fixtures, places, room.place, settings.seed)
            errors = add_light_errors(errors, lit, of_light)
    detail = room_detail(drawn, data, units, fields, cells, errors) if settings.shrink_detail else None
    return RoomFields(fields, units, cells, errors, room.place, detail)


def judge_result(
    room: Room,
    pixels: PixelStore,
    observations: Observations,
    room_fields: RoomFields,
    fixtures: list[Fixture],
    scale: float,
    held_back: list[View],
    photometry: Photometry | None = None,
    *,
    settings: Seeded,
    tools: Tools,
) -> Quality | None:
    """Render the photographs that were held back, and project the others onto the mesh.

    None where no photograph can be used. `held_back` are at full size.
    """
    table = EmitterTable.from_fixtures(fixtures)
    estimate = Estimate(room, room_fields.query, table, observations.environment)
    facts = {} if photometry is None else photometry.facts
    return judge(pixels, held_back, estimate, facts, scale, settings.seed, tools.reporter.progress)
