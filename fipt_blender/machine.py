"""The settings of this machine: the engine's environment, the device, the data folder.

Their values are those of the add-on's preferences, or `DEFAULTS` where the package is imported without being
enabled as an add-on (scripts, tests).
"""

from __future__ import annotations

import functools
import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict, cast

import bpy

from .bridge import places
from .core.run.errors import FiptError
from .core.run.runfolder import RunFolder, write_json

if TYPE_CHECKING:
    from .bridge.process import Message

ADDON = __package__  # the preferences' bl_idname
KEPT_NAME = "preferences.json"


class Status(TypedDict, total=False):
    """Last result of Set Up Engine or Check; empty before the first."""

    time: float  # seconds since the epoch
    product_version: str
    engine: dict[str, Any]  # the data of the engine's `check`; empty where it failed
    warnings: list[Message]
    error: Message | None
    cancelled: bool  # whether a later set-up was cancelled


@dataclass
class Preferences:
    """The values of the add-on's preferences, by default."""

    engine_python: str = ""
    wheel_folder: str = ""
    device: str = "auto"
    gpu_uuid: str = ""
    data_folder: str = ""
    status: str = ""


DEFAULTS = Preferences()


def get_preferences() -> Preferences:
    """The preferences, or `DEFAULTS` where the package is not enabled as an add-on."""
    addon = bpy.context.preferences.addons.get(ADDON)
    return DEFAULTS if addon is None or addon.preferences is None else cast(Preferences, addon.preferences)


def data_folder() -> Path:
    """The folder for runs and the engine's environments; it may not exist yet."""
    chosen = get_preferences().data_folder
    return Path(bpy.path.abspath(chosen)).absolute() if chosen else places.default_data_folder()


def set_up_log() -> Path:
    """The log of Set Up Engine and Check."""
    return data_folder() / "environment.log"


def engine_python() -> Path:
    """The interpreter that runs the engine. This starts a process, so never call it while drawing.

    Raises:
        FiptError: ``engine-missing``.
    """
    from .bridge.interpreter import find_engine_python
    from .bridge.pins import managed_environments

    chosen = get_preferences().engine_python
    return find_engine_python(
        bpy.path.abspath(chosen) if chosen else None, managed_environments(data_folder())
    )


def has_engine() -> bool:
    """Whether there is an engine, as far as that is known without starting it; for drawing."""
    from .bridge.interpreter import PYTHON_VARIABLE

    found = status()
    if found.get("engine") or found.get("error"):
        return bool((found.get("engine") or {}).get("ready")) and not found.get("error")
    values = get_preferences()
    return bool(values.engine_python or os.environ.get(PYTHON_VARIABLE)) or _has_environment(
        str(data_folder()), values.status
    )


@functools.lru_cache(maxsize=4)
def _has_environment(data: str, status: str) -> bool:
    """Whether set-up, or the checkout's, has made an environment; looked up again after each set-up.

    Args:
        data: the data folder.
        status: the stored result of the last set-up or check.
    """
    from .bridge.pins import managed_environments

    try:
        made = managed_environments(Path(data))
    except FiptError:  # the list of packages can't be read, which set-up reports
        made = []
    folders = [*made, places.PACKAGE_FOLDER.parent / ".venv"]
    return any(places.environment_python(folder).exists() for folder in folders)


def engine_variables() -> dict[str, str]:
    """Additional environment variables for the engine's process: the chosen GPU."""
    from .core.device.cuda import VISIBLE_VARIABLE

    gpu = chosen_gpu()
    return {VISIBLE_VARIABLE: gpu} if gpu else {}


def chosen_gpu() -> str:
    """The UUID of the GPU that the user chose, "" for automatic."""
    return str(get_preferences().gpu_uuid)


def device_setting() -> str:
    """Where the engine computes: "auto", "cuda" or "llvm"."""
    return str(get_preferences().device)


def new_run_folder(name: str, parent: Path | None = None) -> Path:
    """Create a new, empty run folder.

    Args:
        name: readable part of the folder's name; characters that file names can't have are replaced.
        parent: the folder in which it is made; by default the data folder's runs/.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    return places.new_run_folder(parent or places.runs_folder(data_folder()), name)


def is_unused_run(folder: Path) -> bool:
    """Whether a folder of `new_run_folder` has neither capture nor room, and no engine works in it."""
    from .core.run.lock import holder

    run = RunFolder(folder)
    files = run.ingest_json, run.capture_json, run.room_json
    in_data_folder = run.root.parent == places.runs_folder(data_folder())
    return in_data_folder and not any(path.exists() for path in files) and holder(run) is None


def status() -> Status:
    """The stored result of Set Up Engine or Check."""
    return cast(Status, _parse(get_preferences().status))


def store_status(data: Status) -> None:
    """Store the result of Set Up Engine or Check; {} deletes it."""
    import json

    get_preferences().status = json.dumps(data) if data else ""
    if get_preferences() is not DEFAULTS:
        bpy.context.preferences.is_dirty = True  # so that Blender auto-saves them


def keep() -> None:
    """Write the preferences to the default data folder, where they survive removing the extension.

    Blender deletes an add-on's preferences when it is disabled or removed.
    """
    preferences = get_preferences()
    if preferences is DEFAULTS:
        return
    try:
        kept = {name: getattr(preferences, name) for name in asdict(DEFAULTS)}
        write_json(places.default_data_folder() / KEPT_NAME, kept)
    except FiptError as error:  # no value is lost yet, and no operator runs that could report it
        print(f"fipt: {error.text}")


def recall() -> None:
    """Restore the written preferences where Blender has none, after a new installation."""
    preferences: Any = get_preferences()
    if preferences is DEFAULTS or any(preferences.is_property_set(name) for name in asdict(DEFAULTS)):
        return
    from .core.run.documents import optional_document

    kept = optional_document(places.default_data_folder() / KEPT_NAME, dict) or {}
    for name, default in asdict(DEFAULTS).items():
        value = kept.get(name)
        if type(value) is type(default) and value != default:
            try:
                setattr(preferences, name, value)
            except TypeError:  # an enum value of another version
                pass


@functools.lru_cache(maxsize=8)
def _parse(text: str) -> dict[str, Any]:
    """A JSON object, empty if the text is not one; cached, since every redraw reads it."""
    import json

    try:
        data = json.loads(text)
    except ValueError:
        return {}
    return data if isinstance(data, dict) else {}
