# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a run has finished, so that it goes on after a kill, and what of that holds under other settings.

Each stage has a key: a hash of the run's input, of the settings that it is the first to read, and of the key
before it. Stages are kept up to the first whose key is another one.
"""

from __future__ import annotations

import hashlib
import io
import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import torch

from .errors import FiptError
from .runfolder import PRODUCT_VERSION, atomic_path, read_json, write_json
from .settings import Settings


def stage_names(rounds: int) -> list[str]:
    """The stages of an estimation in order."""
    names = ["pixels", "shadings", "training-0"]
    for index in range(1, rounds + 1):
        names += [f"refinement-{index}", f"training-{index}"]
    return names


def stage_keys(settings: Settings, files: Sequence[Path], images: Sequence[Path] = ()) -> dict[str, str]:
    """Key of each stage, in their order.

    Args:
        settings: each field counts from the stage on that its metadata name.
        files: input that counts by its bytes.
        images: input that counts by size and time of change: reading all photographs would take too long.
    """
    digest = hashlib.sha256(PRODUCT_VERSION.encode())
    for path in files:
        digest.update(path.read_bytes() if path.exists() else b"missing")
    for path in images:
        status = path.stat() if path.exists() else None
        digest.update(f"{status.st_size} {status.st_mtime_ns}".encode() if status else b"missing")
    keys = {}
    for stage in stage_names(settings.rounds):
        read = [item.name for item in fields(Settings) if item.metadata["stage"] == stage]
        values = {name: getattr(settings, name) for name in read}
        digest.update(json.dumps([stage, values], sort_keys=True).encode())
        keys[stage] = digest.hexdigest()
    return keys


_BAKES = ("shadings", "refinement")  # stages that write the shadings


class Checkpoints:
    """Finished stages of one run.

    Args:
        folder: the run's stage folder; what in it belongs to other keys is removed.
        keys: of the stages, in their order.
    """

    def __init__(self, folder: Path, keys: Mapping[str, str]) -> None:
        self._folder = folder
        self._path = folder / "stages.json"
        self._data: dict[str, Any] = {"keys": dict(keys), "stages": {}, "values": {}}
        before = self._read()
        kept = _kept_stages(before, keys)
        if not kept:
            self._path.unlink(missing_ok=True)  # first: it must not speak of files that are gone
            if folder.exists():
                shutil.rmtree(folder)
            folder.mkdir(parents=True)
            return
        self._data["stages"] = {name: before["stages"][name] for name in kept}
        self._data["values"] = before["values"]
        under_way = {name for name in keys if name not in before["stages"]}
        valid = {name: keys[name] for name in {*kept, *under_way} if before["keys"].get(name) == keys[name]}
        write_json(self._path, {**self._data, "keys": valid})
        self._remove_all_but(set(valid))
        write_json(self._path, self._data)

    def _read(self) -> dict[str, Any]:
        try:
            data = read_json(self._path) if self._path.exists() else {}
        except FiptError:
            data = {}
        whole = all(isinstance(data.get(name), dict) for name in self._data)
        return data if whole else {"keys": {}, "stages": {}, "values": {}}

    def _remove_all_but(self, stages: set[str]) -> None:
        """Remove what would be taken for a new stage's own: weights, training under way, pictures."""
        for pattern in ("networks-*.pt", "training-*.pt", "previews/*-*"):
            for path in self._folder.glob(pattern):
                stage = path.stem if path.suffix == ".pt" else path.stem.rpartition("-")[0]
                if stage.replace("networks", "training") not in stages:
                    path.unlink()

    def begin(self, name: str) -> None:
        """Note that a stage begins to write; those that bake write over the shadings of the one before."""
        if name.startswith(_BAKES):
            self._data["values"]["shadings"] = name
        write_json(self._path, self._data)

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


def _kept_stages(before: Mapping[str, Any], keys: Mapping[str, str]) -> list[str]:
    """Which finished stages of an earlier session still hold, in their order.

    Trainings and results read the shadings of the last stage that bakes before them: where another one has
    written over those, they have to be baked again.
    """
    kept: list[str] = []
    for name, key in keys.items():
        if name not in before["stages"] or before["keys"].get(name) != key:
            break
        kept.append(name)
    following = next((name for name in keys if name not in kept), "results")
    baked = [name for name in kept if name.startswith(_BAKES)]
    if baked and not following.startswith(_BAKES) and before["values"].get("shadings") != baked[-1]:
        del kept[kept.index(baked[-1]) :]
    return kept


def save_tensors(path: Path, state: dict[str, Any]) -> None:
    """Write tensors, whole or not at all.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``; torch's own writer hides what the system said.
    """
    buffer = io.BytesIO()
    torch.save(state, buffer)
    with atomic_path(path) as temporary:
        temporary.write_bytes(buffer.getbuffer())
