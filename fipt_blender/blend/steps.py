# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The main job's steps on Blender's data: what happens between the engine's commands.

Objects are remembered by name, since undo and loading a file invalidate every pointer.
"""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from mathutils import Vector
from mathutils.bvhtree import BVHTree

from ..bridge.process import Message
from ..core.job.errors import FiptError
from ..core.job.runfolder import RunFolder, read_json
from ..mainjob import BLEND_NAME, MainJobOptions
from . import cameras, capture_export, lights, mesh_import, outliner, renders, room_export, uvs
from .apply import apply_results
from .batch_state import panel_state, remember_run
from .insert import insert_object
from .placement import (
    Cast,
    Support,
    ViewGeometry,
    choose_view,
    find_light_place,
    room_light_power,
)
from .save import save_blend
from .slices import Slices
from .world import apply_environment

RERENDERS = 3
NEW_LIGHT = "FIPT New Light"
# A chrome ball shows at once shadow, reflections and the light that the room sends.
INSERTED_KIND = "mirror_ball"


class RoomSteps:
    """One run's steps; each may be the first that this Blender does.

    Args:
        options: of the main job.
        run: its run folder.
    """

    def __init__(self, options: MainJobOptions, run: RunFolder) -> None:
        self._options = options
        self._run = run
        self._choice: tuple[str, Support | None] | None = None

    def import_room(self) -> None:
        """The mesh and the cameras into the file; a room that is in an artist's file already is kept.

        Raises:
            FiptError: ``mesh-missing`` and others of the importers.
        """
        if self._options.own_file:
            bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True, load_ui=False)
        capture = read_json(self._run.capture_json)
        if not self._objects():
            if not capture["mesh"]:
                raise FiptError(
                    "mesh-missing", "No mesh lies beside the cameras.", "Name the room's mesh file (--mesh)."
                )
            matrix = np.array(capture["world_from_source"], np.float64)
            mesh_import.import_room(self._run.resolve(capture["mesh"]), matrix)
        cameras.add_cameras(self._run)

    def export_room(self) -> Slices[None]:
        """room.npz and room.json for the engine."""
        yield from room_export.export_slices(self._objects(), self._run, self._options.parts)

    def make_atlas(self) -> None:
        """UVs onto the room and atlas.npz for the engine."""
        uvs.make_atlas(self._objects(), self._run, self._options.settings)

    def apply_and_save(self) -> None:
        """Materials, fixtures and world; an own file is saved as room.blend, an artist's one as a copy."""
        apply_results(self._run, self._objects())
        apply_environment(self._run)
        scene = bpy.context.scene
        view, _ = self._view()
        renders.set_up_scene(scene, renders.exposure_of(self._photograph(view)))
        cameras.use_view(scene, cameras.find_camera(view))
        path = self._run.root / BLEND_NAME
        if self._options.own_file:
            with panel_state():
                remember_run(scene, self._options, self._run)
                save_blend(path)
            path.with_suffix(".blend1").unlink(missing_ok=True)
        else:
            bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True, check_existing=False)

    def open_blend(self) -> None:
        """Bring back the state that `apply_and_save` left."""
        bpy.ops.wm.open_mainfile(filepath=str(self._run.root / BLEND_NAME), load_ui=False)

    def rerender(self) -> None:
        """The chosen view as it was photographed, and further held-back ones."""
        chosen, _ = self._view()
        views = preferred_views(read_json(self._run.capture_json), self._options.render_view)
        others = [view["name"] for view in views if view["split"] == "held_back" and view["name"] != chosen]
        self._render("rerender", [chosen, *others[: RERENDERS - 1]])

    def relight(self) -> None:
        """The view with the estimated lights off and a new area light below the ceiling."""
        room = room_export.read_room(self._run)
        low, high = room.vertices.min(axis=0), room.vertices.max(axis=0)
        capture = read_json(self._run.capture_json)
        eye_height = float(np.mean([view["camera_to_world"][2][3] for view in capture["views"]]))
        place = find_light_place(make_cast(room), low, high, eye_height)
        median = float(np.median(self._photograph(self._view()[0])))
        radiance = room_light_power(median, low, high) / lights.area_light_watts(1.0, place.size**2)
        matrix = np.eye(4)
        matrix[:3, 3] = place.center
        lights.set_estimated_lights(False)
        light = lights.add_area_light(
            NEW_LIGHT, [radiance] * 3, size=(place.size, place.size), matrix=matrix, as_mesh=True
        )
        try:
            self._render("relight", [self._view()[0]])
        finally:
            bpy.data.objects.remove(light)
            lights.set_estimated_lights(True)

    def insert(self) -> list[Message]:
        """The view with an object that stands in it; a warning where it has no place."""
        view, support = self._view()
        if support is None:
            return [
                {
                    "type": "warning",
                    "code": "surface-missing",
                    "text": f"The view '{view}' shows no free level surface for an inserted object.",
                    "remedy": "Name a view that sees floor or a table with --render-view.",
                }
            ]
        item = insert_object(
            bpy.context.scene, Vector(support.point), kind=INSERTED_KIND, size=2.0 * support.radius
        )
        try:
            self._render("insert", [view])
        finally:
            bpy.data.objects.remove(item)
        return []

    def _render(self, kind: str, views: list[str]) -> None:
        spp, seed = self._options.render_spp, self._options.settings.seed
        renders.render_list(self._run, bpy.context.scene, kind, views, spp, seed)

    def _photograph(self, name: str) -> np.ndarray:
        """Radiance (H,W,3) of a view."""
        view = preferred_views(read_json(self._run.capture_json), name)[0]
        return renders.read_pixels(self._run.resolve(view["image"]))

    def _objects(self) -> list[bpy.types.Object]:
        room = bpy.context.scene.collection.children.get(outliner.ROOM)
        return [] if room is None else [item for item in room.objects if item.type == "MESH"]

    def _view(self) -> tuple[str, Support | None]:
        """The view to render and where in it an object can stand."""
        if self._choice is None:
            views = preferred_views(read_json(self._run.capture_json), self._options.render_view)
            geometry = [(view["name"], view_geometry(view)) for view in views]
            self._choice = choose_view(make_cast(room_export.read_room(self._run)), geometry)
        return self._choice


def export_scene_cameras(run: RunFolder) -> None:
    """capture.json from the scene's ticked views; a run folder without a list of views keeps its own.

    Raises:
        FiptError: see `capture_export.export_capture`.
    """
    scene = bpy.context.scene
    if len(scene.fipt.capture.views) or not run.capture_json.exists():
        capture_export.export_capture(scene, run)


def export_scene_room(run: RunFolder) -> Slices[None]:
    """room.npz and room.json from the objects that the scene names as its room.

    Raises:
        FiptError: ``room-missing``; see `room_export.export_slices`.
    """
    scene = bpy.context.scene
    objects = scene.fipt.capture.room_objects(scene)
    if not objects:
        raise FiptError(
            "room-missing",
            "The scene has no room: no mesh is imported and no collection chosen.",
            "Import the room's mesh or choose its collection in the section Capture.",
        )
    yield from room_export.export_slices(objects, run, scene.fipt.parts.engine_source)


def preferred_views(capture: dict[str, Any], name: str = "") -> list[dict[str, Any]]:
    """The capture's views, held-back ones first; only the named one if there is a name.

    Raises:
        FiptError: ``view-missing``.
    """
    views = capture["views"]
    if name:
        views = [view for view in views if view["name"] == name]
        if not views:
            raise FiptError(
                "view-missing", f"The capture has no view '{name}'.", "Name a view of capture.json."
            )
    return sorted(views, key=lambda view: view["split"] != "held_back")


def view_geometry(view: dict[str, Any]) -> ViewGeometry:
    """The camera of an entry of capture.json."""
    pose = np.array(view["camera_to_world"], np.float64)
    lens = [float(view[name]) for name in ("fx", "fy", "cx", "cy")]
    return ViewGeometry(pose, int(view["width"]), int(view["height"]), *lens)


def make_cast(room: room_export.Room) -> Cast:
    """Ray queries against the exported room."""
    tree = BVHTree.FromPolygons(room.vertices.tolist(), room.triangles.tolist(), all_triangles=True)
    low, high = room.vertices.min(axis=0), room.vertices.max(axis=0)
    # Away from the surface that a ray starts on; relative, as the room may have any size.
    nudge = 1.0e-5 * float(np.linalg.norm(high - low))

    def cast(origin: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        point, normal, _, _ = tree.ray_cast(tuple(origin + nudge * direction), tuple(direction))
        return None if point is None else (np.array(point), np.array(normal))

    return cast
