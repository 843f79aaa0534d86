# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The stages that fit materials in closed form, and find the emitters (paper Eq. 5 and Sec. 4.4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..light.baking import ShadingStore
from ..light.cache import pool
from ..light.emission import emission_probability
from ..light.emitter_surfaces import EmitterSurfaces, emitter_surfaces
from ..light.emitters import EmitterPixels, Fixture, emitter_table, group_fixtures
from ..light.environment import Environment
from ..light.evidence import brighter_than_white
from ..light.observations import Observations
from ..material.closed_form import (
    CellEstimate,
    TrainingData,
    fit_cells,
    followed_by_paths,
    white_rows,
)
from ..material.groups import Units
from ..material.hints import SurfaceHints, place_hints
from ..material.seen import fallback_values, seen_statistics
from ..material.training_input import hinted_units, material_units, training_input
from ..optics.lights import EmitterTable
from ..parts.labels import NO_PART, Parts, room_pieces
from ..photometry.encoded_photographs import Photometry
from ..pixels.grouped import place_of
from ..pixels.store import PixelStore
from ..run.chain import Tools
from ..run.hints import Hint
from ..run.stage_settings import (
    MaterialSettings,
    NoSettings,
    ReflectionSettings,
)
from ..surface.room import Room

# Share of the pixels that are brighter than white surfaces above which light is missing: rooms have 0.01 to
# 0.09, the example room with its lamps painted out 0.3 to 0.4.
MISSING_LIGHT = 0.25


# ---- What the artist knows ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class HintInputs:
    """Observations without hints, and the hints that are honoured from here on."""

    observed: Observations
    environment: Environment | None
    room: Room
    parts: Parts
    hints: Sequence[Hint]


@dataclass(frozen=True)
class HintedObservations:
    """Observations divided by hints.

    Attributes:
        observations: with the light from outside.
        surface_hints: the hints on the mesh; None without any.
        pieces: (T,) int32 connected piece of each triangle; None where parts are known, which need no pieces.
    """

    observations: Observations
    surface_hints: SurfaceHints | None
    pieces: np.ndarray | None


def honour_hints(inputs: HintInputs, settings: NoSettings, tools: Tools) -> HintedObservations:
    """Place the hints on the mesh, and divide the observations by them."""
    room, parts = inputs.room, inputs.parts
    observed = replace(inputs.observed, environment=inputs.environment, folder=tools.folder)
    pieces = None if parts.kind == "part" else room_pieces(room)
    if not inputs.hints:
        return HintedObservations(observed, None, pieces)
    hints = place_hints(inputs.hints, room.vertices, room.triangles, parts, pieces)
    left_alone = hints.of_triangles(hints.left_alone)
    divided = replace(
        observed, parts=hints.split_parts(parts), left_alone=left_alone if left_alone.any() else None
    )
    return HintedObservations(divided, hints, pieces)


# ---- Closed form (Eq. 5) and emitters (Sec. 4.4) -----------------------------------------------------------


@dataclass(frozen=True)
class ClosedFormInputs:
    """The pixels and their shadings."""

    observations: Observations
    shadings: ShadingStore
    levels: np.ndarray
    pieces: np.ndarray | None
    surface_hints: SurfaceHints | None


@dataclass(frozen=True)
class ClosedForm:
    """The data to train on, and the closed-form estimate of all cells."""

    data: TrainingData
    cells: CellEstimate


def fit_closed_form(inputs: ClosedFormInputs, settings: MaterialSettings, tools: Tools) -> ClosedForm:
    """Group the pixels by material, infer these, and fit the base colour of each cell."""
    given = inputs.observations, inputs.pieces, inputs.shadings, inputs.levels, settings
    data = training_input(*given, inputs.surface_hints)
    return ClosedForm(data, fit_cells(data))


@dataclass(frozen=True)
class SurfaceInputs:
    """The room, and how much of its light is inferred."""

    room: Room
    parts: Parts
    observed: Observations
    environment: Environment | None


@dataclass(frozen=True)
class PossibleEmitters:
    """What emits as a whole."""

    emitter_units: EmitterSurfaces


def find_emitter_units(inputs: SurfaceInputs, settings: NoSettings, tools: Tools) -> PossibleEmitters:
    """Divide the mesh into surfaces of which each emits as a whole, or not at all."""
    given = inputs.room, inputs.parts, inputs.observed.footprint, inputs.environment
    return PossibleEmitters(emitter_surfaces(*given))


@dataclass(frozen=True)
class EstimateInputs:
    """The closed form, and what lit the shadings.

    Attributes:
        baked_lamps: (T,) bool, lamps whose own radiance is in the shadings.
        emitting: (T,) bool, the lamps of the estimate before; None in the first one.
        units_before: of a training, which hints divide further; None without.
        photometry: of photographs that are not HDR; None where all are.
    """

    room: Room
    pixels: PixelStore
    observations: Observations
    shadings: ShadingStore
    data: TrainingData
    cells: CellEstimate
    emitter_units: EmitterSurfaces
    baked_lamps: np.ndarray
    pieces: np.ndarray | None
    surface_hints: SurfaceHints | None
    emitting: np.ndarray | None = None
    units_before: Units | None = None
    photometry: Photometry | None = None


@dataclass(frozen=True)
class Estimate:
    """What the closed form says of the mesh.

    Attributes:
        units: surfaces of one material.
        probability: (T,) float32 of each triangle to emit.
    """

    units: Units
    probability: np.ndarray


def estimate_first(inputs: EstimateInputs, settings: NoSettings, tools: Tools) -> Estimate:
    """The estimate with the shadings of stage 1, and a warning where light is missing in them."""
    share = brighter_than_white(inputs.pixels, inputs.shadings)
    if share > MISSING_LIGHT:
        tools.reporter.warning(
            "light-missing",
            f"{100.0 * share:.0f} % of the pixels are brighter than white surfaces would be in the light"
            " that the photographs show: lamps or windows are missing in them, and false ones will be"
            " found.",
            "Add photographs that show the lamps, and use them as the camera made them: not painted over,"
            " not cropped, not tone-mapped.",
        )
    _warn_of_problems(inputs.surface_hints, tools)
    return estimate(inputs, settings, tools)


def estimate_hinted(inputs: EstimateInputs, settings: NoSettings, tools: Tools) -> Estimate:
    """The estimate with hints that were given since, and warnings of those that could not be honoured."""
    _warn_of_problems(inputs.surface_hints, tools)
    found = estimate(inputs, settings, tools)
    hints = inputs.surface_hints
    if hints is not None and inputs.emitting is not None:
        changed = inputs.emitting != (found.probability > 0.5)
        if changed[hints.of_triangles(hints.emits) != 0].any():
            tools.reporter.warning(
                "hints-lamps",
                "The hints change which surfaces are lamps, but the light in the room is that of before.",
                "Tick Light Changes Too and estimate again with hints, or use Estimate.",
            )
    return found


def estimate(inputs: EstimateInputs, settings: NoSettings, tools: Tools) -> Estimate:
    """Divide the mesh into units of one material, and find how probable it is that each triangle emits."""
    tools.facts["cells"] = len(inputs.cells.keys)
    surfaces, hints, data = inputs.emitter_units, inputs.surface_hints, inputs.data
    units = inputs.units_before
    if units is None or inputs.pieces is None:
        units = material_units(inputs.pieces, data, inputs.room.scan is not None)
    hinted = np.zeros(len(inputs.room.triangles), np.int8)
    if hints is not None:
        units = hinted_units(units, inputs.observations.parts, hints, data.materials)
        known = hints.emits - (hints.left_alone & (hints.emits == 0))
        hinted = np.asarray(hints.of_triangles(known), np.int8)
    white, hdr = partial(white_rows, data), inputs.photometry is None
    given = inputs.room, inputs.pixels, inputs.shadings, white, surfaces, hinted, inputs.baked_lamps, hdr
    return Estimate(units, emission_probability(*given))


def _warn_of_problems(hints: SurfaceHints | None, tools: Tools) -> None:
    if hints is not None and hints.problems:
        text = "Some hints could not be honoured: " + " ".join(hints.problems)
        tools.reporter.warning("hints-unclear", text, "Correct or remove these hints.")


@dataclass(frozen=True)
class FixtureInputs:
    """Probabilities, and what the pixels show of the triangles."""

    room: Room
    pixels: PixelStore
    observations: Observations
    probability: np.ndarray


@dataclass(frozen=True)
class Emitters:
    """The lamps.

    Attributes:
        fixtures: in units of the capture's median.
        emitters: the same as a table of triangles.
        emitting: (T,) bool, these triangles.
    """

    fixtures: list[Fixture]
    emitters: EmitterTable
    emitting: np.ndarray


def find_fixtures(inputs: FixtureInputs, settings: NoSettings, tools: Tools) -> Emitters:
    """Group the triangles that probably emit to fixtures."""
    parts, probability = inputs.observations.parts, inputs.probability
    surface = parts.triangle_part if parts.kind == "part" else None
    pixels = EmitterPixels.of(inputs.pixels)
    fixtures = group_fixtures(inputs.room, probability > 0.5, pixels, surface, probability)
    table = emitter_table(fixtures)
    emitting = np.zeros(len(inputs.room.triangles), bool)
    emitting[table.triangles] = True
    return Emitters(fixtures, table, emitting)


@dataclass(frozen=True)
class ReflectionInputs:
    """The closed form, in the units of its estimate."""

    room: Room
    observations: Observations
    data: TrainingData
    cells: CellEstimate
    units: Units


@dataclass(frozen=True)
class Reflection:
    """What stage 3 needs of an estimate; fields as of :class:`.light_stages.RefinementInputs`."""

    diffuse: np.ndarray
    materials: np.ndarray


def find_reflection(inputs: ReflectionInputs, settings: ReflectionSettings, tools: Tools) -> Reflection:
    """Light and materials of each entry of the radiance cache."""
    observations, data, limit = inputs.observations, inputs.data, settings.cache_roughness
    diffuse = observations.means(data.shadings.diffuse).astype(np.float16)
    cells = followed_by_paths(inputs.cells, data.materials.error[:, 0], limit)
    rng = np.random.default_rng([settings.seed, 4])
    entries, points, triangles = observations.places(inputs.room, rng)
    values = entry_values(cells, entries, points, triangles, inputs.units)
    return Reflection(diffuse, pool(observations.grid, entries, values)[0])


def entry_values(
    cells: CellEstimate, entries: np.ndarray, points: np.ndarray, triangles: np.ndarray, units: Units
) -> np.ndarray:
    """(E, 5) base colour, roughness and metallic of cache entries.

    Entries without a cell take the median of their unit, or the value of the nearest cell.

    Args:
        entries, points, triangles: of :meth:`Observations.places`.
    """
    known, values, seen_triangle = cells.by_entry()
    place = place_of(known, entries)
    has_cell = place >= 0
    result = np.full((len(entries), 5), 0.5, np.float32)
    if has_cell.any():
        result[has_cell] = values[place[has_cell]]
        unit = np.append(units.triangle, NO_PART)
        seen_unit = unit[seen_triangle[place[has_cell]]]
        statistics = seen_statistics(points[has_cell], seen_unit, result[has_cell], len(units.single))
        missing = ~has_cell
        result[missing] = fallback_values(points[missing], unit[triangles[missing]], statistics)
    return result
