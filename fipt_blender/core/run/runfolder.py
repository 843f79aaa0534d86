"""The run folder: the paths of its files, and writing files completely or not at all.

Standard library only: both processes import it. Blender imports it while starting, therefore json, settings
and documents are imported in the functions that use them. docs/run_folder.md describes the formats.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .errors import FiptError
from .paths import foreign_fault, is_network, leads_outside

if TYPE_CHECKING:
    from .settings import Settings

PRODUCT_VERSION = "0.1.0"
RESULTS = "results"


class RunFolder:
    """Paths of the files of one run; docs/run_folder.md lists them.

    Args:
        root: the folder.
        results: name of the folder of the results.
    """

    def __init__(self, root: str | Path, results: str = RESULTS) -> None:
        root = Path(root).absolute()
        # To Blender, two slashes are the folder of the .blend file.
        self.root = Path("/", *root.parts[1:]) if root.anchor == "//" else root
        self.run_json = self.root / "run.json"
        self.ingest_json = self.root / "ingest.json"
        self.capture_json = self.root / "capture.json"
        self.images = self.root / "images"
        self.fused_ply = self.root / "fused.ply"
        self.simplified_ply = self.root / "simplified.ply"
        self.room_npz = self.root / "room.npz"
        self.room_json = self.root / "room.json"
        self.scan = self.root / "scan"  # outputs of the stages that make the room of a scan
        self.linked = self.root / "linked"  # of a survey: part masks with the ids of other views
        self.hints_json = self.root / "hints.json"
        self.hints_again_json = self.root / "hints_again.json"
        self.stage = self.root / "stage"
        self.stages_json = self.stage / "stages.json"
        self.results = self.root / results
        self.scan_npz = self.results / "scan.npz"
        self.fields_npz = self.results / "fields.npz"
        self.parts_npz = self.results / "parts.npz"
        self.parts_json = self.results / "parts.json"
        self.left_alone_npz = self.results / "left_alone.npz"
        self.emitters_json = self.results / "emitters.json"
        self.environment_exr = self.results / "environment.exr"
        self.resolution_npz = self.results / "resolution.npz"
        self.statistics_json = self.results / "statistics.json"
        self.doubts_json = self.results / "doubts.json"
        self.doubts = self.results / "doubts"
        self.quality_json = self.results / "quality.json"
        self.quality = self.results / "quality"
        self.atlas_npz = self.root / "atlas.npz"
        self.atlas_json = self.root / "atlas.json"
        self.textures = self.root / "textures"
        self.textures_json = self.textures / "textures.json"
        self.job_json = self.root / "job.json"
        self.renders = self.root / "renders"
        self.renders_json = self.renders / "renders.json"
        self.report = self.root / "report"
        self.survey = self.root / "survey"
        self.survey_json = self.survey / "survey.json"
        self.survey_npz = self.survey / "survey.npz"
        self.align = self.root / "align"
        self.scene_cameras = self.root / "scene_cameras"
        self.log = self.root / "log.txt"
        self.unsaved = self.root / "unsaved.txt"
        self.engine_lock = self.root / "engine.lock"

    def refuse_links(self) -> None:
        """Refuse a folder in which a link leads out of it: its files may be written over or deleted.

        Only the folder's own subfolders and files are examined.
        """
        replaced = [self.images, self.results, self.textures]
        own = [self.linked, self.scan, self.stage, self.renders, *replaced]
        own += [side for path in replaced for side in beside(path)]
        own += [self.report, self.survey, self.align, self.scene_cameras]
        own += [self.root / "messages", self.root / "made", self.log]
        prepared = ("sparse", "clipped", "parts", "semantics")  # folders of a prepared capture
        own += [self.engine_lock, *(self.root / name for name in prepared)]
        root = os.path.realpath(self.root)
        for path in own:
            if path.is_symlink() or path.is_dir():
                self._refuse_link(path, root)
        for top in own:
            for folder, folders, files in os.walk(top):
                for name in folders:
                    self._refuse_link(Path(folder, name), root)
                for name in files:
                    if os.path.islink(os.path.join(folder, name)):
                        self._refuse_link(Path(folder, name), root)

    def _refuse_link(self, path: Path, root: str) -> None:
        target = os.path.realpath(path)
        if target != root and not target.startswith(os.path.join(root, "")):
            raise FiptError("run-linked", path=path, target=target)

    def messages(self, command: str) -> Path:
        """The file with the messages of the last start of an engine command."""
        return self.root / "messages" / f"{command}.jsonl"

    def made(self, name: str) -> Path:
        """The file with the key of what some files were made from; see `made.Made`."""
        return self.root / "made" / f"{name}.json"

    def create(self, settings: Settings) -> None:
        """Make the folder and write run.json; an existing run of this version gets the new settings."""
        if self.run_json.exists():
            self.read()
        elif self.root.exists() and any(self.root.iterdir()):
            raise FiptError("run-foreign.create", root=self.root)
        self.refuse_links()
        self.recover()
        with explained_write_errors(self.root):
            for folder in (self.root, self.stage, self.results):
                folder.mkdir(parents=True, exist_ok=True)
        self.write_settings(settings)

    def write_settings(self, settings: Settings) -> None:
        """Write run.json."""
        from dataclasses import asdict

        from .contents import RunNote

        write_json(self.run_json, RunNote(PRODUCT_VERSION, asdict(settings)))

    def read(self) -> Settings:
        """Read the settings of the run."""
        if not self.run_json.exists():
            raise FiptError("run-missing.read", root=self.root)
        from .contents import RunNote
        from .documents import load_document
        from .kinds import HeadError
        from .settings import make_settings

        try:
            note = load_document(self.run_json, RunNote)
        except (OSError, ValueError) as error:
            if isinstance(error, HeadError) and error.field == "version":
                raise FiptError("run-version", root=self.root, error=error) from None
            raise FiptError("run-damaged", run_json=self.run_json, error=error) from None
        return make_settings(changes=note.settings)

    def read_estimated(self) -> Settings:
        """The settings of the finished estimate, with the present ones of textures."""
        from dataclasses import replace

        from .settings import TEXTURE_SETTINGS, make_settings

        present, estimated = self.read(), self.statistics().get("settings")
        if not estimated:
            return present
        kept = {name: getattr(present, name) for name in TEXTURE_SETTINGS}
        return replace(make_settings(changes=estimated), **kept)

    def statistics(self) -> dict[str, Any]:
        """What statistics.json records of the estimate; empty where there is none."""
        from .documents import optional_document

        return optional_document(self.statistics_json, dict) or {}

    def recover(self) -> None:
        """Bring back folders whose replacement was killed in the middle (`replacing.atomic_folder`)."""
        for folder in (self.images, self.results, self.textures):
            with explained_write_errors(folder):
                recover_folder(folder)

    def drop_results(self) -> None:
        """Delete the results of another room or other cameras than the run's."""
        import shutil

        if self.results.is_dir():
            with explained_write_errors(self.results):
                shutil.rmtree(self.results)
                self.results.mkdir()

    def resolve(self, path: str) -> Path:
        """The absolute path for a path from one of the run's JSON files.

        Args:
            path: of an image or a mesh on this computer, or relative to the run folder; see `paths`.
        """
        fault = ""
        if os.path.isabs(path) or is_network(path):
            fault = foreign_fault(path)
        elif leads_outside(self.root, path):
            fault = "leads out of it"
        if fault:
            raise FiptError("path-outside.resolve", root=self.root, path=path[:200], fault=fault)
        return Path(os.path.normpath(self.root / path))


def full_disk(error: Exception, path: object = "") -> FiptError | None:
    """The error ``disk-full`` where one of the system means that of writing `path`; else None."""
    if not isinstance(error, OSError) or error.errno not in (errno.ENOSPC, errno.EDQUOT):
        return None
    return FiptError("disk-full.full-disk", path=path or error.filename or "a file")


@contextmanager
def explained_write_errors(path: Path) -> Iterator[None]:
    """Turn the system's errors of writing `path` into FiptErrors."""
    try:
        yield
    except OSError as error:
        if full := full_disk(error, path):
            raise full from error
        raise FiptError(
            "run-unwritable.explained-write-errors", path=path, strerror=error.strerror
        ) from error


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """A temporary path beside `path` that replaces it if the block ends without an exception.

    The suffix is the same, for writers that choose the format by the suffix.
    """
    temporary = path.with_name(f".{os.getpid()}.{path.name}")
    with explained_write_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            yield temporary
            _sync(temporary)
            os.replace(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)


def write_json(path: Path, data: Any) -> None:
    """Write a JSON file, completely or not at all; dataclasses as `kinds.as_json` does."""
    import json

    from .kinds import as_json

    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(data, indent=1, default=as_json), encoding="utf-8")


def beside(folder: Path) -> tuple[Path, Path]:
    """Where a folder that replaces another one is written, and where the other one is for a moment."""
    return folder.with_name(f"{folder.name}.new"), folder.with_name(f"{folder.name}.old")


def recover_folder(folder: Path) -> None:
    """Bring a folder back whose replacement was killed between its two renamings."""
    old = beside(folder)[1]
    if old.is_dir() and not folder.exists():
        os.rename(old, folder)


def _sync(path: Path) -> None:
    """Wait until a file is on the disk: a power failure after its renaming must not leave it empty."""
    descriptor = os.open(path, os.O_RDWR | getattr(os, "O_BINARY", 0))
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
