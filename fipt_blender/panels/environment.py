# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How the preferences are drawn: the engine's status, its set-up, the device, the cached runs."""

from __future__ import annotations

import re
import time
from collections.abc import Sequence
from typing import Any

import bpy
from bpy.app.translations import pgettext_iface as iface_

from .. import running
from ..core.job.runfolder import PRODUCT_VERSION
from .sidebar import draw_text

_KIND = "environment"
_PACKAGES = (("mitsuba", "Mitsuba"), ("drjit", "Dr.Jit"), ("torch", "PyTorch"), ("numpy", "NumPy"))


def draw(layout: bpy.types.UILayout, context: bpy.types.Context, preferences: Any, facts: Facts) -> None:
    """Draw all of the preferences."""
    layout.use_property_decorate = False
    _draw_engine(layout.box(), context, preferences, facts)
    _draw_device(layout.box(), preferences, facts)
    _draw_data(layout.box(), context, preferences, facts)


class Facts:
    """What the drawing is about, besides the preferences' values: looked up before, never while drawing.

    Args:
        status: what set-up or check said last (see datajob.EngineStatus); empty before.
        usage: sizes by folder name, and which are runs; empty before they were measured.
        data_folder: where data lies when the preference names no folder.
    """

    def __init__(self, status: dict[str, Any], usage: dict[str, Any], data_folder: str) -> None:
        self.status = status
        self.engine: dict[str, Any] = status.get("engine") or {}
        self.usage = usage
        self.data_folder = data_folder


def _draw_engine(
    layout: bpy.types.UILayout, context: bpy.types.Context, preferences: Any, facts: Facts
) -> None:
    busy = running.current()
    if busy is not None and busy.kind == _KIND:
        _draw_running(layout, context, busy)
    else:
        text, icon = headline(facts.status)
        layout.label(text=text, icon=icon)
        _draw_facts(layout, facts)
        _draw_problems(layout, context, facts)
    row = layout.row(align=True)
    row.operator("fipt.set_up_engine", icon="IMPORT")
    row.operator("fipt.check_engine", icon="VIEWZOOM")
    row.operator("fipt.show_log", text="Show Log", icon="TEXT")
    column = layout.column()
    column.use_property_split = True
    column.prop(preferences, "engine_python")
    row = column.row(align=True)
    row.prop(preferences, "wheel_folder")
    row.operator("fipt.copy_wheel_command", text="", icon="COPYDOWN")
    if not (bpy.app.online_access or preferences.wheel_folder or preferences.engine_python):
        draw_text(
            layout,
            context,
            iface_(
                "Blender may not go online. To set the engine up, allow online access in System > Network, or"
                " choose a folder of wheels; the button beside it copies the command that fills one on a"
                " machine with network."
            ),
            icon="INTERNET_OFFLINE",
        )


def headline(status: dict[str, Any]) -> tuple[str, str]:
    """The engine's state in a few words, and its icon."""
    engine = status.get("engine") or {}
    if not status:
        return iface_("Engine: not set up yet, or not checked"), "QUESTION"
    if status.get("error") or not engine.get("ready"):
        return iface_("Engine: does not work yet"), "ERROR"
    if status.get("product_version") != PRODUCT_VERSION:
        return iface_("Engine: the add-on was updated since; press Check"), "QUESTION"
    device = engine["cuda"] if engine["device"] == "cuda" else iface_("the CPU")
    return iface_("Engine: ready, computes on {}").format(device), "CHECKMARK"


def _draw_running(layout: bpy.types.UILayout, context: bpy.types.Context, busy: running.RunningJob) -> None:
    layout.label(text=busy.title, icon="SORTTIME")
    text = iface_("{:.0f} %").format(100.0 * busy.fraction)
    if busy.remaining_seconds is not None:
        minutes, seconds = divmod(int(busy.remaining_seconds), 60)
        text = iface_("{}, about {}:{:02d} left").format(text, minutes, seconds)
    row = layout.split(factor=0.85, align=True)
    row.progress(factor=busy.fraction, text=text)
    sub = row.row(align=True)
    sub.enabled = not busy.stopping
    sub.operator("fipt.cancel_set_up", icon="X")
    draw_text(layout, context, iface_("Stopping") if busy.stopping else iface_(busy.stage_text))


def fact_lines(engine: dict[str, Any]) -> list[tuple[str, str]]:
    """What the check found, as label and value."""
    packages = engine["packages"]
    named = [f"{label} {packages[name]}" for name, label in _PACKAGES if packages.get(name)]
    lines = [
        (iface_("Interpreter"), f"Python {engine['python']}, {engine['interpreter']}"),
        (iface_("Packages"), ", ".join(named)),
    ]
    if engine["gpus"]:
        cards = [f"{gpu['name']} ({gpu['memory_gb']:.0f} GB)" for gpu in engine["gpus"]]
        lines.append((iface_("Graphics Card"), ", ".join(cards)))
    else:
        lines.append((iface_("Graphics Card"), iface_("none with CUDA")))
    cpu = iface_("{} cores").format(engine["cores"])
    lines.append((iface_("Processor"), f"{cpu}, {_llvm_text(engine['llvm'])}"))
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


def _draw_facts(layout: bpy.types.UILayout, facts: Facts) -> None:
    if not facts.engine:
        return
    lines = fact_lines(facts.engine)
    checked = time.strftime("%Y-%m-%d %H:%M", time.localtime(facts.status["time"]))
    _draw_table(layout, [*lines, (iface_("Checked"), checked)])


def _draw_table(layout: bpy.types.UILayout, lines: Sequence[tuple[str, str]]) -> None:
    split = layout.split(factor=0.2)
    names, values = split.column(align=True), split.column(align=True)
    for column in (names, values):
        column.scale_y = 0.8
    names.alignment = "RIGHT"
    for name, value in lines:
        names.label(text=name, translate=False)
        values.label(text=value, translate=False)


def _draw_problems(layout: bpy.types.UILayout, context: bpy.types.Context, facts: Facts) -> None:
    error = facts.status.get("error")
    if error:
        _draw_problem(layout, context, error, "ERROR")
    for warning in facts.status.get("warnings", ()):
        _draw_problem(layout, context, warning, "INFO")


def _draw_problem(
    layout: bpy.types.UILayout, context: bpy.types.Context, message: dict[str, Any], icon: str
) -> None:
    text = f"{iface_(message['text'])} {iface_(message['remedy'])}"
    draw_text(layout, context, text, icon=icon, alert=icon == "ERROR")


def _draw_device(layout: bpy.types.UILayout, preferences: Any, facts: Facts) -> None:
    layout.use_property_split = True
    layout.row().prop(preferences, "device", expand=True)
    column = layout.column()
    column.enabled = preferences.device != "llvm" and bool(facts.engine.get("gpus"))
    column.prop(preferences, "gpu")


def _draw_data(
    layout: bpy.types.UILayout, context: bpy.types.Context, preferences: Any, facts: Facts
) -> None:
    layout.use_property_split = True
    layout.prop(preferences, "data_folder", placeholder=facts.data_folder)
    row = layout.row(align=True)
    row.label(text=usage_text(facts.usage), translate=False)
    row.operator("fipt.measure_data", icon="FILE_REFRESH")
    row.operator("fipt.clear_data", text="Clear...", icon="TRASH")
    layout.prop(preferences, "on_close")


def usage_text(usage: dict[str, Any]) -> str:
    """How large the data is, in a line."""
    if not usage:
        return iface_("Size of cached runs: not measured yet")
    runs = [usage["sizes"][name] for name in usage["runs"]]
    others = sum(usage["sizes"].values()) - sum(runs)
    return iface_("{} cached runs: {:.1f} GB; engine: {:.1f} GB").format(
        len(runs), sum(runs) / 1e9, others / 1e9
    )
