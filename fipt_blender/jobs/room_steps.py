"""The main job's steps on Blender's data, between the engine's commands.

Objects are kept by name, since undo and loading a file invalidate every pointer.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager

import bpy
import numpy as np
from mathutils import Vector

from .. import properties
from ..blend.capture import cameras
from ..blend.capture.importing import import_capture
from ..blend.capture.look import enter_camera_on_opening
from ..blend.capture.view_geometry import view_geometry
from ..blend.insert.balls import add_ball
from ..blend.insert.support import Support, choose_view
from ..blend.lights.area_lights import add_area_light
from ..blend.lights.light_state import switch_all
from ..blend.lights.placement import find_light_place, room_light_power
from ..blend.pictures.cycles import RenderOptions
from ..blend.pictures.image_files import photograph
from ..blend.pictures.renders import render_listed
from ..blend.results.scene_state import median_radiance
from ..blend.room.rays import make_cast
from ..blend.save import save_blend
from ..bridge.process import Message
from ..bridge.step import Slices
from ..core.capture.options import CaptureOptions
from ..core.run.contents import CapturedView, CapturedViews
from ..core.run.errors import FiptError, Problem, as_message, warning
from ..core.run.made import Made, content_digest
from ..core.run.run_files import read_capture, read_room
from ..core.run.runfolder import RunFolder, atomic_path
from ..core.run.settings import make_settings
from ..core.run.stage_settings import TextureSettings
from ..properties.declared import fill
from .options import BLEND_NAME, MOST_RERENDERED, RENDERS, MainJobOptions, capture_source
from .scene_steps import applied

NEW_LIGHT = "FIPT New Light"
# A chrome ball shows a shadow, reflections and the light of the room at once.
INSERTED_KIND = "mirror_ball"


class RoomSteps:
    """The steps of one run; after a resume, any of them may be the first in this Blender.

    Args:
        options: the main job's options.
        run: its run folder.
    """

    def __init__(self, options: MainJobOptions, run: RunFolder) -> None:
        self._options = options
        self._run = run
        self._choice: tuple[str, Support | None] | None = None

    def import_room(self) -> Slices[list[Message]]:
        """Import the mesh and the cameras into an empty file, and show the options in its panel.

        Returns:
            Warnings.

        Raises:
            FiptError: ``mesh-missing``; those of the importers.
        """
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True, load_ui=False)
        if not read_capture(self._run.capture_json).mesh:
            raise FiptError("mesh-missing.import-room-3")
        show_options(bpy.context.scene, self._options, self._run)
        source = str(capture_source(self._options.capture.absolute()))
        return (yield from import_capture(self._run, source))

    def save(self) -> None:
        """Save room.blend with the applied results; an earlier one is kept as room_before.blend."""
        scene = bpy.context.scene
        applied(scene, self._run)
        if all(self._renders_made(kind).kept() is None for kind in RENDERS):
            shutil.rmtree(self._run.renders, ignore_errors=True)  # of another estimate
        cameras.use_view(scene, cameras.find_camera(self._view()[0], scene))
        enter_camera_on_opening()
        path = self._run.root / BLEND_NAME
        if path.exists():
            with atomic_path(path.with_stem(f"{path.stem}_before")) as before:
                shutil.copyfile(path, before)
        save_blend(path)
        path.with_suffix(".blend1").unlink(missing_ok=True)

    def _renders_made(self, kind: str) -> Made:
        """Whether renders of a kind show the room as it is applied now."""
        options, settings = self._options, self._options.settings
        how = options.render_spp, options.render_view, settings.seed, settings.clean_mesh, settings.write_back
        textures = content_digest(self._run.made("textures"))
        return Made(self._run, f"render-{kind}", textures, how, outputs=[self._run.renders_json])

    def render(self, kind: str) -> Slices[list[Message]]:
        """Make the renders of a kind, unless there are those of this room; returns warnings."""
        made = self._renders_made(kind)
        if (kept := made.kept()) is not None:
            return [as_message("warning", each) for each in kept]
        work = {"rerender": self.rerender, "relight": self.relight, "insert": self.insert}[kind]
        warnings: list[Message] = []
        with made.making(warnings):
            warnings += yield from work()
        return warnings

    def rerender(self) -> Slices[list[Message]]:
        """Render the chosen view and further held-back views, as photographed."""
        chosen, _ = self._view()
        views = preferred_views(read_capture(self._run.capture_json), self._options.render_view)
        others = [view.name for view in views if view.split == "held_back" and view.name != chosen]
        names = [chosen, *others[: MOST_RERENDERED - 1]]
        for done, name in enumerate(names, 1):
            self._render("rerender", name)
            yield done / len(names)
        return []

    def relight(self) -> Slices[list[Message]]:
        """Render the view with the estimated lights off and a new area light below the ceiling.

        Returns:
            A warning if the view's photograph is missing.
        """
        room = read_room(self._run)
        low, high = room.vertices.min(axis=0), room.vertices.max(axis=0)
        capture = read_capture(self._run.capture_json)
        eye_height = float(np.mean([view.camera_to_world[2][3] for view in capture.views]))
        (x, y, z), size = find_light_place(make_cast(room), low, high, eye_height)
        photographed, warnings = self.photographed_radiance(self._view()[0])
        power = room_light_power(float(np.median(photographed)), low, high)
        radiance = power / (np.pi * size**2)  # P = pi A L
        half, signs = 0.5 * size, ((-1, -1), (-1, 1), (1, 1), (1, -1))
        switch_all(False)
        light = add_area_light(NEW_LIGHT, [radiance] * 3, [(x + i * half, y + j * half, z) for i, j in signs])
        try:
            self._render("relight", self._view()[0])
        finally:
            bpy.data.objects.remove(light)
            switch_all(True)
        yield 1.0
        return warnings

    def insert(self) -> Slices[list[Message]]:
        """Render the view with an inserted object; a warning if there is no place for one."""
        view, support = self._view()
        if support is None:
            return [warning("surface-missing.insert", view=view)]
        point, size = Vector(support.point), 2.0 * support.radius
        inserted = add_ball(bpy.context.scene, point, INSERTED_KIND, size)
        try:
            self._render("insert", view)
        finally:
            bpy.data.objects.remove(inserted)
        yield 1.0
        return []

    def _render(self, kind: str, view: str) -> None:
        options = RenderOptions(self._options.render_spp, self._options.settings.seed)
        render_listed(self._run, bpy.context.scene, kind, view, options)

    def photographed_radiance(self, name: str) -> tuple[np.ndarray, list[Message]]:
        """Radiances (...) of a view's photograph; if that is missing, the median of all, and a warning.

        The values of a photograph that is not HDR are no radiances: the median of all takes their place.
        """
        view = preferred_views(read_capture(self._run.capture_json), name)[0]
        if view.encoded:
            return np.array([median_radiance(self._run)]), []
        try:
            return photograph(self._run, view), []
        except FiptError as error:
            if error.code != "image-missing":
                raise
            text = f"{error.text} The median of all photographs sets exposure and new lights instead."
            said = Problem(error.code, text, error.remedy)
            return np.array([median_radiance(self._run)]), [as_message("warning", said)]

    def _view(self) -> tuple[str, Support | None]:
        """The view to render, and a place in it for an object, if there is one."""
        if self._choice is None:
            views = preferred_views(read_capture(self._run.capture_json), self._options.render_view)
            geometry = [(view.name, view_geometry(view)) for view in views]
            self._choice = choose_view(make_cast(read_room(self._run)), geometry)
        return self._choice


def preferred_views(capture: CapturedViews, name: str = "") -> list[CapturedView]:
    """The capture's views, held-back ones first; with a name, only that view.

    Raises:
        FiptError: ``view-missing``.
    """
    views = [capture.view(name)] if name else capture.views
    return sorted(views, key=lambda view: view.split != "held_back")


@contextmanager
def panel_state() -> Iterator[None]:
    """Register the panel's state for a while; values set in that time are saved with the file."""
    if hasattr(bpy.types.Scene, "fipt"):
        yield
        return
    properties.register()
    try:
        yield
    finally:
        properties.unregister()


def show_options(scene: bpy.types.Scene, options: MainJobOptions, run: RunFolder) -> None:
    """Set the panel's state to a job's options, as far as the panel has them.

    Args:
        scene: inside `panel_state`.
        options: the job's options.
        run: its run folder.
    """
    state, settings = scene.fipt, options.settings
    state.run_folder = str(run.root)
    state.capture.path = str(capture_source(options.capture.absolute()))
    fill(state.capture, CaptureOptions, vars(options))
    state.parts.source = options.parts
    estimate, materials = state.estimate, state.materials
    estimate.preset = settings.preset
    preset = make_settings(settings.preset)
    for name, (of, *_) in properties.estimate.CHOICES.items():
        value = getattr(settings, of)
        if value != getattr(preset, of):
            setattr(estimate, name, value)
    if settings.device != "auto":
        estimate.device = settings.device
    fill(materials, TextureSettings, {**vars(settings), "texture_size": materials.texture_size})
    sizes = materials.bl_rna.properties["texture_size"].enum_items.keys()
    materials.texture_size = min(sizes, key=lambda size: abs(int(size) - settings.texture_size))
