# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Engine command `masks`: id images for the views of a run whose capture has none.

They are in RUN/masks, and capture.json and ingest.json name them. Masks of the capture stay.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..capture.encoded import srgb_encoded
from ..capture.images import write_ids
from ..capture.rig import CLASS_NAMES, PARTS_FOLDER, SEMANTICS_FOLDER
from ..capture.views import View, load_capture
from ..run.documents import read_json
from ..run.messages import Reporter
from ..run.run_files import read_capture
from ..run.runfolder import RunFolder, explained_write_errors, write_json
from ..run.shapes import MASKS
from .steps import code_digest
from .tonemap import network_picture

if TYPE_CHECKING:
    from .masks_model import MasksModel

_KINDS = (PARTS_FOLDER, SEMANTICS_FOLDER)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("run", type=Path, help="run folder with capture.json")
    parser.add_argument("--model", type=Path, required=True, help="folder of the model, or a checkpoint")


def run(arguments: argparse.Namespace, reporter: Reporter) -> None:
    """Find the masks of a run's views; those that the same model has found of the same photographs are kept.

    Raises:
        FiptError: ``model-unusable``, ``package-optional``, and those of reading and writing.
    """
    from .masks_model import open_masks_model  # torch and transformers take seconds

    folder = RunFolder(arguments.run)
    reporter.plan([0.1, 0.9])
    reporter.stage("model", "Loading the masks model")
    views = load_capture(folder).views
    path = arguments.model.absolute()
    model = open_masks_model(path)
    # Identifies the model and the version of this code, without reading all weights.
    files = sorted(file for file in path.iterdir() if file.is_file()) if path.is_dir() else [path]
    digest = _digest([code_digest(), *(_state(file) for file in files)])
    reporter.stage("masks", "Finding masks")
    missing = [view for view in views if not _is_own(folder, getattr(view, model.kind))]
    found = _find(folder, model, digest, missing, reporter)
    for document in (folder.ingest_json, folder.capture_json):
        if document.exists():
            _enter(folder, document, model.kind, digest)
    with explained_write_errors(folder.masks):
        for kind in _KINDS:
            if kind != model.kind and (folder.masks / kind).exists():
                shutil.rmtree(folder.masks / kind)
    data = {"kind": model.kind, "views": len(missing), "found": found}
    reporter.done([str(folder.masks_json)], data)


def encoded_picture(values: np.ndarray) -> np.ndarray:
    """A photograph that is not HDR, values by sRGB's curve (h, w, 3), as models see it, uint8 sRGB."""
    return np.round(255.0 * srgb_encoded(values)).astype(np.uint8)


def _find(folder: RunFolder, model: MasksModel, digest: str, views: list[View], reporter: Reporter) -> int:
    """Write the masks of views that have none of this model; returns how many these are."""
    from .masks_model import find_masks

    keys, count = _read_keys(folder), 0
    for index, view in enumerate(views):
        path, key = _mask(folder, model.kind, view.name), _key(digest, view.image)
        if keys.get(view.name) != key or not path.is_file():
            ids = find_masks(model, view.radiance(), encoded_picture if view.encoded else network_picture)
            write_ids(path, ids)
            if model.classes:
                names = {str(number): name for number, name in model.classes.items()}
                write_json(path.parent / CLASS_NAMES, names)
            # After each view, so that a command that was stopped goes on where it was.
            keys[view.name] = key
            write_json(folder.masks_json, {"keys": keys})
            count += 1
        reporter.progress((index + 1) / len(views))
    write_json(folder.masks_json, {"keys": keys})
    return count


def _enter(folder: RunFolder, document: Path, kind: str, digest: str) -> None:
    """Name the masks that were found in a list of views, instead of those of an earlier model."""
    data, keys = read_capture(document), _read_keys(folder)
    for entry in data["views"]:
        for each in _KINDS:
            if entry[each] and not _is_own(folder, folder.resolve(entry[each])):
                entry[each] = None
        path, key = _mask(folder, kind, entry["name"]), _key(digest, folder.resolve(entry["image"]))
        if entry[kind] is None and keys.get(entry["name"]) == key and path.is_file():
            entry[kind] = path.relative_to(folder.root).as_posix()
    write_json(document, data)


def _read_keys(folder: RunFolder) -> dict[str, str]:
    """For each view of which this command has found a mask, what it was found from."""
    if not folder.masks_json.is_file():
        return {}
    keys: dict[str, str] = read_json(folder.masks_json, MASKS, "Delete it.")["keys"]
    return keys


def _mask(folder: RunFolder, kind: str, view: str) -> Path:
    return folder.masks / kind / f"{view}.png"


def _is_own(folder: RunFolder, path: Path | None) -> bool:
    """Whether a mask belongs to the capture, and was not found by this command."""
    return path is not None and not path.is_relative_to(folder.masks)


def _key(digest: str, image: Path) -> str:
    """What a mask was found from: the model and the photograph's file."""
    return _digest([digest, _state(image)])


def _state(file: Path) -> list[Any]:
    status = file.stat() if file.is_file() else None
    return [str(file), *((status.st_size, status.st_mtime_ns) if status else ())]


def _digest(values: list[Any]) -> str:
    return hashlib.sha256(json.dumps(values).encode()).hexdigest()[:24]
