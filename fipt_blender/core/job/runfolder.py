# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The run folder: where each file of a run lies, and how files get there whole or not at all.

Standard library only: both processes import it, Blender's while it starts, so that JSON and the settings are
imported where they are used. docs/architecture.md describes the formats.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .errors import FiptError

if TYPE_CHECKING:
    from .settings import Settings

PRODUCT_VERSION = "0.1.0"
RUN_FORMAT = "fipt-run"
RUN_VERSION = 1


class RunFolder:
    """Paths of one run; see the tree in docs/architecture.md."""

    def __init__(self, root: str | Path) -> None:
        self.root = Path(root).absolute()
        self.run_json = self.root / "run.json"
        self.ingest_json = self.root / "ingest.json"
        self.capture_json = self.root / "capture.json"
        self.images = self.root / "images"
        self.room_npz = self.root / "room.npz"
        self.room_json = self.root / "room.json"
        self.stage = self.root / "stage"
        self.results = self.root / "results"
        self.fields_npz = self.results / "fields.npz"
        self.parts_npz = self.results / "parts.npz"
        self.emitters_json = self.results / "emitters.json"
        self.environment_exr = self.results / "environment.exr"
        self.statistics_json = self.results / "statistics.json"
        self.atlas_npz = self.root / "atlas.npz"
        self.atlas_json = self.root / "atlas.json"
        self.textures = self.root / "textures"
        self.textures_json = self.textures / "textures.json"
        self.renders = self.root / "renders"
        self.renders_json = self.renders / "renders.json"
        self.report = self.root / "report"
        self.survey = self.root / "survey"
        self.survey_json = self.survey / "survey.json"
        self.survey_npz = self.survey / "survey.npz"
        self.log = self.root / "log.txt"
        self.engine_lock = self.root / "engine.lock"

    def messages(self, command: str) -> Path:
        """The file of the messages of an engine command, from its last start on."""
        return self.root / "messages" / f"{command}.jsonl"

    def create(self, settings: Settings) -> None:
        """Make the folder and write run.json; an existing run of this version gets the new settings.

        Raises:
            FiptError: ``run-version`` where the folder belongs to another version, ``run-foreign`` where
                it holds something else, ``disk-full`` or ``run-unwritable``.
        """
        from dataclasses import asdict

        if self.run_json.exists():
            self.read()
        elif self.root.exists() and any(self.root.iterdir()):
            raise FiptError(
                "run-foreign",
                f"The folder {self.root} is not empty and is no run folder.",
                "Choose a new or empty folder for the output.",
            )
        with explained_write_errors(self.root):
            for folder in (self.root, self.stage, self.results):
                folder.mkdir(parents=True, exist_ok=True)
        write_json(
            self.run_json,
            {
                "format": RUN_FORMAT,
                "version": RUN_VERSION,
                "product_version": PRODUCT_VERSION,
                "settings": asdict(settings),
            },
        )

    def read(self) -> Settings:
        """Read the settings of the run.

        Raises:
            FiptError: ``run-missing``, ``run-damaged`` or ``run-version``.
        """
        if not self.run_json.exists():
            raise FiptError(
                "run-missing", f"{self.root} is no run folder: it has no run.json.", "Start a new run."
            )
        data = read_json(self.run_json)
        if data.get("format") != RUN_FORMAT:
            raise FiptError(
                "run-damaged", f"{self.run_json} does not describe a run.", "Choose another folder."
            )
        if data.get("version") != RUN_VERSION:
            raise FiptError(
                "run-version",
                f"The run folder {self.root} has version {data.get('version')}, and this is {RUN_VERSION}.",
                "Start a new run in another folder, or open it with the version that made it.",
            )
        from .settings import make_settings

        values = dict(data.get("settings", {}))
        return make_settings(values.pop("preset", "medium"), values)

    def resolve(self, path: str) -> Path:
        """A path from one of the run's JSON files: relative ones lie inside the run folder.

        Raises:
            FiptError: ``path-outside`` for a relative path that leads out of the folder.
        """
        if os.path.isabs(path):
            return Path(path)
        full = Path(os.path.normpath(self.root / path))
        if not full.is_relative_to(self.root):
            raise FiptError(
                "path-outside",
                f"The path '{path}' leads out of the run folder {self.root}.",
                "The run folder was changed by hand; start a new run.",
            )
        return full


@contextmanager
def explained_write_errors(path: Path) -> Iterator[None]:
    """Turn the system's write errors into ``disk-full`` and ``run-unwritable``."""
    try:
        yield
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise FiptError(
                "disk-full",
                f"The disk is full; {path} could not be written.",
                "Free some space and resume the run: finished stages are kept.",
            ) from error
        raise FiptError(
            "run-unwritable",
            f"{path} could not be written ({error.strerror}).",
            "Choose an output folder that you may write to.",
        ) from error


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """A temporary path beside `path` that takes its place when the block ends well.

    The suffix stays the same, so that writers which choose a format by suffix work.
    """
    temporary = path.with_name(f".{os.getpid()}.{path.name}")
    with explained_write_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            yield temporary
            os.replace(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)


def write_json(path: Path, data: Any) -> None:
    """Write JSON whole or not at all."""
    import json

    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(data, indent=1), encoding="utf-8")


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON object.

    Raises:
        FiptError: ``file-missing`` or ``file-damaged``.
    """
    import json

    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise FiptError("file-missing", f"{path} does not exist.", "Run the step that writes it.") from None
    except (OSError, ValueError) as error:
        raise FiptError("file-damaged", f"{path} can't be read ({error}).", "Write it again.") from None
    if not isinstance(data, dict):
        raise FiptError("file-damaged", f"{path} holds no JSON object.", "Write it again.")
    return data
