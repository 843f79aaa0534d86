# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The add-on's preferences: the engine's environment, the device, where runs are cached.

The functions are what the rest of the add-on asks; they answer as well where the package is imported
without being enabled as an add-on (scripts, tests).
"""

from __future__ import annotations

import functools
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import bpy

from .bridge import places
from .core.job.errors import FiptError
from .core.job.runfolder import read_json, write_json

KEPT_NAME = "preferences.json"
_DEVICES = [
    ("auto", "Automatic", "The graphics card where a usable one is found, else the processor"),
    ("cuda", "GPU (CUDA)", "An NVIDIA graphics card"),
    ("llvm", "CPU", "The processor; slower, but works everywhere"),
]
_ON_CLOSE = [
    ("STOP", "Stop; Resume Later", "The run ends with Blender; finished stages are kept for Resume"),
    ("KEEP", "Keep Computing", "The running stage goes on without Blender; Resume picks up its result"),
]


@dataclass
class Defaults:
    """The preferences' values where the package is not enabled as an add-on; also the default values."""

    engine_python: str = ""
    wheel_folder: str = ""
    device: str = "auto"
    gpu_uuid: str = ""
    data_folder: str = ""
    on_close: str = "STOP"
    status: str = ""
    usage: str = ""


_defaults = Defaults()
_gpu_items: list[tuple[str, str, str]] = []  # Blender keeps no reference to what a callback returns


def _changed(preferences: Any, context: bpy.types.Context) -> None:
    keep()


def _engine_changed(preferences: Any, context: bpy.types.Context) -> None:
    preferences.status = ""  # it was about another engine; this keeps the new value too


def _list_gpus(preferences: Any, context: bpy.types.Context | None) -> list[tuple[str, str, str]]:
    gpus = [(gpu["uuid"], gpu["name"], f"{gpu['memory_gb']:.0f} GB") for gpu in _known_gpus(preferences)]
    if preferences.gpu_uuid and preferences.gpu_uuid not in [uuid for uuid, _, _ in gpus]:
        gpus.append((preferences.gpu_uuid, "Missing Card", "This graphics card is not in the machine"))
    _gpu_items[:] = [("AUTO", "Automatic", "The first one that works"), *gpus]
    return _gpu_items


def _known_gpus(preferences: Any) -> list[dict[str, Any]]:
    return (_parse(preferences.status).get("engine") or {}).get("gpus") or []


def _get_gpu(preferences: Any) -> int:
    uuids = [uuid for uuid, _, _ in _list_gpus(preferences, None)]
    return uuids.index(preferences.gpu_uuid) if preferences.gpu_uuid in uuids else 0


def _set_gpu(preferences: Any, value: int) -> None:
    preferences.gpu_uuid = "" if value == 0 else _list_gpus(preferences, None)[value][0]


class FIPT_Preferences(bpy.types.AddonPreferences):
    """Settings that belong to the machine and not to a scene."""

    bl_idname = __package__

    engine_python: bpy.props.StringProperty(
        name="Own Interpreter",
        description="A Python, or the folder of a virtual environment, that has the engine's packages"
        " already; empty uses the environment that Set Up makes",
        subtype="FILE_PATH",
        update=_engine_changed,
    )
    wheel_folder: bpy.props.StringProperty(
        name="Folder of Wheels",
        description="Install from the Python packages (.whl files) in this folder instead of the network",
        subtype="DIR_PATH",
        update=_changed,
    )
    device: bpy.props.EnumProperty(
        name="Compute On",
        description="Where the engine computes",
        items=_DEVICES,
        default="auto",
        update=_changed,
    )
    gpu: bpy.props.EnumProperty(
        name="Graphics Card",
        description="Which graphics card the engine uses; Check lists those of this machine",
        items=_list_gpus,
        get=_get_gpu,
        set=_set_gpu,
    )
    data_folder: bpy.props.StringProperty(
        name="Data Folder",
        description="Where runs and the engine's environment are kept; empty uses your user folder for"
        " applications' data. Upgrading or removing the extension leaves it alone",
        subtype="DIR_PATH",
        update=_engine_changed,
    )
    on_close: bpy.props.EnumProperty(
        name="On Closing Blender",
        description="What becomes of a run when Blender is closed",
        items=_ON_CLOSE,
        default="STOP",
        update=_changed,
    )
    gpu_uuid: bpy.props.StringProperty(options={"HIDDEN"}, update=_changed)
    status: bpy.props.StringProperty(
        description="What Set Up or Check said last, as JSON", options={"HIDDEN"}, update=_changed
    )
    usage: bpy.props.StringProperty(
        description="Sizes in the data folder when they were measured last, as JSON", options={"HIDDEN"}
    )

    def draw(self, context: bpy.types.Context) -> None:
        from .panels import environment

        facts = environment.Facts(_parse(self.status), _parse(self.usage), str(places.default_data_folder()))
        environment.draw(self.layout, context, self, facts)


def get_preferences() -> Any:
    """The preferences, or `Defaults` where the package is not enabled as an add-on."""
    addon = bpy.context.preferences.addons.get(__package__)
    return _defaults if addon is None or addon.preferences is None else addon.preferences


def data_folder() -> Path:
    """The folder that holds runs and the engine's environments; it need not exist yet."""
    named = get_preferences().data_folder
    return Path(bpy.path.abspath(named)).absolute() if named else places.default_data_folder()


def engine_python() -> Path:
    """The interpreter that runs the engine. It starts a process to see, so never ask while drawing.

    Raises:
        FiptError: ``engine-missing``.
    """
    from .bridge.interpreter import find_engine_python
    from .bridge.pins import managed_environments

    named = get_preferences().engine_python
    return find_engine_python(bpy.path.abspath(named) if named else None, managed_environments(data_folder()))


def engine_variables() -> dict[str, str]:
    """Environment variables that the engine's process gets besides its own: the chosen GPU."""
    from .core.device.cuda import VISIBLE_VARIABLE

    gpu = chosen_gpu()
    return {VISIBLE_VARIABLE: gpu} if gpu else {}


def chosen_gpu() -> str:
    """The uuid of the GPU that the user chose, "" for the engine's own choice."""
    return str(get_preferences().gpu_uuid)


def device_setting() -> str:
    """Where the engine computes: "auto", "cuda" or "llvm"."""
    return str(get_preferences().device)


def new_run_folder(name: str) -> Path:
    """Make a fresh, empty run folder below the data folder's runs/.

    Args:
        name: what the user will recognise the run by; made safe for a file name.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    return places.new_run_folder(data_folder(), name)


def status() -> dict[str, Any]:
    """What Set Up or Check said last: ``time``, ``product_version``, ``engine`` (see the engine's `check`),
    ``warnings`` and ``error``; empty before."""
    return _parse(get_preferences().status)


def store_status(data: dict[str, Any]) -> None:
    """Keep what Set Up or Check said; {} forgets it."""
    _store("status", data)


def usage() -> dict[str, Any]:
    """Sizes in the data folder: ``time``, ``sizes`` (bytes by folder name), ``runs`` (their names)."""
    return _parse(get_preferences().usage)


def store_usage(data: dict[str, Any]) -> None:
    """Keep what was measured."""
    _store("usage", data)


def keep() -> None:
    """Write the preferences beside the data, where removing the extension leaves them.

    Blender forgets an add-on's preferences when it is disabled or removed.
    """
    values = get_preferences()
    if values is _defaults:
        return
    try:
        kept = {name: getattr(values, name) for name in asdict(_defaults) if name != "usage"}
        write_json(places.default_data_folder() / KEPT_NAME, kept)
    except FiptError as error:  # nothing is lost now, and there is nobody to tell
        print(f"fipt: {error.text}")


def recall() -> None:
    """Take the kept preferences over where Blender has none: after a new installation."""
    values = get_preferences()
    if values is _defaults or any(values.is_property_set(name) for name in asdict(_defaults)):
        return
    try:
        kept = read_json(places.default_data_folder() / KEPT_NAME)
    except FiptError:
        return
    for name, default in asdict(_defaults).items():
        value = kept.get(name)
        if isinstance(value, str) and value != default:
            try:
                setattr(values, name, value)
            except TypeError:  # an enum's value of another version
                pass


def _store(name: str, data: dict[str, Any]) -> None:
    import json

    setattr(get_preferences(), name, json.dumps(data) if data else "")
    if get_preferences() is not _defaults:
        bpy.context.preferences.is_dirty = True  # so that Blender saves them when it saves by itself


@functools.lru_cache(maxsize=8)
def _parse(text: str) -> dict[str, Any]:
    """A JSON object, empty where the text is none; kept, since drawing asks each time."""
    import json

    try:
        data = json.loads(text)
    except ValueError:
        return {}
    return data if isinstance(data, dict) else {}


CLASSES = (FIPT_Preferences,)
