# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a run has finished, so that it can go on after a kill and starts anew when its input changed."""

from __future__ import annotations

import hashlib
import io
import json
import shutil
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch

from .errors import FiptError
from .runfolder import atomic_path, read_json, write_json
from .settings import Settings

# Settings that only matter after the estimation.
_LATER = {"texel_density", "texture_size", "atlas_mode", "write_back", "preset", "checkpoint_steps"}


def input_key(settings: Settings, files: Sequence[Path], images: Sequence[Path] = ()) -> str:
    """Hash of all that the estimation depends on.

    Args:
        settings: those that the estimation reads count.
        files: count by their bytes.
        images: count by size and time of change: reading all photographs would take too long.
    """
    digest = hashlib.sha256()
    values = {name: value for name, value in asdict(settings).items() if name not in _LATER}
    digest.update(json.dumps(values, sort_keys=True).encode())
    for path in files:
        digest.update(path.read_bytes() if path.exists() else b"missing")
    for path in images:
        status = path.stat() if path.exists() else None
        digest.update(f"{status.st_size} {status.st_mtime_ns}".encode() if status else b"missing")
    return digest.hexdigest()


class Checkpoints:
    """Finished stages of one run.

    Args:
        folder: the run's stage folder.
        key: of the input; a folder with another key is emptied.
    """

    def __init__(self, folder: Path, key: str) -> None:
        self._folder = folder
        self._path = folder / "stages.json"
        self._data: dict[str, Any] = {"key": key, "stages": {}, "values": {}}
        if self._path.exists():
            try:
                data = read_json(self._path)
            except FiptError:
                data = {}
            if data.get("key") == key:
                self._data = data
                return
        if folder.exists():
            shutil.rmtree(folder)
        folder.mkdir(parents=True)

    def done(self, name: str) -> bool:
        """Whether the stage has finished."""
        return name in self._data["stages"]

    def mark(self, name: str, facts: dict[str, Any]) -> None:
        """Record that a stage has finished, with what is worth knowing of it."""
        self._data["stages"][name] = facts
        write_json(self._path, self._data)

    def remember(self, name: str, value: Any) -> None:
        """Keep a number or other JSON that a later session needs; written with the next mark."""
        self._data["values"][name] = value

    def recall(self, name: str) -> Any:
        """What was remembered."""
        return self._data["values"][name]

    def facts(self) -> list[dict[str, Any]]:
        """All finished stages in order, each with its name."""
        return [{"name": name, **facts} for name, facts in self._data["stages"].items()]

    def save_tensors(self, name: str, state: dict[str, Any]) -> None:
        """Write network weights, whole or not at all."""
        save_tensors(self._folder / f"{name}.pt", state)

    def load_tensors(self, name: str, device: torch.device) -> dict[str, Any]:
        """Read network weights; never runs code from the file.

        Raises:
            FiptError: ``file-damaged``.
        """
        path = self._folder / f"{name}.pt"
        try:
            return torch.load(path, map_location=device, weights_only=True)
        except Exception as error:
            raise FiptError(
                "file-damaged", f"{path} can't be read ({error}).", "Delete the run's stage folder."
            ) from None


def save_tensors(path: Path, state: dict[str, Any]) -> None:
    """Write tensors, whole or not at all.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``; torch's own writer hides what the system said.
    """
    buffer = io.BytesIO()
    torch.save(state, buffer)
    with atomic_path(path) as temporary:
        temporary.write_bytes(buffer.getbuffer())
