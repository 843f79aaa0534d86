"""The section Estimate: starts the engine's run, shows its state, settings, parts and versions."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import bpy
from bpy.app.translations import pgettext_iface as iface_
from bpy.types import Context, PropertyGroup, UILayout

from ..blend.previews import estimate_pictures
from ..core.capture.options import PART_SOURCES
from ..core.run.runfolder import RunFolder
from ..jobs import running, runstate
from ..jobs.job_scene import uses_run_folder
from ..properties.estimate import CHOICES
from . import path
from .capture import draw_thumbnail, shown_colors
from .job import draw_error, draw_job, draw_warnings, job_warnings
from .presets import draw_estimate_presets
from .progress import draw_progress, status_text
from .sidebar import draw_text, panel

if TYPE_CHECKING:
    from ..bridge.job import Job
    from ..core.run.light_size import LightPlan
    from ..core.run.versions import Version


@panel("Estimate", 3, shown=path.has_run, state=path.estimate_state)
def FIPT_PT_estimate(layout: UILayout, context: Context) -> None:
    """Estimate the materials and lights of the room"""
    state = runstate.known(context.scene.fipt.run_folder)
    job = running.current()
    if path.has_views(context) and not path.has_results(context):  # the section Capture is closed
        draw_thumbnail(layout, context.scene.fipt.capture)
    is_running = draw_job(layout, context, "estimate")
    if is_running:
        assert job is not None
        _draw_pictures(layout, tuple(job.pictures))
    elif job is not None and job.kind == "materials" and uses_run_folder(context.scene, job.run_folder):
        draw_progress(layout, context, job)
    elif state.finished:
        if not path.has_results(context):
            column = layout.column()
            column.scale_y = 1.4
            column.operator("fipt.apply_results", icon="MATERIAL")
            draw_job(layout, context, "materials")
        _draw_done(layout, context, state)
    else:
        _draw_start(layout, context, state)
        if job is None or not uses_run_folder(context.scene, job.run_folder):
            _draw_state(layout, context, state)
    elsewhere = () if is_running else state.warnings  # by another Blender
    draw_warnings(layout, "estimate", job_warnings(context, "estimate") or elsewhere)


@panel("Advanced", 2, parent="FIPT_PT_estimate", closed=True)
def FIPT_PT_estimate_advanced(layout: UILayout, context: Context) -> None:
    """Change single settings of the preset"""
    layout.enabled = running.current() is None
    settings = context.scene.fipt.estimate
    layout.prop(settings, "apply_when_finished")
    column = layout.column(align=True)
    for name in CHOICES:
        row = column.row(align=True)
        row.prop(settings, name)
        if settings.is_changed(name):  # back to the preset
            row.operator("fipt.reset_setting", text="", icon="LOOP_BACK", emboss=False).setting = name


def _draw_start(layout: UILayout, context: Context, state: runstate.RunState) -> None:
    """The preset, what it costs, and the buttons that start; without a mesh, the way to one."""
    settings, job = context.scene.fipt.estimate, running.current()
    if path.has_views(context) and not context.scene.fipt.capture.room_objects(context.scene):
        text = "The room has no mesh. Import one, or select the objects that form the room."
        draw_text(layout, iface_(text), icon="INFO")
        column = layout.column(align=True)
        column.operator("fipt.import_mesh", icon="MESH_DATA")
        column.operator("fipt.set_room", text="Room from Selection", icon="RESTRICT_SELECT_OFF")
        return
    column = layout.column()
    column.enabled = job is None
    row = column.row(align=True)
    row.prop(settings, "preset")
    draw_estimate_presets(row.row(), context)
    if settings.device != "preferences":  # of a script or the command line
        column.prop(settings, "device")
    _draw_plan(layout, context)
    column = layout.column(align=True)
    column.scale_y = 1.4
    stopped = state.stages and not state.finished
    if stopped:
        column.operator("fipt.resume", icon="FILE_REFRESH")
    column.operator("fipt.estimate", text="Start Again" if stopped else "Estimate", icon="PLAY")
    if job is not None:
        _draw_waiting(layout, job)


def _draw_done(layout: UILayout, context: Context, state: runstate.RunState) -> None:
    """How good a finished estimate is; opened, its pictures and how to estimate again."""
    _draw_quality(layout, state)
    header, body = layout.panel("fipt_estimate_again", default_closed=True)
    header.label(text="Estimate Again", icon="CHECKMARK")
    if body is not None:
        _draw_start(body, context, state)
        _draw_pictures(body, state.pictures)


def _draw_plan(layout: UILayout, context: Context) -> None:
    """At which resolution light is solved, and what the estimation is expected to cost."""
    capture = context.scene.fipt.capture
    if not capture.train_count or not capture.megapixels:
        return
    plan = _plan(capture.train_count, capture.megapixels, context.scene.fipt.estimate)
    draw_text(layout.column(align=True), plan.resolution, icon="IMAGE_DATA")
    text = plan.cost[0].upper() + plan.cost[1:]
    draw_text(layout.column(align=True), text, icon="TIME")


def _plan(count: int, megapixels: float, settings: PropertyGroup) -> LightPlan:
    """The plan of `count` photographs of this mean size."""
    from ..core.run.light_size import light_plan
    from ..core.run.settings import make_settings

    size = (round(1000.0 * megapixels), 1000)  # only the number of pixels counts
    return light_plan([size] * count, make_settings(settings.preset, settings.values()))


def _draw_state(layout: UILayout, context: Context, state: runstate.RunState) -> None:
    """The state of the run folder, the way on, and its error where this Blender has run no estimation."""
    if state.error is not None and running.last("estimate") is None:
        folder = RunFolder(bpy.path.abspath(context.scene.fipt.run_folder))
        draw_error(layout, state.error, folder)
    if state.stages:
        text = iface_("Stopped. {} stages are finished").format(state.stages)
        layout.label(text=text, icon="PAUSE", translate=False)
    if state.results:
        _draw_quality(layout, state)
    _draw_pictures(layout, state.pictures)
    if state.results:
        layout.label(text="The results are those of the estimate before", icon="INFO")
        layout.operator("fipt.apply_results", icon="MATERIAL")
        draw_job(layout, context, "materials")


def _draw_quality(layout: UILayout, state: runstate.RunState) -> None:
    """How well the results show photographs that were held back, where these see the mesh."""
    if (quality := state.quality) is None:
        return
    value, missed = quality.on_mesh_db or quality.held_back_db, 100.0 * (1.0 - quality.on_mesh_share)
    text = iface_("Differs from unseen photographs by {:.1f}% of white ({:.1f} dB)")
    if missed >= 1.0:
        text += iface_(" on the mesh, which misses {:.0f}% of them")
    percent = 100.0 * 10.0 ** (-value / 20.0)
    draw_text(layout, text.format(percent, value, missed), icon="IMAGE_REFERENCE")
    if any(map(estimate_pictures.icon, state.worst)):
        header, body = layout.panel("fipt_worst_view", default_closed=True)
        header.label(text="Worst View")
        if body is not None:
            _draw_pictures(body, state.worst)


def _draw_waiting(layout: UILayout, job: Job) -> None:
    """The other job, for whose end Estimate has to wait, with a button that stops it."""
    column = layout.column(align=True)
    draw_text(column, iface_("Estimate can start when this job has ended:"), icon="SORTTIME")
    row = column.row(align=True)
    row.progress(factor=job.fraction, text=status_text(job))
    row.operator("fipt.cancel", text="", icon="X")


def _draw_pictures(layout: UILayout, paths: tuple[Path, ...]) -> None:
    """A row of pictures, named by the ends of their files' names."""
    shown = [picture for picture in paths if estimate_pictures.icon(picture)]
    if not shown:
        return
    row = layout.row()
    for picture in shown:
        column = row.column(align=True)
        column.template_icon(icon_value=estimate_pictures.icon(picture), scale=14.0 / len(shown))
        column.label(text=picture.stem.rpartition("-")[2].replace("_", " ").title())


_NAMES = {identifier: name for identifier, name, _, _ in PART_SOURCES}
_TEXTS = {identifier: text for identifier, _, text, _ in PART_SOURCES}


@panel("Parts", 0, parent="FIPT_PT_estimate", closed=True)
def FIPT_PT_parts(layout: UILayout, context: Context) -> None:
    """Select which surfaces are made of the same material"""
    import json

    parts = context.scene.fipt.parts
    layout.prop(parts, "source")
    if parts.source == "folder":
        layout.prop(parts, "folder")
    draw_text(layout, iface_(_TEXTS[parts.source]))
    source = parts.engine_source
    if parts.source == "auto" and parts.auto_source:
        source = parts.auto_source
        text = iface_("Automatic uses: {}").format(iface_(_NAMES.get(source, source)))
        draw_text(layout, text, icon="SHADERFX")
    if parts.counts:
        count = json.loads(parts.counts).get(source)
        if count is not None:
            layout.label(text=iface_("{} parts").format(count), icon="MOD_EXPLODE", translate=False)
    shown = shown_colors(context.scene) == "parts"
    layout.operator(
        "fipt.show_parts", text="Hide Parts" if shown else "Show Parts", icon="OVERLAY", depress=shown
    ).show = not shown


def _versions(context: Context) -> tuple[Version, ...]:
    return runstate.known(context.scene.fipt.run_folder).versions


@panel("Versions", 2, parent="FIPT_PT_estimate", closed=True, shown=_versions)
def FIPT_PT_estimate_versions(layout: UILayout, context: Context) -> None:
    """Other estimates of this capture: apply and delete them"""
    column = layout.column()
    column.enabled = running.current() is None
    for version in _versions(context):
        _draw_version(column, version)


def _draw_version(layout: UILayout, version: Version) -> None:
    """One version, and what can be done with it."""
    icon = "RADIOBUT_ON" if version.current else "RADIOBUT_OFF"
    row = layout.row()
    button = row.operator("fipt.use_version", text=version.title, icon=icon, emboss=False, translate=False)
    button.version = version.folder.name
    if not version.current:
        row.operator("fipt.delete_version", text="", icon="X", emboss=False).version = version.folder.name
