"""The estimates of a capture: run folders beside each other. Standard library only."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from .contents import RunNote
from .documents import optional_document
from .errors import FiptError
from .result_contents import Stages
from .runfolder import RunFolder, explained_write_errors


@dataclass(frozen=True)
class Version:
    """One estimate of a capture.

    Attributes:
        folder: its run folder.
        time: when it was finished, seconds since 1970.
        preset: "" where it is not known.
        current: whether it is the run that was asked about.
    """

    folder: Path
    time: float
    preset: str
    current: bool

    @property
    def title(self) -> str:
        """Preset, and local date and time of its end."""
        date = time.strftime("%Y-%m-%d %H:%M", time.localtime(self.time))
        return " ".join(filter(None, (self.preset.capitalize(), date)))


def list_versions(run: RunFolder) -> list[Version]:
    """The finished estimates of the run's capture in the folder of the run, the newest first."""
    folders = {run.root, *_same_capture(run)}
    versions = [_describe(folder, folder == run.root) for folder in folders if has_results(RunFolder(folder))]
    return sorted(versions, key=lambda version: -version.time)


def find_version(run: RunFolder, name: str) -> RunFolder:
    """The run folder of a version, by the folder's name.

    Raises:
        FiptError: ``version-missing``.
    """
    for version in list_versions(run):
        if version.folder.name == name:
            return RunFolder(version.folder)
    raise FiptError("version-missing", name=name[:80], root=run.root)


def has_results(run: RunFolder) -> bool:
    """Whether an estimate has finished in a run folder."""
    return run.fields_npz.is_file() and run.emitters_json.is_file()


def results_id(run: RunFolder) -> str:
    """A digest that tells results of a run from others; "" where there are none."""
    if not run.fields_npz.is_file():
        return ""
    stages = _keys(run.results)
    status = run.fields_npz.stat()
    text = json.dumps(stages, sort_keys=True) if stages else f"{status.st_size} {status.st_mtime_ns}"
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def copy_capture(run: RunFolder, target: RunFolder) -> None:
    """Give another run folder the capture of a run as `ingest` has read it; photographs cost no space again.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    with explained_write_errors(target.root):
        for path in (run.images, run.survey):
            if path.is_dir():
                shutil.copytree(path, target.root / path.name, ignore=_in_place, copy_function=_link_or_copy)
        for path in (run.fused_ply, run.simplified_ply, run.capture_json, run.ingest_json, run.unsaved):
            if path.is_file():
                _link_or_copy(path, target.root / path.name)


def _same_capture(run: RunFolder) -> list[Path]:
    """The other run folders beside a run that hold the same capture."""
    try:
        capture = run.ingest_json.read_bytes()
        beside = [folder for folder in run.root.parent.iterdir() if folder != run.root]
    except OSError:
        return []
    found = []
    for folder in beside:
        with suppress(OSError):
            other = RunFolder(folder).ingest_json
            if other.stat().st_size == len(capture) and other.read_bytes() == capture:
                found.append(folder)
    return found


def _describe(folder: Path, current: bool) -> Version:
    run = RunFolder(folder)
    settings = (optional_document(run.run_json, RunNote) or RunNote()).settings
    preset = str(run.statistics().get("settings", settings).get("preset", ""))
    return Version(folder, run.fields_npz.stat().st_mtime, preset, current)


def _keys(folder: Path) -> dict[str, str]:
    """The keys in a folder's stages.json; none without one."""
    stages = optional_document(folder / "stages.json", Stages)
    return {} if stages is None else dict(stages.keys)


# All other files of a run are replaced when they change, never written in place.
_in_place = shutil.ignore_patterns("engine.lock", "log.txt", "messages", "scan")


def _link_or_copy(source: str | Path, target: str | Path) -> None:
    """One file under two names where the disk can do that; see `_in_place`."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)
