# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders that take long: in a second Blender on a copy of the open file, so that the window stays free.

The copy and its order (a small JSON) lie in the run folder. In background the same work is done in place.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import bpy

from ..bridge.interpreter import PACKAGE_FOLDER
from ..bridge.process import EngineProcess, Message
from ..bridge.sequence import Job, own_job
from ..bridge.step import Step
from ..core.job.errors import FiptError
from ..core.job.messages import Reporter, claim_stdout
from ..core.job.runfolder import RunFolder, read_json, write_json
from .cameras import find_camera
from .composite import added_objects, compose, not_catching, render_layers, without
from .photographed import lights_as_photographed
from .pictures import photograph, save_exr, save_look, view_entry
from .renders import add_to_list, can_denoise, render_view
from .view_check import check_view

Progress = Callable[[float, float], None]

CHECK, INSERT, COMPOSITE = "rerender", "insert", "composite"
_FOLDER = ".job"
# The package is imported from its folder by path: the second Blender has not enabled the extension.
_START = """
import importlib.util, sys
folder = {folder!r}
spec = importlib.util.spec_from_file_location(
    "fipt_blender", folder + "/__init__.py", submodule_search_locations=[folder])
package = importlib.util.module_from_spec(spec)
sys.modules["fipt_blender"] = package
spec.loader.exec_module(package)
importlib.import_module("fipt_blender.blend.render_job").child({order!r})
"""


@dataclass(frozen=True)
class Order:
    """What to render.

    Attributes:
        kind: CHECK (and compare with the photographs), INSERT or COMPOSITE.
        run: the run folder.
        scene: name of the scene.
        views: names of the views.
        room: names of the room's objects.
        spp: samples a pixel.
        device: of Cycles, "CPU" or "GPU".
        compute: the user's Cycles devices: "type" and "ids"; empty for the processor.
    """

    kind: str
    run: str
    scene: str
    views: list[str]
    room: list[str]
    spp: int = 64
    device: str = "CPU"
    compute: dict[str, Any] = field(default_factory=dict)


def make_order(scene: bpy.types.Scene, run: RunFolder, kind: str, views: Sequence[str], spp: int) -> Order:
    """An order with the device on which the artist renders.

    Raises:
        FiptError: ``room-missing``, ``view-missing``, ``file-missing`` or ``file-damaged``.
    """
    room = [item.name for item in scene.fipt.capture.room_objects(scene)]
    if not room:
        raise FiptError("room-missing", "The scene has no room.", "Choose it in the section Capture.")
    capture = read_json(run.capture_json)
    for view in views:
        view_entry(capture, view)
        find_camera(view)
    compute = _compute_devices()
    device = scene.cycles.device if compute and hasattr(scene, "cycles") else "CPU"
    return Order(kind, str(run.root), scene.name, list(views), room, spp, device, compute)


def make_job(order: Order) -> Job:
    """The order as a job: in a second Blender where a window must stay free, else here."""
    run = RunFolder(order.run)
    beside = not bpy.app.background and bool(bpy.app.binary_path)
    steps = _steps_beside(order, run) if beside else [_step_here(order)]
    return own_job(steps, run.renders / "steps.json", run.log)


def _title(order: Order) -> str:
    count = len(order.views)
    return {
        CHECK: "Rendering the view" if count == 1 else f"Rendering {count} views",
        INSERT: "Rendering the view",
        COMPOSITE: "Compositing into the photograph",
    }[order.kind]


def _seconds(order: Order) -> float:
    return 10.0 * len(order.views) * (3 if order.kind == COMPOSITE else 1)


def _step_here(order: Order) -> Step:
    def function() -> list[Message]:
        return carry_out(order)

    return Step("render", _title(order), _seconds(order), function=function)


def _steps_beside(order: Order, run: RunFolder) -> list[Step]:
    folder = run.renders / _FOLDER
    blend, text = folder / "scene.blend", folder / "order.json"

    def save() -> None:
        shutil.rmtree(folder, ignore_errors=True)
        write_json(text, asdict(order))
        try:
            bpy.ops.wm.save_as_mainfile(filepath=str(blend), copy=True, check_existing=False, compress=False)
        except RuntimeError as error:
            raise FiptError(
                "blend-unwritable",
                f"A copy of the file could not be saved ({str(error).strip()}).",
                "Free some space, or choose a run folder that you may write to.",
            ) from None

    def start() -> EngineProcess:
        try:
            return EngineProcess(child_command(blend, text), run.log, None, run.messages("render"))
        except OSError as error:
            raise FiptError(
                "render-failed",
                f"A second Blender can't be started ({error.strerror}).",
                "Look whether Blender's program file was moved.",
            ) from error

    return [
        Step("copy", "Copying the scene", 1.0, function=save),
        Step("render", _title(order), _seconds(order), process=start),
    ]


def child_command(blend: Path, order: Path) -> list[str]:
    """The command line of the second Blender."""
    scripts = bpy.context.preferences.filepaths.use_scripts_auto_execute
    return [
        bpy.app.binary_path,
        "--background",
        "--factory-startup",
        "--enable-autoexec" if scripts else "--disable-autoexec",
        str(blend),
        "--python-expr",
        _START.format(folder=str(PACKAGE_FOLDER), order=str(order)),
    ]


def child(path: str) -> None:
    """Carry out an order in a Blender of its own, which ends with it; messages go to stdout."""
    reporter = Reporter(claim_stdout())
    with open(os.devnull, "wb") as nowhere:  # Cycles prints every sample
        os.dup2(nowhere.fileno(), 1)
    status = 1
    try:
        order = Order(**json.loads(Path(path).read_text(encoding="utf-8")))
        _use_devices(order.compute)
        reporter.plan([1.0])
        reporter.stage("render", _title(order))
        with _smooth_progress(reporter) as progress:
            for warning in carry_out(order, progress):
                reporter.warning(warning["code"], warning["text"], warning["remedy"])
        reporter.progress(1.0, force=True)
        reporter.done([])
        status = 0
    except FiptError as error:
        reporter.error(error.code, error.text, error.remedy)
    except Exception as error:
        traceback.print_exc()
        reporter.error(
            "render-failed", f"The render failed ({error}).", "log.txt in the run folder says more."
        )
    finally:
        shutil.rmtree(Path(path).parent, ignore_errors=True)
    sys.stderr.flush()
    os._exit(status)


def carry_out(order: Order, progress: Progress = lambda low, high: None) -> list[Message]:
    """Render what an order names into the run's renders/, and list it in renders.json.

    Args:
        progress: told from which to which share of the whole the render reaches that starts now.

    Returns:
        Warnings.

    Raises:
        FiptError: ``scene-gone``, ``view-missing``, ``image-missing``, ``render-failed`` or write errors.
    """
    run = RunFolder(order.run)
    scene = bpy.data.scenes.get(order.scene)
    if scene is None:
        raise FiptError("scene-gone", f"There is no scene '{order.scene}'.", "Start the render again.")
    capture = read_json(run.capture_json)
    room = set(order.room)
    with ExitStack() as stack:
        stack.enter_context(not_catching(scene, room))
        if order.kind == CHECK:
            stack.enter_context(without(added_objects(scene, room)))
            stack.enter_context(lights_as_photographed(scene))
        for index in range(len(order.views)):
            _render(order, run, scene, capture, index, progress)
    return [] if can_denoise() else [_NOT_DENOISED]


def _render(
    order: Order,
    run: RunFolder,
    scene: bpy.types.Scene,
    capture: dict[str, Any],
    index: int,
    progress: Progress,
) -> None:
    """Render one view of an order."""
    view = order.views[index]
    low, high = index / len(order.views), (index + 1) / len(order.views)
    entry = view_entry(capture, view)
    path = run.renders / order.kind / f"{view.replace('/', '_')}.exr"
    if order.kind == COMPOSITE:
        photo, within = photograph(run, entry), _within(progress, low, high)
        layers = render_layers(
            scene, view, photo, set(order.room), order.spp, device=order.device, progress=within
        )
        save_exr(path, compose(layers))
    else:
        progress(low, high)
        render_view(scene, view, path, order.spp, device=order.device)
    add_to_list(run, [{"kind": order.kind, "view": view, "image": path.relative_to(run.root).as_posix()}])
    if order.kind == CHECK:
        check_view(run, capture, entry, path, order.spp, order.views)
    else:
        save_look(path, path.with_suffix(".png"), scene)


def last_picture(run: RunFolder) -> Path:
    """The EXR of the view that was rendered last with what was inserted.

    Raises:
        FiptError: ``file-missing`` or ``file-damaged``.
    """
    entries = [each for each in read_json(run.renders_json)["renders"] if each["kind"] in (INSERT, COMPOSITE)]
    return run.resolve(entries[-1]["image"])


def _within(progress: Progress, low: float, high: float) -> Progress:
    return lambda a, b: progress(low + a * (high - low), low + b * (high - low))


_NOT_DENOISED: Message = {
    "type": "warning",
    "code": "denoise-missing",
    "text": "This Blender was built without its denoiser; the render is noisy.",
    "remedy": "Raise the samples, or use a Blender from blender.org.",
}


def _compute_devices() -> dict[str, Any]:
    """The Cycles devices of the user's preferences; a Blender with factory settings has none."""
    addon = bpy.context.preferences.addons.get("cycles")
    preferences: Any = getattr(addon, "preferences", None)
    kind = getattr(preferences, "compute_device_type", "NONE")
    if kind == "NONE":
        return {}
    return {"type": kind, "ids": [device.id for device in preferences.devices if device.use]}


def _use_devices(compute: dict[str, Any]) -> None:
    addon = bpy.context.preferences.addons.get("cycles")
    if addon is None or not compute:
        return
    addon.preferences.compute_device_type = compute["type"]
    addon.preferences.refresh_devices()
    for device in addon.preferences.devices:
        device.use = device.id in compute["ids"]


@contextmanager
def _smooth_progress(reporter: Reporter) -> Iterator[Progress]:
    """A `Progress` that follows the samples of each render."""
    reach = [0.0, 0.0]

    def begin(low: float, high: float) -> None:
        reach[:] = low, high
        reporter.progress(low, force=True)

    def follow(text: Any, *_: Any) -> None:
        match = re.search(r"Sample (\d+)/(\d+)", str(text))
        if match:
            share = int(match[1]) / max(int(match[2]), 1)
            reporter.progress(reach[0] + share * (reach[1] - reach[0]))

    bpy.app.handlers.render_stats.append(follow)
    try:
        yield begin
    finally:
        bpy.app.handlers.render_stats.remove(follow)
