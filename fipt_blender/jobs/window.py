"""What a job's timer makes Blender's windows do: redraw what shows the job, a notice, an undo step."""

from __future__ import annotations

import bpy


def redraw() -> None:
    """Redraw the sidebars, preferences and status bars, which show jobs."""
    for window in bpy.context.window_manager.windows:
        if not bpy.app.background and not window.modal_operators:  # their status text would be cleared
            # The status bar is not among the screen's areas; this also redraws it.
            window.workspace.status_text_set_internal(None)
        for area in window.screen.areas:
            if area.type in ("VIEW_3D", "PREFERENCES"):
                for region in area.regions:
                    if region.type in ("UI", "WINDOW") and (area.type, region.type) != ("VIEW_3D", "WINDOW"):
                        region.tag_redraw()


def show_notice(text: str, level: str) -> None:
    """Show a report in the status bar, whatever tab is open; level is "INFO", "WARNING" or "ERROR"."""
    windows = bpy.context.window_manager.windows
    if windows and not bpy.app.background:
        with bpy.context.temp_override(window=windows[0]):
            bpy.ops.fipt.notice("INVOKE_DEFAULT", text=text, level=level)


def _views() -> list[bpy.types.Area]:
    """The 3D views of all windows."""
    windows = bpy.context.window_manager.windows
    return [area for window in windows for area in window.screen.areas if area.type == "VIEW_3D"]


def shows_light() -> bool:
    """Whether a 3D view renders in Cycles, which takes seconds before its first picture."""
    engines = {window.scene.render.engine for window in bpy.context.window_manager.windows}
    return "CYCLES" in engines and any(area.spaces.active.shading.type == "RENDERED" for area in _views())


def open_sidebar() -> None:
    """Open our tab in the 3D views, where the sidebar is closed."""
    closed = [area for area in _views() if not area.spaces.active.show_region_ui]
    for area in closed:
        area.spaces.active.show_region_ui = True
    tries = iter(range(20))

    def show_tab() -> float | None:
        for region in (each for area in _views() for each in area.regions if each.type == "UI"):
            try:
                region.active_panel_category = "FIPT"
                region.tag_redraw()
            except (AttributeError, TypeError):  # a region has no tabs before it is drawn
                return None if next(tries, None) is None else 0.3
        return None

    if closed:
        bpy.app.timers.register(show_tab, first_interval=0.3)


def push_undo(text: str) -> None:
    """Add an undo step for a change that a timer made to Blender's data."""
    windows = bpy.context.window_manager.windows
    if windows:
        with bpy.context.temp_override(window=windows[0]):
            bpy.ops.ed.undo_push(message=text)
