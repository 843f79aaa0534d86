"""Hides the other views' cameras and their parent while the artist looks through one, with their lines.

Blender does not report that a 3D view leaves its camera, therefore a timer watches the 3D views. Files are
saved with the cameras shown. Cameras that the artist has hidden stay hidden. Imported while Blender starts:
needs bpy alone.
"""

from __future__ import annotations

import bpy

from ..marks import LOOKED_PAST, all_view_cameras, is_view, remove_marks

# Scenes that 3D views show through a view's camera, and the camera for which the others were hidden, by name.
hidden_for: dict[str, str] = {}


def watch(scene: bpy.types.Scene) -> None:
    """Hide the other cameras of a scene as long as a 3D view looks through one; nothing in background."""
    if bpy.app.background:
        return
    hidden_for.setdefault(scene.name, "")
    if not bpy.app.timers.is_registered(tick):
        bpy.app.timers.register(tick, first_interval=0.0, persistent=True)


def hide_others(scene: bpy.types.Scene, camera: bpy.types.Object) -> None:
    """Hide all view cameras but one in the view layers that are open."""
    show_all(scene)
    for layer in _open_layers(scene):
        items = [
            item
            for item in _in_the_way(scene)
            if item != camera and item.name in layer.objects and not item.hide_get(view_layer=layer)
        ]
        for item in items:
            selected = {layer.name: item.select_get(view_layer=layer)}
            item[LOOKED_PAST] = {**item.get(LOOKED_PAST, {}), **selected}
        for item in items:
            item.hide_set(True, view_layer=layer)


def show_all(scene: bpy.types.Scene) -> None:
    """Show the cameras again that `hide_others` has hidden, selected as they were."""
    items = [item for item in _in_the_way(scene) if LOOKED_PAST in item]
    for item in items:
        for name, selected in item[LOOKED_PAST].items():
            layer = scene.view_layers.get(name)
            if layer is None or item.name not in layer.objects or not item.hide_get(view_layer=layer):
                continue
            item.hide_set(False, view_layer=layer)
            if selected:
                item.select_set(True, view_layer=layer)
        remove_marks(item, LOOKED_PAST)


def register() -> None:
    """Install the handlers."""
    for handlers, function in _HANDLERS:
        handlers.append(function)


def unregister() -> None:
    """Remove handlers and timer, and show all cameras."""
    for handlers, function in _HANDLERS:
        handlers.remove(function)
    if bpy.app.timers.is_registered(tick):
        bpy.app.timers.unregister(tick)
    _before_saving()
    hidden_for.clear()


def tick() -> float | None:
    """Follow what the 3D views show; ends when no scene is looked at through a view any more."""
    for name, camera_name in list(hidden_for.items()):
        scene = bpy.data.scenes.get(name)
        camera = None if scene is None else _looked_through(scene)
        if scene is None or camera is None:
            del hidden_for[name]
            if scene is not None:
                show_all(scene)
                _show_as_median(scene)
        elif camera.name != camera_name:
            hide_others(scene, camera)
            hidden_for[name] = camera.name
    return 0.25 if hidden_for else None  # between two looks at the 3D views


def _show_as_median(scene: bpy.types.Scene) -> None:
    from ..render_settings import follow_exposure

    follow_exposure(scene, 0.0)


def _looked_through(scene: bpy.types.Scene) -> bpy.types.Object | None:
    """The view's camera through which a 3D view of the scene looks, if any."""
    camera = scene.camera
    if camera is None or not is_view(camera):
        return None
    spaces = (
        area.spaces.active
        for window in bpy.context.window_manager.windows
        if window.scene == scene
        for area in window.screen.areas
        if area.type == "VIEW_3D"
    )
    return camera if any(space.region_3d.view_perspective == "CAMERA" for space in spaces) else None


def _in_the_way(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The cameras of views, and their parent, unless the artist is moving it; its line goes with it."""
    parent = scene.fipt.capture.alignment
    is_moved = parent is None or (LOOKED_PAST not in parent and parent.select_get())
    return [*all_view_cameras(scene), *([] if is_moved else [parent])]


def _open_layers(scene: bpy.types.Scene) -> list[bpy.types.ViewLayer]:
    """The view layers of a scene that windows show."""
    windows = [window for window in bpy.context.window_manager.windows if window.scene == scene]
    return list({window.view_layer.name: window.view_layer for window in windows}.values())


@bpy.app.handlers.persistent
def _before_saving(*_: object) -> None:
    """Save files with all cameras shown; the timer hides them again."""
    for name in hidden_for:
        scene = bpy.data.scenes.get(name)
        if scene is not None:
            show_all(scene)
            hidden_for[name] = ""


@bpy.app.handlers.persistent
def _after_undo(*_: object) -> None:
    """Hide or show again what an undo or redo has changed."""
    for name in hidden_for:
        hidden_for[name] = ""
    _watch_marked()


@bpy.app.handlers.persistent
def _after_loading(*_: object) -> None:
    """Forget the scenes of the file before, and hide cameras where its 3D views look through one."""
    hidden_for.clear()
    _watch_marked()


def _watch_marked() -> None:
    """Watch scenes seen through a view, and those with hidden cameras, as automatically saved files have."""
    for scene in bpy.data.scenes:
        if _looked_through(scene) is not None or any(LOOKED_PAST in item for item in _in_the_way(scene)):
            watch(scene)


_HANDLERS = (
    (bpy.app.handlers.save_pre, _before_saving),
    (bpy.app.handlers.undo_post, _after_undo),
    (bpy.app.handlers.redo_post, _after_undo),
    (bpy.app.handlers.load_post, _after_loading),
)
