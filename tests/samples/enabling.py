"""What enabling the add-on may load: each module more makes every start of Blender slower."""

from __future__ import annotations

from collections.abc import Iterable

# Folders that hold one file for each section of the panel; they need bpy and what is listed below.
_SECTIONS = ("operators", "panels", "properties")
_MODULES = {
    *("", "machine", "api", "api.applying", "api.estimating", "api.importing", "bridge", "bridge.places"),
    *("blend", "blend.marks", "blend.capture", "blend.capture.other_cameras", "blend.capture.pair_marks"),
    *("blend.lights", "blend.lights.selected", "blend.previews", "blend.results", "blend.results.dropped"),
    *("core", "core.capture", "core.capture.suffixes", "prepare", "prepare.preparation"),
    *("core.run", "core.run.documents", "core.run.errors", "core.run.kinds", "core.run.paths", "core.run.runfolder"),
    *("core.capture.options", "core.run.declared", "core.run.settings", "core.run.stage_settings"),
    *("core.run.names", "core.run.shapes", "jobs", "jobs.job_scene", "jobs.running", "jobs.files"),
    *("jobs.runstate", "jobs.session", "jobs.setup_size", "jobs.tasks", "jobs.window"),
}
_HEAVY = {
    *("numpy", "mitsuba", "drjit", "torch", "OpenEXR", "tomllib", "email", "asyncio", "unittest"),
    *("json", "shutil", "subprocess", "tempfile", "traceback", "uuid"),
}


def needless(loaded: Iterable[str], package: str) -> list[str]:
    """The modules that enabling should not have loaded.

    Args:
        loaded: all that it loaded, full names.
        package: name of the add-on's package.
    """
    found = []
    for name in loaded:
        inside = (name + ".").startswith(package + ".")
        own = name[len(package) :].removeprefix(".")
        if own not in _MODULES and own.partition(".")[0] not in _SECTIONS if inside else is_heavy(name):
            found.append(name)
    return sorted(found)


def is_heavy(name: str) -> bool:
    """Whether a module of others takes long to load."""
    return name.partition(".")[0] in _HEAVY
