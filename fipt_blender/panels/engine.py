"""Set Up Engine in the side panel: what it is, its size, its progress, online access."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as iface_
from bpy.types import UILayout

from .. import machine
from ..jobs import running, setup_size
from .progress import draw_progress
from .sidebar import draw_text


def draw_set_up(layout: UILayout) -> None:
    """The way to a working engine: its progress, or the button with all that must be known before."""
    job = running.current()
    if job is not None and job.kind == running.DATA_KIND:
        draw_progress(layout, bpy.context, job)
        return
    _draw_problem(layout)
    text = iface_(
        "The engine computes materials and lights. It gets a Python environment of its own beside Blender's."
    )
    draw_text(layout, text, icon="INFO")
    values = machine.get_preferences()
    local = bool(values.wheel_folder)
    if not local:
        size = setup_size.known_size()
        if size is not None:
            text = iface_("Downloads about {:.1f} GB and needs {:.1f} GB on the disk.")
            draw_text(layout, text.format(size.download_gb, size.disk_gb))
    online = None if local else draw_online_access(layout)
    column = layout.column()
    column.scale_y = 1.4
    column.operator("fipt.set_up_engine", icon="IMPORT").confirmed = True
    row = layout.row(align=True)
    row.operator("preferences.addon_show", text="Other Ways...", icon="PREFERENCES").module = machine.ADDON
    if machine.status():
        row.operator("wm.path_open", text="Show Log", icon="TEXT").filepath = str(machine.set_up_log())
    if online:
        draw_text(layout, online, icon="INTERNET_OFFLINE")


def _draw_problem(layout: UILayout) -> None:
    """Why the last set-up or check has not led to a working engine."""
    status = machine.status()
    error = status.get("error")
    if status.get("cancelled"):
        text = iface_("The set-up was cancelled. What was downloaded is kept.")
        draw_text(layout, text, icon="CANCEL")
    elif error:
        text = f"{iface_(error['text'])} {iface_(error['remedy'])}"
        draw_text(layout, text, icon="ERROR", alert=True)


def draw_online_access(layout: UILayout) -> str:
    """Blender's own switch, which only the user may set, and which keeps its place; what to say below it."""
    if not getattr(bpy.app, "online_access_override", False):
        row = layout.row()
        row.use_property_split = False
        row.prop(bpy.context.preferences.system, "use_online_access", text="Allow Online Access", toggle=True)
        text = "Blender may not use the internet yet. Allow it for the download; nothing else here is online."
    else:
        text = (
            "Blender was started offline. Start it without --offline-mode, or select a Folder of Wheels in"
            " the preferences: the button beside it copies a command that downloads the wheels elsewhere."
        )
    return "" if bpy.app.online_access else iface_(text)
