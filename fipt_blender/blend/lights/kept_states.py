"""Keeps the settings of fixtures, and changed lights that stand for them, when results are applied again."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import bpy
import numpy as np
from mathutils import Matrix
from mathutils.bvhtree import BVHTree

from ...bridge.process import Message
from ...core.run.errors import warning
from ..marks import (
    AS_CONVERTED,
    BASE,
    CENTROID,
    FIXTURE,
    FIXTURE_LIGHT,
    FIXTURE_SOURCES,
    NAMED,
    NEW_LIGHT,
    ON,
    PLACED,
    PROBABILITY,
    REMOVED,
    UNIT,
    UNPLACED,
    fixture_lights,
    fixtures_of,
    remove_marks,
)
from ..outliner import remove_object
from ..room.mesh_arrays import corner_vertices, triangle_loops, vertex_positions
from ..room.mesh_digest import is_edited
from .calibration import scene_unit
from .convert import fixture_to_lights, lights_as_converted, vector_areas
from .fixture_nodes import is_emission_material
from .light_state import DEFAULTS, SETTINGS, Setting, adopt, list_lights, plain, refresh
from .power import base_power, world_matrix

_SAME_PLACE = 1e-4  # metres
_SAME_SURFACE = 0.1  # distance between surfaces of one lamp in two estimates, in its radius


@dataclass(frozen=True)
class Surface:
    """Where a lamp is in the room.

    Attributes:
        center: (3,) mean of its corners in the world, metres.
        radius: of the ball around that in which it lies, metres.
        middles: (T,3) of its triangles.
        areas: (T,) of these.
        tree: of these.
    """

    center: np.ndarray
    radius: float
    middles: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    areas: np.ndarray = field(default_factory=lambda: np.zeros(0))
    tree: BVHTree | None = None

    def likeness(self, other: Surface) -> float:
        """Share of the surfaces that coincide, 0 to 2; far less for lamps that are only near; else 0."""
        reach = self.radius + other.radius + _SAME_PLACE
        distance = float(np.linalg.norm(self.center - other.center))
        if distance > reach:
            return 0.0
        near = _SAME_SURFACE * min(self.radius, other.radius)
        return self._share_on(other, near) + other._share_on(self, near) or 1e-3 * (1.001 - distance / reach)

    def _share_on(self, other: Surface, near: float) -> float:
        """Share of the area that lies on another surface."""
        if other.tree is None or not self.areas.sum():
            return 0.0
        on = [other.tree.find_nearest(middle, near)[0] is not None for middle in self.middles.tolist()]
        return float(self.areas[on].sum() / self.areas.sum())


@dataclass(frozen=True)
class FixtureState:
    """What the artist has made of a fixture.

    Attributes:
        label: the object's name.
        settings: by key.
        surface: as it was made.
        converted: Blender lights stand for it.
        own_lights: these are not as they were made.
        power: rgb as estimated, W.
        name: the object's name if the artist has chosen it, else "".
        lights: these lights with the matrices of their parent spaces.
        matrix: its matrix to the world if the artist has moved it, else None.
        mesh: name of its mesh if the artist has modelled that, else "". It has a fake user.
        hidden: in viewports and in renders.
        materials: the artist's, by slot, in place of ours.
        removed: number of the removal that has hidden it, else 0.
    """

    label: str
    settings: dict[str, Setting]
    surface: Surface
    converted: bool = False
    own_lights: bool = False
    power: Sequence[float] = (0.0, 0.0, 0.0)
    name: str = ""
    lights: Sequence[tuple[bpy.types.Object, Matrix]] = ()
    matrix: Matrix | None = None
    mesh: str = ""
    hidden: tuple[bool, bool] = (False, False)
    materials: Mapping[int, bpy.types.Material] = field(default_factory=dict)
    removed: int = 0

    def is_changed(self) -> bool:
        """Whether the artist has set anything but what `remove` does."""
        made = (self.name, self.own_lights, self.matrix, self.mesh, self.materials, any(self.hidden))
        is_set = any(self.settings.get(key, value) != value for key, value in DEFAULTS.items())
        return not self.removed and (is_set or any(made))


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
    """The states of all fixtures of a scene, by name, and those that found no place in earlier results.

    `keep_states` must follow, for the lights.
    """
    states = {
        f"unplaced {index}": FixtureState(label, settings, Surface(np.array(center), radius), name=name)
        for index, (label, name, settings, center, radius) in enumerate(json.loads(scene.get(UNPLACED, "[]")))
    }
    release_copies(scene)
    for item in fixtures_of(scene):
        adopt(item)
        placed = tuple(item.get(PLACED, world_matrix(item).translation))
        moved = not np.allclose(world_matrix(item), Matrix.Translation(placed), rtol=0.0, atol=_SAME_PLACE)
        modelled = item.type == "MESH" and is_edited(item.data)
        if modelled:
            item.data.use_fake_user = True
        slots = list(item.data.materials) if item.type == "MESH" else []
        lights = fixture_lights(item)
        animated = any(each.animation_data or each.data.animation_data for each in lights)
        converted = AS_CONVERTED in item
        states[item[FIXTURE]] = FixtureState(
            item.name,
            {key: plain(item[key]) for key in SETTINGS if key in item},
            _surface(item, placed),
            converted,
            converted and (animated or not lights_as_converted(scene, item)),
            base_power(item),
            "" if item.name == item.get(NAMED) else item.name,
            [_taken(light) for light in lights],
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


def _surface(item: bpy.types.Object, placed: Sequence[float]) -> Surface:
    """The surface of a fixture where it was made."""
    if item.type != "MESH" or not len(item.data.polygons):
        return Surface(np.array(item.get(CENTROID, placed), float), 0.0)
    points = vertex_positions(item.data).astype(float) + np.array(placed)
    triangles = corner_vertices(item.data)[triangle_loops(item.data, mirrored=False)[0]]
    center = points.mean(axis=0)
    return Surface(
        center,
        float(np.linalg.norm(points - center, axis=1).max()),
        points[triangles].mean(axis=1),
        np.linalg.norm(vector_areas(points, triangles), axis=1),
        BVHTree.FromPolygons(points.tolist(), triangles.tolist()),
    )


def keep_states(
    scene: bpy.types.Scene, items: Iterable[bpy.types.Object], states: Mapping[str, FixtureState]
) -> list[Message]:
    """Give new fixtures the states of earlier ones with the same surface, else place; update all lights.

    Where several have become one fixture, it has the state of the one that covers it most; where one has
    become several, all have its settings. What finds no fixture is kept with the scene for later results.

    Returns:
        A warning of what has found none.
    """
    placed = list(items)
    others = {item[FIXTURE]: item for item in fixtures_of(scene) if item not in placed}
    for name in others.keys() & states.keys():  # it was not replaced
        _bring_back(others[name], states[name].lights)
    unused = {name: state for name, state in states.items() if name not in others}
    for item, name in _matches(placed, dict(unused)):
        for key, value in states[name].settings.items():
            item[key] = value
        if name in unused:
            _keep_shape(scene, item, unused.pop(name))
    lost = [state for state in unused.values() if state.is_changed()]
    for state in unused.values():
        for light, _ in state.lights:
            if state.own_lights:
                _release(scene, light, state)
            else:
                remove_object(light)
    remove_marks(scene, UNPLACED)
    if lost:
        places = [(each.surface.center.tolist(), each.surface.radius) for each in lost]
        kept = [
            (each.label, each.name, each.settings, *place) for each, place in zip(lost, places, strict=True)
        ]
        scene[UNPLACED] = json.dumps(kept)
    refresh(scene)
    list_lights(scene)
    return [warning("lamps-unplaced", lamps=", ".join(state.label for state in lost))] if lost else []


def _matches(
    items: Sequence[bpy.types.Object], states: Mapping[str, FixtureState]
) -> Iterator[tuple[bpy.types.Object, str]]:
    """New fixtures with the names of the states that they get, those that fit best first."""
    surfaces = [_surface(item, item[PLACED]) for item in items]
    pairs = [
        (likeness, index, name)
        for name, state in states.items()
        for index, surface in enumerate(surfaces)
        if (likeness := state.surface.likeness(surface)) > 0.0
    ]
    matched, used = set[int](), set[str]()
    for likeness, index, name in sorted(pairs, reverse=True):
        if index not in matched and (name not in used or likeness > 0.5):
            matched.add(index)
            used.add(name)
            yield items[index], name


def _keep_shape(scene: bpy.types.Scene, item: bpy.types.Object, state: FixtureState) -> None:
    """Give a new fixture the name, place, mesh, visibility, materials and lights of an earlier one."""
    item.hide_viewport, item.hide_render = state.hidden
    if state.removed:
        item[REMOVED] = state.removed
    if state.name:
        item.name = state.name
    if state.matrix is not None:
        item.matrix_world = state.matrix
    mesh = bpy.data.meshes.get(state.mesh)
    if mesh is not None and mesh.library is None:
        made, name = item.data, item.data.name
        for index, material in enumerate(made.materials):
            if index < len(mesh.materials):
                mesh.materials[index] = material
            else:
                mesh.materials.append(material)
        item.data, mesh.use_fake_user = mesh, False
        bpy.data.meshes.remove(made)
        mesh.name = name
    for slot, material in state.materials.items():
        if slot < len(item.data.materials):
            item.data.materials[slot] = material
    before, now = np.array(state.power), np.array(base_power(item))
    if state.converted:
        same = state.own_lights or np.allclose(before, now, rtol=1e-5)
        for light, _ in () if same else state.lights:
            remove_object(light)
        fixture_to_lights(scene, item)
        if same:
            factor = np.divide(now, before, out=np.ones(3), where=before > 0.0)
            _bring_back(item, state.lights, factor.tolist())


def _taken(light: bpy.types.Object) -> tuple[bpy.types.Object, Matrix]:
    """Take a light from its fixture, so that it is not removed together with that."""
    space = world_matrix(light.parent) @ light.matrix_parent_inverse
    light.parent = None
    remove_marks(light, FIXTURE_SOURCES)
    return light, space


def _bring_back(
    item: bpy.types.Object,
    lights: Iterable[tuple[bpy.types.Object, Matrix]],
    factor: Sequence[float] = (1, 1, 1),
) -> None:
    """Put kept lights, their rgb multiplied, in the place of those that a fixture has now."""
    for made in fixture_lights(item):
        remove_object(made)
    for light, space in lights:
        light[FIXTURE_SOURCES], light[FIXTURE_LIGHT] = item[FIXTURE_SOURCES], item[FIXTURE]
        light[BASE] = [value * each for value, each in zip(light[BASE], factor, strict=True)]
        light.parent, light.matrix_parent_inverse = item, world_matrix(item).inverted() @ space


def _release(scene: bpy.types.Scene, light: bpy.types.Object, state: FixtureState) -> None:
    """Make a light of a fixture that is gone one of the artist, switched off: nothing says that it shines."""
    remove_marks(light, FIXTURE_LIGHT, AS_CONVERTED)
    for key, value in state.settings.items():
        light[key] = value
    light[NEW_LIGHT], light[ON], light[UNIT] = 1, False, scene_unit(scene)
