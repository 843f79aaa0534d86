# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Keeps the settings of fixtures, and changed lights that stand for them, when results are applied again."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import bpy
import numpy as np
from mathutils import Matrix

from ..marks import (
    AS_CONVERTED,
    BACK,
    BASE,
    CENTROID,
    FIXTURE,
    FIXTURE_SOURCES,
    NAMED,
    NEW_LIGHT,
    PLACED,
    PROBABILITY,
    REMOVED,
    fixture_lights,
    fixtures_of,
    remove_marks,
)
from ..outliner import remove_object
from ..room.mesh_digest import is_edited
from .convert import fixture_to_lights
from .fixture_nodes import is_emission_material
from .light_state import SETTINGS, Setting, adopt, list_lights, plain, refresh
from .power import world_matrix

_SAME_PLACE = 1e-4  # metres


@dataclass(frozen=True)
class FixtureState:
    """A fixture's settings and base radiances by key, and whether Blender lights stand for it.

    Attributes:
        name: the object's name if the artist has chosen it, else "".
        lights: these lights with their inverse matrices to the fixture, from which they have been taken.
        centroid: its centroid in the room as it was exported, metres.
        matrix: its matrix to the world if the artist has moved it, else None.
        mesh: name of its mesh if the artist has modelled that, else "". It has a fake user.
        hidden: in viewports and in renders.
        materials: the artist's, by slot, in place of ours.
        removed: number of the removal that has hidden it, else 0.
    """

    settings: dict[str, Setting]
    converted: bool
    name: str = ""
    lights: Sequence[tuple[bpy.types.Object, Matrix]] = ()
    centroid: tuple[float, ...] = ()
    matrix: Matrix | None = None
    mesh: str = ""
    hidden: tuple[bool, bool] = (False, False)
    materials: Mapping[int, bpy.types.Material] = field(default_factory=dict)
    removed: int = 0


def release_copies(scene: bpy.types.Scene) -> None:
    """Make fixtures that the artist has copied lights of the artist, which no results replace."""
    kept: set[str] = set()
    for item in sorted(fixtures_of(scene), key=lambda item: item.name != item.get(NAMED)):
        if item[FIXTURE] in kept:
            remove_marks(item, FIXTURE, FIXTURE_SOURCES, NAMED, PLACED, CENTROID, PROBABILITY)
            item[NEW_LIGHT] = 1
        else:
            kept.add(item[FIXTURE])


def states_of(scene: bpy.types.Scene) -> dict[str, FixtureState]:
    """The states of all fixtures of a scene, by name. `keep_states` must follow, for the lights."""
    states = {}
    release_copies(scene)
    for item in fixtures_of(scene):
        adopt(item)
        placed = tuple(item.get(PLACED, ()))
        moved = len(placed) == 3 and not np.allclose(
            world_matrix(item), Matrix.Translation(placed), rtol=0.0, atol=_SAME_PLACE
        )
        modelled = item.type == "MESH" and is_edited(item.data)
        if modelled:
            item.data.use_fake_user = True
        slots = list(item.data.materials) if item.type == "MESH" else []
        settings = {key: plain(item[key]) for key in (*SETTINGS, BASE, BACK) if key in item}
        states[item[FIXTURE]] = FixtureState(
            settings,
            AS_CONVERTED in item,
            "" if item.name == item.get(NAMED) else item.name,
            [_taken(light) for light in fixture_lights(item)],
            tuple(item.get(CENTROID, ())),
            world_matrix(item).copy() if moved else None,
            item.data.name if modelled else "",
            (item.hide_viewport, item.hide_render),
            {
                slot: each
                for slot, each in enumerate(slots)
                if each is not None and not is_emission_material(each)
            },
            int(item.get(REMOVED, 0)),
        )
    return states


def keep_states(
    scene: bpy.types.Scene, items: Iterable[bpy.types.Object], states: Mapping[str, FixtureState]
) -> list[bpy.types.Object]:
    """Give new fixtures the settings of earlier ones with the same name and radiance; update all lights.

    Returns:
        The fixtures.
    """
    unused = dict(states)
    placed = list(items)
    for item in placed:
        state = states.get(item[FIXTURE])
        if state is not None and _is_near(state.centroid, item[CENTROID]):
            _keep_shape(item, state)
        if state is None or any(state.settings.get(key) != plain(item[key]) for key in (BASE, BACK)):
            continue
        for key in SETTINGS:
            if key in state.settings:
                item[key] = state.settings[key]
        if state.name:
            item.name = state.name
        for slot, material in state.materials.items():
            if slot < len(item.data.materials):
                item.data.materials[slot] = material
        if state.converted:
            fixture_to_lights(scene, item)
            _bring_back(item, state.lights)
            del unused[item[FIXTURE]]
    others = {item[FIXTURE]: item for item in fixtures_of(scene) if item not in placed}
    for name, state in unused.items():
        if name in others:  # it was not replaced
            _bring_back(others[name], state.lights)
            continue
        for light, _ in state.lights:
            remove_object(light)
    refresh(scene)
    list_lights(scene)
    return placed


def _is_near(place: Sequence[float], other: Sequence[float]) -> bool:
    """Whether two places in the world, metres, are the same; () for one that is not known."""
    return len(place) == 3 and bool(np.allclose(place, other, rtol=0.0, atol=_SAME_PLACE))


def _keep_shape(item: bpy.types.Object, state: FixtureState) -> None:
    """Give a new fixture the place, mesh and visibility that the artist has given the earlier one."""
    item.hide_viewport, item.hide_render = state.hidden
    if state.removed:
        item[REMOVED] = state.removed
    if state.matrix is not None:
        item.matrix_world = state.matrix
    mesh = bpy.data.meshes.get(state.mesh)
    if mesh is None or mesh.library is not None:
        return
    made, name = item.data, item.data.name
    for index, material in enumerate(made.materials):
        if index < len(mesh.materials):
            mesh.materials[index] = material
        else:
            mesh.materials.append(material)
    item.data, mesh.use_fake_user = mesh, False
    bpy.data.meshes.remove(made)
    mesh.name = name


def _taken(light: bpy.types.Object) -> tuple[bpy.types.Object, Matrix]:
    """Take a light from its fixture, so that it is not removed together with that."""
    inverse = light.matrix_parent_inverse.copy()
    light.parent = None
    remove_marks(light, FIXTURE_SOURCES)
    return light, inverse


def _bring_back(item: bpy.types.Object, lights: Iterable[tuple[bpy.types.Object, Matrix]]) -> None:
    """Put kept lights in the place of those that a fixture has just been converted to."""
    for made in fixture_lights(item):
        remove_object(made)
    for light, inverse in lights:
        light[FIXTURE_SOURCES] = item[FIXTURE_SOURCES]
        light.parent, light.matrix_parent_inverse = item, inverse
