# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The finished stages of a run, so that it can be resumed after a kill or with other settings.

Each stage has a key: a hash of the method, of the run's input, of the settings that the stage is the first to
read, and of the key before it. A resumed run keeps the stages before the first one whose key has changed.
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

from .documents import read_document
from .errors import FiptError
from .finished_views import FinishedViews
from .method import method_digest
from .result_contents import Stages
from .runfolder import atomic_path, write_json
from .settings import Settings

# The stages of Re-estimate with Hints; the first two only where the light changes, too.
HINTED_LAMPS, HINTED_REFINEMENT = "hinted-lamps", "hinted-refinement"
HINTED_ESTIMATE, HINTED_TRAINING = "hinted-estimate", "hinted-training"


def stage_names(rounds: int, hinted: bool = False, light: bool = False) -> list[str]:
    """The stages of an estimation in order; those that honour further hints, where it is `hinted`, last.

    With `light`, these include a refinement.
    """
    names = ["pixels", "shadings", "estimate-0"]
    for index in range(1, rounds + 1):
        names += [f"refinement-{index}", f"estimate-{index}"]
    names.append("training")
    if hinted and light:
        names += [HINTED_LAMPS, HINTED_REFINEMENT]
    return [*names, *((HINTED_ESTIMATE, HINTED_TRAINING) if hinted else ())]


def stage_keys(
    settings: Settings,
    files: Sequence[Path],
    images: Sequence[Path] = (),
    hints: str = "",
    hints_again: str | None = None,
    light_again: bool = False,
) -> dict[str, str]:
    """The key of each stage, in the order of the stages.

    Args:
        settings: each field changes the keys from the stage in its metadata on.
        files: input files; their content is hashed.
        images: input files of which size and time of change are hashed: reading all photographs takes too
            long.
        hints: digest of the hints that all estimates honour (`hints.hints_digest`); "" without any.
        hints_again: digest of those that the hinted stages honour instead; None without such stages.
        light_again: whether these stages include a refinement.
    """
    digest = hashlib.sha256(method_digest().encode())
    for path in files:
        digest.update(path.read_bytes() if path.exists() else b"missing")
    for path in images:
        status = path.stat() if path.exists() else None
        digest.update(f"{status.st_size} {status.st_mtime_ns}".encode() if status else b"missing")
    keys = {}
    first_again = HINTED_LAMPS if light_again else HINTED_ESTIMATE
    read_hints = {"estimate-0": hints, first_again: hints_again or ""}
    # Estimates keep tables for the refinement that follows.
    refined = {f"estimate-{index}": index < settings.rounds for index in range(settings.rounds + 1)}
    for stage in stage_names(settings.rounds, hints_again is not None, light_again):
        digest.update(read_hints.get(stage, "").encode())
        read = [item.name for item in fields(Settings) if item.metadata["stage"] == stage]
        values = {name: getattr(settings, name) for name in read}
        digest.update(json.dumps([stage, values, refined.get(stage)], sort_keys=True).encode())
        keys[stage] = digest.hexdigest()
    return keys


START_AGAIN = "Start the estimation again without resuming it."
_BAKED_NAME = "baked.json"
# Folders of the shadings; a refinement with hints keeps those before it, for other hints.
SHADINGS, HINTED_SHADINGS = "shadings", "hinted_shadings"
UNFINISHED = "unfinished"  # name of the checkpoint of a training that has not ended
_BAKING_STAGES = ("shadings", "refinement")  # stages that write the shadings


class DamagedStage(Exception):
    """A finished stage can't be loaded; the text says why.

    Attributes:
        stage: its name.
    """

    def __init__(self, stage: str, text: str) -> None:
        super().__init__(text)
        self.stage = stage


class Checkpoints:
    """Finished stages of one run.

    Args:
        folder: the run's stage folder; files that belong to other keys are removed.
        keys: of all stages, in their order (`stage_keys`).

    Attributes:
        problem: why the file of finished stages could not be read, "" without a problem.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """

    def __init__(self, folder: Path, keys: Mapping[str, str]) -> None:
        self._folder = folder
        self._path = folder / "stages.json"
        self._keys = dict(keys)
        self.problem = ""
        self._data: dict[str, Any] = {"keys": dict(keys), "stages": {}, "warnings": {}, "values": {}}
        before = self._read()
        kept = _kept_stages(before, keys)
        if not kept:
            self._path.unlink(missing_ok=True)  # first: it must never list files that are gone
            if folder.exists():
                shutil.rmtree(folder)
            folder.mkdir(parents=True)
            return
        self._data["stages"] = {name: before["stages"][name] for name in kept}
        self._data["warnings"] = {name: before["warnings"].get(name, []) for name in kept}
        self._data["values"] = before["values"]
        unfinished = {name for name in keys if name not in before["stages"]}
        valid = {name: keys[name] for name in {*kept, *unfinished} if before["keys"].get(name) == keys[name]}
        write_json(self._path, {**self._data, "keys": valid})
        self._remove_all_but(set(valid))
        write_json(self._path, self._data)

    def _read(self) -> dict[str, Any]:
        try:
            if self._path.exists():
                read_document(self._path, Stages)
                return read_document(self._path, dict)
        except FiptError as error:
            self.problem = error.text
        return {name: {} for name in self._data}

    def discard(self, name: str) -> None:
        """Forget a finished stage whose files are damaged, and all stages that need it.

        Raises:
            FiptError: ``disk-full`` or ``run-unwritable``.
        """
        names = list(self._keys)
        before = names[: names.index(name)]
        stages = {stage: facts for stage, facts in self._data["stages"].items() if stage in before}
        kept = _kept_stages({**self._data, "stages": stages}, self._keys)
        self._data["stages"] = {stage: stages[stage] for stage in kept}
        write_json(self._path, self._data)
        (self._folder / _BAKED_NAME).unlink(missing_ok=True)
        self._remove_all_but(set(kept))

    def _remove_all_but(self, stages: set[str]) -> None:
        """Remove files of other stages that a new stage would mistake for its own.

        These are estimates, the network, the checkpoint of an unfinished training, and preview pictures.
        """
        for pattern in ("estimate-*.pt", "training.pt", "hinted-*.pt", f"{UNFINISHED}.pt", "previews/*-*"):
            for path in self._folder.glob(pattern):
                stage = path.stem if path.suffix == ".pt" else path.stem.rpartition("-")[0]
                if stage.replace(UNFINISHED, "training") not in stages:
                    path.unlink()
        if HINTED_REFINEMENT not in stages:
            shutil.rmtree(self._folder / HINTED_SHADINGS, ignore_errors=True)

    def begin(self, name: str) -> None:
        """Record that a stage begins to write; a stage that bakes overwrites the shadings before it."""
        if name.startswith(_BAKING_STAGES):
            self._data["values"]["shadings"] = name
        write_json(self._path, self._data)

    def finished_views(self, name: str) -> FinishedViews:
        """The views that an interrupted run has finished of a baking stage.

        Raises:
            FiptError: ``disk-full`` or ``run-unwritable``.
        """
        return FinishedViews(self._folder / _BAKED_NAME, self._data["keys"][name])

    def holds_shadings(self, name: str) -> bool:
        """Whether a baking stage is the last one that wrote the shadings."""
        return self._data["values"].get("shadings") == name

    def done(self, name: str) -> bool:
        """Whether the stage has finished."""
        return name in self._data["stages"]

    def mark(self, name: str, facts: dict[str, Any], warnings: Sequence[Mapping[str, str]] = ()) -> None:
        """Record that a stage has finished.

        Args:
            name: of the stage.
            facts: for the statistics; JSON-serialisable.
            warnings: code, text and remedy of each warning of the stage; a resumed run repeats them.
        """
        self._data["stages"][name] = facts
        self._data["warnings"][name] = list(warnings)
        write_json(self._path, self._data)

    def warnings(self, name: str) -> list[dict[str, str]]:
        """Code, text and remedy of each warning of a finished stage."""
        return self._data["warnings"][name]

    def remember(self, name: str, value: Any) -> None:
        """Keep a JSON-serialisable value that a resumed run needs; written with the next `mark`."""
        self._data["values"][name] = value

    def recall(self, name: str) -> Any:
        """A value that `remember` kept.

        Raises:
            FiptError: ``file-damaged``.
        """
        if name not in self._data["values"]:
            raise FiptError("file-damaged", f"{self._path} lacks the value '{name}'.", START_AGAIN)
        return self._data["values"][name]

    def facts(self) -> list[dict[str, Any]]:
        """All finished stages in order, each with its name."""
        return [{"name": name, **facts} for name, facts in self._data["stages"].items()]

    def save_tensors(self, name: str, state: dict[str, Any]) -> None:
        """Write network weights to a file of the stage folder; see the function `save_tensors`."""
        save_tensors(self._folder / f"{name}.pt", state)

    def load_tensors(self, name: str, device: torch.device) -> dict[str, Any]:
        """Read network weights; code in the file is never run.

        Raises:
            FiptError: ``file-damaged``.
        """
        return load_tensors(self._folder / f"{name}.pt", device)


def _kept_stages(before: Mapping[str, Any], keys: Mapping[str, str]) -> list[str]:
    """The finished stages of an earlier session that are still valid, in their order.

    Trainings and results read the shadings of the last baking stage before them. If another stage has
    overwritten those shadings, they must be baked again.
    """
    kept: list[str] = []
    for name, key in keys.items():
        if name not in before["stages"] or before["keys"].get(name) != key:
            break
        kept.append(name)
    following = next((name for name in keys if name not in kept), "results")
    baked = [name for name in kept if name.startswith(_BAKING_STAGES)]
    if baked and not following.startswith(_BAKING_STAGES) and before["values"].get("shadings") != baked[-1]:
        del kept[kept.index(baked[-1]) :]
    return kept


def load_tensors(path: Path, device: torch.device) -> dict[str, Any]:
    """Read what the function `save_tensors` wrote; code in the file is never run.

    Raises:
        FiptError: ``file-damaged``.
    """
    try:
        state = torch.load(path, map_location=device, weights_only=True)
        if not isinstance(state, dict):
            raise TypeError("it holds no tensors by name")
    except Exception as error:
        raise FiptError("file-damaged", f"{path} can't be read ({error}).", START_AGAIN) from None
    return state


def save_tensors(path: Path, state: dict[str, Any]) -> None:
    """Write tensors to a file, completely or not at all.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    # Through memory: torch's own writer hides the system's error.
    buffer = io.BytesIO()
    torch.save(state, buffer)
    with atomic_path(path) as temporary:
        temporary.write_bytes(buffer.getbuffer())
