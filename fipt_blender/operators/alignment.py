"""Operators of the panel Alignment: points of the mesh and of photographs; the cameras moved by them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..core.run.declared import Option
from ..core.run.errors import FiptError
from ..core.run.runfolder import RunFolder
from ..jobs.tasks import Task
from .action import RowIndex, action, row_index
from .pointer import NAVIGATION, ORIGIN, WHEEL, Point, WaitsForClicks, is_cancel, is_click, view_under_pointer
from .polls import has_views, in_object_mode, needs, no_job

if TYPE_CHECKING:
    from mathutils import Vector

    from ..blend.capture.pairs import PickedSight
    from ..bridge.job import Job
    from ..bridge.process import Message
    from ..bridge.step import Slices

_MESH_TEXT = "Click: Point of the mesh   Ctrl: Do not snap to corners   Esc, Right Click: Cancel"
_PHOTO_TEXT = "Click: The same point in the photograph   Page Up, Page Down: Other view   Esc: Cancel"
_SECOND_TEXT = (
    "Click: The same point in a second photograph   Page Up, Page Down: Other view"
    "   Enter: Finish with one photograph   Esc: Cancel"
)
_MOUSE = ("LEFTMOUSE", "MOUSEMOVE", "INBETWEEN_MOUSEMOVE")
_CONFIRM = ("RET", "NUMPAD_ENTER", "SPACE")
_STEPS = {"PAGE_UP": -1, "PAGE_DOWN": 1}


_has_pairs = needs(lambda context: context.scene.fipt.alignment.pairs, "Pick points first")


class _PicksPair(WaitsForClicks):
    """Base of an action on a point of the mesh and the same point in photographs, which the artist clicks."""

    text_in_header = True

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if self.properties.is_property_set("location"):
            return self.execute(context)
        if not self.is_in_viewport(context):
            return {"CANCELLED"}
        self._picked: tuple[str, Vector] | None = None
        self._sights: list[PickedSight] = []
        settings = context.scene.fipt.capture
        self._shown = {
            name: getattr(settings, name) for name in ("photograph_opacity", settings.photograph_switch())
        }
        self._before = (settings.active_view, self._leave_camera(context))
        return self.wait_for_clicks(context, _MESH_TEXT)

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if is_cancel(event):
            self.cancel(context)
            return {"CANCELLED"}
        # While photographs are clicked, the list of views in the sidebar stays usable.
        beside = self._picked is not None and view_under_pointer(context, event) is None
        if event.type in (*NAVIGATION, *WHEEL) or (beside and event.type in _MOUSE):
            return {"PASS_THROUGH"}
        if event.value != "PRESS":
            return {"RUNNING_MODAL"}
        if self._picked is not None and event.type in _STEPS:
            self._look(context, context.scene.fipt.capture.active_view + _STEPS[event.type])
        elif self._sights and event.type in _CONFIRM:
            return self._finish(context)
        elif is_click(event) and view_under_pointer(context, event) is not None:
            pick = self._pick_mesh if self._picked is None else self._pick_photograph
            return pick(context, event)
        return {"RUNNING_MODAL"}

    def _pick_mesh(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        from ..blend.capture.picking import mesh_under

        self._picked = mesh_under(context, *_place(context, event), snap=not event.ctrl)
        if self._picked is None:
            self.report({"WARNING"}, "There is no mesh under the mouse pointer")
            return {"RUNNING_MODAL"}
        settings = context.scene.fipt.capture
        settings.photograph_opacity = 1.0
        setattr(settings, settings.photograph_switch(), True)
        self._look(context, settings.active_view)
        self.say(context, _PHOTO_TEXT)
        return {"RUNNING_MODAL"}

    def _pick_photograph(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        from ..blend.capture.pairs import MOST_SIGHTS
        from ..blend.capture.picking import photograph_under

        sight = photograph_under(context, *_place(context, event))
        if sight is None:
            self.report({"WARNING"}, "Click inside the photograph of a view")
            return {"RUNNING_MODAL"}
        self._sights = [other for other in self._sights if other.view != sight.view] + [sight]
        if len(self._sights) >= min(MOST_SIGHTS, len(context.scene.fipt.capture.views)):
            return self._finish(context)
        self.say(context, _SECOND_TEXT)
        return {"RUNNING_MODAL"}

    def _finish(self, context: bpy.types.Context) -> set[str]:
        assert self._picked is not None
        self.object, self.location = self._picked
        self.view, self.pixel = self._sights[0].view, (self._sights[0].u, self._sights[0].v)
        if len(self._sights) > 1:
            self.second_view = self._sights[1].view
            self.second_pixel = (self._sights[1].u, self._sights[1].v)
        self.cancel(context)
        return self.execute(context)

    def _look(self, context: bpy.types.Context, index: int) -> None:
        """Look through a view of the list, in the viewport in which picking started."""
        from ..blend.capture.look import look_through

        settings = context.scene.fipt.capture
        settings.active_view = index % len(settings.views)
        look_through(context.scene, settings.views[settings.active_view], context)

    def _leave_camera(self, context: bpy.types.Context) -> bool:
        """Turn from a camera to a free view, in which the mesh can be seen; whether it was one."""
        region = context.space_data.region_3d
        was_camera = region.view_perspective == "CAMERA"
        if was_camera:
            region.view_perspective = "PERSP"
        return bool(was_camera)

    def cancel(self, context: bpy.types.Context) -> None:
        """Stop waiting and restore the viewport."""
        super().cancel(context)
        settings = context.scene.fipt.capture
        active, was_camera = self._before
        for name, value in self._shown.items():
            setattr(settings, name, value)
        if context.area is None:
            return
        if was_camera and settings.views:
            self._look(context, active)
        elif self._picked is not None:
            context.space_data.region_3d.view_perspective = "PERSP"


@action("Pick Points", needs=(has_views, in_object_mode), bases=(_PicksPair,))
def pick_pair(
    scene: bpy.types.Scene,
    object: Annotated[str, "Mesh object"] = "",
    location: Annotated[Point, Option("Point on the mesh in world space", shown={"subtype": "XYZ"})] = ORIGIN,
    view: Annotated[str, "Name of the view with the photograph"] = "",
    pixel: Annotated[tuple[float, float], "The point in its photograph"] = (0.0, 0.0),
    second_view: Annotated[str, "Name of another view, or empty"] = "",
    second_pixel: Annotated[tuple[float, float], "The point in its photograph"] = (0.0, 0.0),
) -> None:
    """Pick a point on the mesh, then the same point in one or two photographs."""
    from mathutils import Vector

    from ..blend.capture.pairs import PickedSight, add_pair

    item = scene.objects.get(object)
    if item is None or item.type != "MESH":
        raise FiptError("room-missing.pick-pair", object=object)
    picked = [(view, *pixel), *([(second_view, *second_pixel)] if second_view else ())]
    add_pair(scene, item, Vector(location), [PickedSight(*sight) for sight in picked])


@action("Remove Pair", needs=(_has_pairs,), listed=False)
def remove_pair(scene: bpy.types.Scene, index: RowIndex = -1) -> None:
    """Remove this pair of points."""
    from ..blend.capture import pairs

    settings = scene.fipt.alignment
    pairs.remove_pair(scene, row_index(settings.pairs, index, settings.active_pair))


@action("Align Cameras by Pairs", needs=(_has_pairs, in_object_mode))
def align_by_pairs(scene: bpy.types.Scene) -> str:
    """Move all cameras to the mesh, with any rotation and scale, so that the picked points agree."""
    from ..blend.capture import pairs

    fit = pairs.align_by_pairs(scene)
    text = iface_("The cameras were aligned by {} pairs, which are off by {:.3g} m")
    return text.format(len(fit.residuals), fit.error)


@action("Refine by Points", needs=(has_views, in_object_mode, no_job))
def refine_alignment(scene: bpy.types.Scene) -> Task:
    """Move the cameras onto the mesh by the points of their solve or their depth images. They must be nearly
    right, by pairs of points for example. The mesh stays.
    """

    def make(scene: bpy.types.Scene) -> Job:
        from ..blend.capture.pairs import imported_cameras
        from ..bridge.step import Step
        from ..jobs.run_job import open_job

        imported_cameras(scene)  # raises before anything is written
        run = RunFolder(bpy.path.abspath(scene.fipt.run_folder))
        target = RunFolder(run.align)

        def write_input() -> Slices[list[Message]]:
            from ..blend.capture.survey import write_views_and_room

            target.root.mkdir(exist_ok=True)
            return write_views_and_room(run, target)

        settings = scene.fipt.capture
        command = ["align", str(target.root), settings.imported_path, f"--format={settings.format}"]
        text = "Aligning the cameras to the mesh"
        steps = [
            Step("align-input", "Preparing the room", 3.0, function=write_input),
            Step("align", text, 5.0, command=command),
        ]
        return open_job(run, steps)

    def finished(scene: bpy.types.Scene, run: RunFolder) -> None:
        from ..blend.capture.pairs import take_alignment

        take_alignment(scene, run)

    return Task("Refine by Points", "align", make, finished, undo=True)


def _place(
    context: bpy.types.Context, event: bpy.types.Event
) -> tuple[bpy.types.Region, bpy.types.SpaceView3D, tuple[float, float]]:
    """The viewport under the pointer, and the pointer's position in it."""
    found = view_under_pointer(context, event)
    assert found is not None
    region, space = found
    return region, space, (event.mouse_x - region.x, event.mouse_y - region.y)
