# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Versions of a run: earlier results that new ones have replaced, in versions/, and the present ones.

A version is a folder of results, which hold all that they were made from (`replacing.keep_inputs`). Its
textures are kept with it: those of an earlier estimate can't be baked again with the photographs' detail.
Standard library only.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from .contents import RunNote
from .documents import optional_document
from .errors import FiptError
from .replacing import atomic_folder, link_folder, link_or_copy
from .result_contents import Stages, Statistics, VersionNote
from .runfolder import RunFolder, beside, explained_write_errors, write_json
from .settings import TEXTURE_SETTINGS, make_settings, stored_settings

_STAGES = "stages.json"
HINTED = "hinted-"  # how the names of the stages of Re-estimate with Hints begin
_NOT_SHOWN = {*TEXTURE_SETTINGS, "preset", "device", "detail", "kept_versions"}


@dataclass(frozen=True)
class Version:
    """One estimate of a run.

    Attributes:
        id: names it in its run: a digest of the keys of its stages.
        name: that the user gave it; "" without one.
        time: when it was finished, seconds since 1970.
        preset: "" where it is not known.
        changes: settings that differ from the preset, as NAME=VALUE.
        hints: names of the hints that it honours.
        size: bytes of its files, with those that it shares with others.
        current: whether it is in results/.
    """

    id: str
    name: str
    time: float
    preset: str
    changes: tuple[str, ...]
    hints: tuple[str, ...]
    size: int
    current: bool

    @property
    def date(self) -> str:
        """Local date and time of its end."""
        return time.strftime("%Y-%m-%d %H:%M", time.localtime(self.time))

    @property
    def made(self) -> str:
        """Preset and date."""
        return " ".join(filter(None, (self.preset.capitalize(), self.date)))

    @property
    def title(self) -> str:
        """Its name, or preset and date."""
        return self.name or self.made

    @property
    def what(self) -> str:
        """What it differs in from its preset, in a few words; "" where it does not."""
        hints = len(self.hints)
        told = () if not hints else ("1 hint" if hints == 1 else f"{hints} hints",)
        return ", ".join((*self.changes, *told))


@contextmanager
def new_results(run: RunFolder) -> Iterator[RunFolder]:
    """A run folder whose results are new; at the end they replace those before, which become a version.

    A kill at any time loses neither: see `atomic_folder` and `settle`.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    with atomic_folder(run.results, lambda old: _keep(run, old)) as new:
        yield RunFolder(run.root, results=new.name)


def note_version(results: Path) -> None:
    """Write into results when they were finished, now.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    _write(results, "", time.time())


def prune(run: RunFolder, most: int) -> None:
    """Delete the oldest versions without a name, except the `most` newest ones of them.

    Raises:
        FiptError: ``run-unwritable``.
    """
    unnamed = [version for version in list_versions(run) if not version.name and not version.current]
    for version in unnamed[most:]:
        delete_version(run, version.id)


def list_versions(run: RunFolder) -> list[Version]:
    """All versions, the present one first, then the newest ones; it changes nothing."""
    present = [_describe(run.results, True)] if _holds_results(run.results) else []
    taken = {version.id for version in present}
    kept = [_describe(folder, False) for folder in _folders(run) if folder.name not in taken]
    return present + sorted(kept, key=lambda version: -version.time)


def total_size(run: RunFolder) -> int:
    """Bytes of the files of all versions; a file that several of them share counts once."""
    files: dict[tuple[int, int], int] = {}
    for folder in [run.results, *_folders(run)]:
        for status in _statuses(folder):
            files[status.st_dev, status.st_ino] = status.st_size
    return sum(files.values())


def version_folder(run: RunFolder, version: str) -> RunFolder:
    """The run with the results of a version, for reading.

    Raises:
        FiptError: ``version-missing``.
    """
    if version and present_version(run) == version:
        return run
    if version not in {folder.name for folder in _folders(run)}:
        raise FiptError(
            "version-missing",
            f"The run {run.root} has no version '{version[:40]}'.",
            "Choose one of those that are listed.",
        )
    return RunFolder(run.root, results=f"{run.versions.name}/{version}")


def use_version(run: RunFolder, version: str) -> None:
    """Make a version the run's results, and those before a version. No engine may be at work in the run.

    Raises:
        FiptError: ``version-missing``, ``disk-full`` or ``run-unwritable``.
    """
    settle(run)
    source = version_folder(run, version).results
    if source == run.results:
        return
    with explained_write_errors(run.results):
        with new_results(run) as new:
            link_folder(source, new.results, leave=[path.name for path in _baked(run)])
        _bring_back(source, run)
        _delete(source)


def rename_version(run: RunFolder, version: str, name: str) -> None:
    """Give a version a name; a version with a name is never deleted by itself.

    Raises:
        FiptError: ``version-missing``, ``disk-full`` or ``run-unwritable``.
    """
    results = version_folder(run, version).results
    _write(results, " ".join(name.split())[:60], _time(results))


def delete_version(run: RunFolder, version: str) -> None:
    """Delete an earlier version.

    Raises:
        FiptError: ``version-missing``; ``version-current`` for the results; ``run-unwritable``.
    """
    results = version_folder(run, version).results
    if results == run.results:
        raise FiptError(
            "version-current",
            "These are the run's present results.",
            "Use another version first, then delete this one.",
        )
    with explained_write_errors(results):
        _delete(results)


def settle(run: RunFolder) -> None:
    """Finish what a kill has interrupted: replaced results become a version, and no version is there twice.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    run.recover()
    old = beside(run.results)[1]
    with explained_write_errors(run.versions):
        if old.is_dir():
            _keep(run, old)
        present = present_version(run)
        for folder in _subfolders(run.versions):
            if folder.name == present or not _holds_results(folder):
                _delete(folder)


def present_version(run: RunFolder) -> str:
    """The id of the results; "" where there are none."""
    return _id(run.results) if _holds_results(run.results) else ""


def stages_last(run: RunFolder) -> str:
    """The id that the estimate has of which the stages are; "" without stages."""
    return _digest(run.stage)


def can_continue(run: RunFolder) -> bool:
    """Whether the stages are those of the results, so that Re-estimate with Hints can go on from them."""
    stages, made = (optional_document(folder / _STAGES, Stages) for folder in (run.stage, run.results))
    if stages is None:
        return False
    keys = _before_hints(stages.keys)
    if not keys.keys() <= stages.stages.keys():
        return False
    return made is None or _before_hints(made.keys) == keys


def refuse_other_stages(run: RunFolder) -> None:
    """Refuse to continue an estimate whose stages are not there any more.

    Raises:
        FiptError: ``version-stages``.
    """
    if not can_continue(run):
        raise FiptError(
            "version-stages",
            "The stages of this version are gone: another estimate has replaced them.",
            "Use the version that was estimated last, or use Estimate, which honors the hints, too.",
        )


def restore_inputs(run: RunFolder) -> None:
    """Make cameras and mesh of the results those of the run, as their stages need them; not the settings.

    An estimate that was stopped at once has left others there, and the stages as they were.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    for path in run.made_from():
        kept = run.results / path.name
        if path in (run.run_json, run.stages_json) or not kept.is_file():
            continue
        with explained_write_errors(path):
            _replace(kept, path)


def _keep(run: RunFolder, old: Path) -> None:
    """Move replaced results into versions/, with the textures that were baked of them."""
    if not _holds_results(old):
        shutil.rmtree(old)
        return
    name, given = _id(old), _name(old)
    if name == present_version(run):  # the same estimate again
        if given and not _name(run.results):
            _write(run.results, given, _time(run.results))
        shutil.rmtree(old)
        return
    if run.apply_json.is_file():
        for path in _baked(run):
            kept = old / path.name
            if path.is_dir():
                shutil.rmtree(kept, ignore_errors=True)  # of a kill in the middle
                link_folder(path, kept)
            elif path.is_file():
                kept.unlink(missing_ok=True)
                link_or_copy(path, kept)
        run.apply_json.unlink()  # the present results have none yet
    target = run.versions / name
    run.versions.mkdir(exist_ok=True)
    _delete(target)
    os.rename(old, target)


def _baked(run: RunFolder) -> list[Path]:
    """What Apply Results has made of the results; its record, which says of which, is the last."""
    return [run.textures, run.atlas_npz, run.atlas_json, run.apply_json]


def _bring_back(folder: Path, run: RunFolder) -> None:
    """Give the run the textures that a version keeps; without their record they are baked again."""
    for path in _baked(run):
        kept = folder / path.name
        if kept.is_dir():
            with atomic_folder(path) as new:
                link_folder(kept, new)
        elif kept.is_file():
            _replace(kept, path)


def _replace(source: Path, target: Path) -> None:
    """Put a file in the place of another one at once, as `link_or_copy`."""
    if target.exists() and os.path.samefile(source, target):
        return  # renaming between two names of one file would leave both
    temporary = target.with_name(f".{os.getpid()}.{target.name}")
    temporary.unlink(missing_ok=True)
    link_or_copy(source, temporary)
    os.replace(temporary, target)


def _describe(folder: Path, current: bool) -> Version:
    settings = (optional_document(folder / "run.json", RunNote) or RunNote()).settings
    statistics = optional_document(folder / "statistics.json", Statistics) or Statistics()
    return Version(
        id=_id(folder) if current else folder.name,
        name=_name(folder),
        time=_time(folder),
        preset=str(settings.get("preset", "")),
        changes=_changes(settings),
        hints=tuple(hint.name for hint in statistics.hints),
        size=sum(status.st_size for status in _statuses(folder)),
        current=current,
    )


def _changes(settings: Mapping[str, Any]) -> tuple[str, ...]:
    """The settings that differ from those of the preset, as NAME=VALUE."""
    try:
        stored = stored_settings(settings)
        usual = asdict(make_settings(stored.preset))
    except (FiptError, TypeError):
        return ()
    return tuple(
        f"{name}={value:g}" if isinstance(value, float) else f"{name}={value}"
        for name, value in asdict(stored).items()
        if name not in _NOT_SHOWN and value != usual[name]
    )


def _folders(run: RunFolder) -> list[Path]:
    """The folders of earlier versions."""
    return [folder for folder in _subfolders(run.versions) if _holds_results(folder)]


def _subfolders(folder: Path) -> list[Path]:
    try:
        return [Path(entry.path) for entry in os.scandir(folder) if entry.is_dir(follow_symlinks=False)]
    except OSError:
        return []


def _delete(folder: Path) -> None:
    """Delete a version's folder, so that what a kill leaves of it is no version any more."""
    (folder / "fields.npz").unlink(missing_ok=True)
    shutil.rmtree(folder, ignore_errors=True)


def _holds_results(folder: Path) -> bool:
    return (folder / "fields.npz").is_file()


def _id(folder: Path) -> str:
    """The digest of the stages' keys; of results of earlier versions, that of their files' size and time."""
    digest = _digest(folder)
    if digest:
        return digest
    status = (folder / "fields.npz").stat()
    return hashlib.sha256(f"{status.st_size} {status.st_mtime_ns}".encode()).hexdigest()[:12]


def _digest(folder: Path) -> str:
    """Of the keys in a folder's stages.json; "" without one."""
    stages = optional_document(folder / _STAGES, Stages)
    if stages is None:
        return ""
    return hashlib.sha256(json.dumps(stages.keys, sort_keys=True).encode()).hexdigest()[:12]


def _before_hints(keys: Mapping[str, str]) -> dict[str, str]:
    return {name: key for name, key in keys.items() if not name.startswith(HINTED)}


def _note(folder: Path) -> VersionNote | None:
    return optional_document(folder / "version.json", VersionNote)


def _name(folder: Path) -> str:
    note = _note(folder)
    return "" if note is None else note.name


def _write(results: Path, name: str, finished: float) -> None:
    write_json(results / "version.json", VersionNote(name, finished))


def _time(folder: Path) -> float:
    note = _note(folder)
    if note is not None:
        return note.time
    with suppress(OSError):
        return (folder / "fields.npz").stat().st_mtime
    return 0.0


def _statuses(folder: Path) -> Iterator[os.stat_result]:
    for parent, _, names in os.walk(folder):
        for name in names:
            with suppress(OSError):
                yield os.lstat(os.path.join(parent, name))
