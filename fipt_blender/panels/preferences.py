"""The add-on's preferences and their drawing: the engine, the device, the data folder."""

from __future__ import annotations

import re
import time
from typing import Any

import bpy
from bpy.app.translations import pgettext_iface as iface_
from bpy.types import Context, UILayout

from .. import machine
from ..bridge import places
from ..core.run.runfolder import PRODUCT_VERSION
from ..core.run.settings import DEVICES
from ..jobs import running
from .engine import draw_online_access
from .progress import draw_progress
from .sidebar import draw_text

PIE = "FIPT_MT_pie"  # the pie menu
# Its key until it is changed in the preferences.
PIE_KEY = {"type": "F", "value": "PRESS", "shift": True, "alt": True}
_PACKAGES = (("mitsuba", "Mitsuba"), ("drjit", "Dr.Jit"), ("torch", "PyTorch"), ("numpy", "NumPy"))

# Blender holds no reference to the strings that a callback returns, so they are kept here.
_gpu_items: list[tuple[str, str, str]] = []


def _changed(preferences: machine.Preferences, context: Context) -> None:
    machine.keep()


def _engine_changed(preferences: machine.Preferences, context: Context) -> None:
    preferences.status = ""  # of the previous engine; its update also stores the new value


def _list_gpus(preferences: machine.Preferences, context: Context | None) -> list[tuple[str, str, str]]:
    known = (machine.status().get("engine") or {}).get("gpus") or []
    gpus = [(gpu["uuid"], gpu["name"], f"{gpu['memory_gb']:.0f} GB") for gpu in known]
    if preferences.gpu_uuid and preferences.gpu_uuid not in [uuid for uuid, _, _ in gpus]:
        gpus.append((preferences.gpu_uuid, "Missing GPU", "This GPU is not in the machine"))
    _gpu_items[:] = [("AUTO", "Automatic", "Use the first GPU that works"), *gpus]
    return _gpu_items


def _get_gpu(preferences: machine.Preferences) -> int:
    uuids = [uuid for uuid, _, _ in _list_gpus(preferences, None)]
    return uuids.index(preferences.gpu_uuid) if preferences.gpu_uuid in uuids else 0


def _set_gpu(preferences: machine.Preferences, value: int) -> None:
    preferences.gpu_uuid = "" if value == 0 else _list_gpus(preferences, None)[value][0]


class FIPT_Preferences(bpy.types.AddonPreferences):
    """Settings of the machine, independent of scenes."""

    bl_idname = machine.ADDON

    engine_python: bpy.props.StringProperty(
        name="Own Interpreter",
        description="Python interpreter or virtual environment that has the engine's packages. If empty, the"
        " environment that Set Up Engine creates is used",
        subtype="FILE_PATH",
        update=_engine_changed,
    )
    wheel_folder: bpy.props.StringProperty(
        name="Folder of Wheels",
        description="Install the Python packages from .whl files in this folder instead of downloading them",
        subtype="DIR_PATH",
        update=_changed,
    )
    device: bpy.props.EnumProperty(
        name="Compute On",
        description="Device on which the engine computes",
        items=DEVICES,
        default="auto",
        update=_changed,
    )
    gpu: bpy.props.EnumProperty(
        name="GPU",
        description="GPU that the engine uses. Check finds the GPUs of this machine",
        items=_list_gpus,
        get=_get_gpu,
        set=_set_gpu,
    )
    data_folder: bpy.props.StringProperty(
        name="Data Folder",
        description="Folder for runs and the engine's environment. If empty, a folder in your user data is"
        " used. Updating or removing the extension does not change it",
        subtype="DIR_PATH",
        update=_engine_changed,
    )
    gpu_uuid: bpy.props.StringProperty(options={"HIDDEN"}, update=_changed)
    status: bpy.props.StringProperty(
        description="Last result of Set Up Engine or Check, as JSON", options={"HIDDEN"}, update=_changed
    )

    def draw(self, context: Context) -> None:
        draw(self.layout, context, self)


def draw(layout: UILayout, context: Context, preferences: machine.Preferences) -> None:
    """Draw all of the preferences, without a look at the disk."""
    layout.use_property_decorate = False
    _draw_engine(layout.box(), context, preferences)
    box = layout.box()
    box.use_property_split = True
    box.row().prop(preferences, "device", expand=True)
    column = box.column()
    column.enabled = preferences.device != "llvm" and bool((machine.status().get("engine") or {}).get("gpus"))
    column.prop(preferences, "gpu")
    box = layout.box()
    box.use_property_split = True
    box.prop(preferences, "data_folder", placeholder=str(places.default_data_folder()))
    box.operator("fipt.clear_data", text="Clear...", icon="TRASH")
    _draw_shortcut(layout.box(), context)


def _draw_engine(layout: UILayout, context: Context, preferences: machine.Preferences) -> None:
    job = running.current()
    if job is not None and job.kind == running.DATA_KIND:
        draw_progress(layout, context, job)
    else:
        _draw_status(layout, machine.status())
    row = layout.row(align=True)
    row.operator("fipt.set_up_engine", icon="IMPORT")
    row.operator("fipt.check_engine", icon="VIEWZOOM")
    row.operator("wm.path_open", text="Show Log", icon="TEXT").filepath = str(machine.set_up_log())
    column = layout.column()
    column.use_property_split = True
    column.prop(preferences, "engine_python")
    row = column.row(align=True)
    row.prop(preferences, "wheel_folder")
    row.operator("fipt.copy_wheel_command", text="", icon="COPYDOWN")
    if not (preferences.wheel_folder or preferences.engine_python):
        if text := draw_online_access(layout):
            draw_text(layout, text, icon="INTERNET_OFFLINE")


def _draw_status(layout: UILayout, status: machine.Status) -> None:
    """What set-up or check has found, see `data_job.EngineStatus`, and what helps."""
    text, icon = headline(status)
    layout.label(text=text, icon=icon)
    if engine := status.get("engine"):
        checked = time.strftime("%Y-%m-%d %H:%M", time.localtime(status["time"]))
        split = layout.split(factor=0.2)
        names, values = split.column(align=True), split.column(align=True)
        names.scale_y = values.scale_y = 0.8
        names.alignment = "RIGHT"
        for name, value in (*fact_lines(engine), (iface_("Checked"), checked)):
            names.label(text=name, translate=False)
            values.label(text=value, translate=False)
    if _set_up_cancelled(status):
        return
    if error := status.get("error"):
        draw_text(layout, f"{iface_(error['text'])} {iface_(error['remedy'])}", icon="ERROR", alert=True)
    for warning in status.get("warnings", ()):
        draw_text(layout, f"{iface_(warning['text'])} {iface_(warning['remedy'])}", icon="INFO")


def headline(status: machine.Status) -> tuple[str, str]:
    """The engine's state as text and icon."""
    engine = status.get("engine") or {}
    if _set_up_cancelled(status):
        return iface_("Engine: set-up cancelled, press Set Up Engine to continue"), "CANCEL"
    if not status:
        return iface_("Engine: not set up yet, or not checked"), "QUESTION"
    if status.get("error") or not engine.get("ready"):
        return iface_("Engine: does not work yet"), "ERROR"
    if status.get("product_version") != PRODUCT_VERSION:
        return iface_("Engine: the add-on was updated, press Check"), "QUESTION"
    device = engine["cuda"] if engine["device"] == "cuda" else iface_("the CPU")
    return iface_("Engine: ready, computes on {}").format(device), "CHECKMARK"


def _set_up_cancelled(status: machine.Status) -> bool:
    """Whether a set-up was cancelled where no engine works; an earlier error is out of date then."""
    ready = (status.get("engine") or {}).get("ready") and not status.get("error")
    return bool(status.get("cancelled")) and not ready


def fact_lines(engine: dict[str, Any]) -> list[tuple[str, str]]:
    """The results of the check, as label and value."""
    packages = engine["packages"]
    named = [f"{label} {packages[name]}" for name, label in _PACKAGES if packages.get(name)]
    lines = [
        (iface_("Interpreter"), f"Python {engine['python']}, {engine['interpreter']}"),
        (iface_("Packages"), ", ".join(named)),
    ]
    if engine["gpus"]:
        cards = [f"{gpu['name']} ({gpu['memory_gb']:.0f} GB)" for gpu in engine["gpus"]]
        lines.append((iface_("GPU"), ", ".join(cards)))
    else:
        lines.append((iface_("GPU"), iface_("none with CUDA")))
    cpu = iface_("{} cores").format(engine["cores"])
    lines.append((iface_("CPU"), f"{cpu}, {_llvm_text(engine['llvm'])}"))
    if engine["memory_free_gb"] is not None:
        memory = iface_("{:.0f} of {:.0f} GB free").format(engine["memory_free_gb"], engine["memory_gb"])
        lines.append((iface_("Memory"), memory))
    lines.append((iface_("Denoiser"), iface_("works") if engine["oidn"] else iface_("does not work")))
    return lines


def _llvm_text(path: str | None) -> str:
    if path is None:
        return iface_("no LLVM")
    version = re.search(r"LLVM[^\d]*(\d+(?:\.\d+)?)", path.replace("\\", "/").rpartition("/")[2])
    return f"LLVM {version.group(1)}" if version else f"LLVM ({path})"


def _draw_shortcut(layout: UILayout, context: Context) -> None:
    """The pie menu's key, to be changed in the preferences."""
    configuration = context.window_manager.keyconfigs.user
    keymap = None if configuration is None else configuration.keymaps.get("3D View")
    items = [] if keymap is None else keymap.keymap_items
    for item in items:
        if item.idname == "wm.call_menu_pie" and item.properties.name == PIE:
            row = layout.row(align=True)
            row.label(text="Pie Menu in 3D Viewports", icon="EVENT_OS")
            row.prop(item, "active", text="")
            row.prop(item, "type", text="", full_event=True)
