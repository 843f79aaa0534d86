"""The stages that fit materials in closed form, and find the emitters (paper Eq. 5 and Sec. 4.4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..light.baking import ShadingStore
from ..light.cache import pool
from ..light.emission import brighter_than_white, emission_probability
from ..light.emitter_surfaces import EmitterSurfaces, emitter_surfaces
from ..light.emitters import Fixture, group_fixtures
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
from ..parts.labels import NO_PART, Parts
from ..photometry.encoded_photographs import Photometry
from ..pixels.grouped import place_of
from ..pixels.store import PixelStore
from ..run.chain import Tools
from ..run.hints import Hint
from ..run.stage_settings import (
    MaterialSettings,
    ReflectionSettings,
)
from ..surface.room import Room
from .light_stages import PresumedLamps

# Share of the pixels that are brighter than white surfaces above which light is missing: rooms have 0.01 to
# 0.09, the example room with its lamps painted out 0.3 to 0.4.
MISSING_LIGHT = 0.25


# ---- What the artist knows ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class HintedObservations:
    """Observations divided by hints.

    Attributes:
        observations: with the light from outside.
        surface_hints: the hints on the mesh.
    """

    observations: Observations
    surface_hints: SurfaceHints


def honour_hints(
    observed: Observations, room: Room, parts: Parts, hints: Sequence[Hint], *, tools: Tools
) -> HintedObservations:
    """Place the hints that are honoured from here on on the mesh, and divide the observations by them."""
    placed = place_hints(hints, room.vertices, room.triangles, parts, observed.surface)
    divided, left_alone = placed.split_parts(parts), placed.of_triangles(placed.left_alone)
    observed = replace(observed, folder=tools.folder, parts=divided, left_alone=left_alone)
    return HintedObservations(observed, placed)


# ---- Closed form (Eq. 5) and emitters (Sec. 4.4) -----------------------------------------------------------


@dataclass(frozen=True)
class ClosedForm:
    """The data to train on, and the closed-form estimate of all cells."""

    data: TrainingData
    cells: CellEstimate


def fit_closed_form(
    observations: Observations,
    shadings: ShadingStore,
    surface_hints: SurfaceHints,
    *,
    settings: MaterialSettings,
) -> ClosedForm:
    """Group the pixels by material, infer these, and fit the base colour of each cell."""
    data = training_input(observations, shadings, settings, surface_hints)
    return ClosedForm(data, fit_cells(data))


def find_emitter_units(
    room: Room,
    parts: Parts,
    lamps: PresumedLamps,
    observed: Observations,
    photometry: Photometry | None = None,
) -> EmitterSurfaces:
    """Divide the mesh into surfaces of which each emits as a whole, or not at all.

    Args:
        lamps: presumed ones.
        photometry: of photographs that are not HDR; None where all are.
    """
    light, hdr = observed.environment, photometry is None
    return emitter_surfaces(room, parts, observed.footprint, light, hdr, lamps.presumed)


@dataclass(frozen=True)
class Estimate:
    """What the closed form says of the mesh.

    Attributes:
        units: surfaces of one material.
        probability: (T,) float32 of each triangle to emit.
    """

    units: Units
    probability: np.ndarray


def estimate(
    room: Room,
    pixels: PixelStore,
    observations: Observations,
    shadings: ShadingStore,
    data: TrainingData,
    cells: CellEstimate,
    emitter_units: EmitterSurfaces,
    surface_hints: SurfaceHints,
    emitting: np.ndarray | None = None,
    units_before: Units | None = None,
    lamps_before: np.ndarray | None = None,
    *,
    tools: Tools,
) -> Estimate:
    """Divide the mesh into units of one material, and find how probable it is that each triangle emits.

    The first estimate warns where light is missing. It and the last one, with hints that were given since,
    warn of those that could not be honoured.

    Args:
        emitting: (T,) bool, the lamps of the estimate before; None in the first one.
        units_before: of a training, which hints divide further; None without.
        lamps_before: as `emitting`, in the last estimate with hints that were given since; else None.
    """
    if emitting is None:
        _warn_of_missing_light(brighter_than_white(pixels, shadings), tools)
    if surface_hints.problems and (emitting is None or lamps_before is not None):
        tools.reporter.warning("hints-unclear", problems=" ".join(surface_hints.problems))
    tools.facts["cells"] = len(cells.keys)
    units = units_before
    if units is None or observations.parts.kind == "part":
        units = material_units(data)
    units = hinted_units(units, observations.parts, surface_hints, data.materials)
    known = surface_hints.emits - (surface_hints.left_alone & (surface_hints.emits == 0))
    hinted = np.asarray(surface_hints.of_triangles(known), np.int8)
    white = partial(white_rows, data)
    probability = emission_probability(room, pixels, shadings, white, emitter_units, hinted)
    if lamps_before is not None:
        changed = lamps_before != (probability > 0.5)
        if changed[surface_hints.of_triangles(surface_hints.emits) != 0].any():
            tools.reporter.warning("hints-lamps")
    return Estimate(units, probability)


def _warn_of_missing_light(share: float, tools: Tools) -> None:
    """Warn where many pixels, a share of all, are brighter than white surfaces."""
    if share > MISSING_LIGHT:
        tools.reporter.warning("light-missing", share=100.0 * share)


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


def find_fixtures(
    room: Room, pixels: PixelStore, observations: Observations, probability: np.ndarray
) -> Emitters:
    """Group the triangles that probably emit to fixtures."""
    parts = observations.parts
    surface = parts.triangle_part if parts.kind == "part" else None
    fixtures = group_fixtures(room, probability > 0.5, pixels, surface, probability)
    table = EmitterTable.from_fixtures(fixtures)
    emitting = np.zeros(len(room.triangles), bool)
    emitting[table.triangles] = True
    return Emitters(fixtures, table, emitting)


@dataclass(frozen=True)
class Reflection:
    """What stage 3 needs of an estimate; fields as of :func:`.light_stages.refine_shadings`."""

    diffuse: np.ndarray
    materials: np.ndarray


def find_reflection(
    room: Room,
    observations: Observations,
    data: TrainingData,
    cells: CellEstimate,
    units: Units,
    *,
    settings: ReflectionSettings,
) -> Reflection:
    """Light and materials of each entry of the radiance cache, in the units of the last estimate."""
    diffuse = observations.means(data.shadings.diffuse).astype(np.float16)
    followed = followed_by_paths(cells, data.materials.error[:, 0], settings.cache_roughness)
    rng = np.random.default_rng([settings.seed, 4])
    entries, points, triangles = observations.places(room, rng)
    values = entry_values(followed, entries, points, triangles, units)
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
