# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Step `masks`: id images of all views in parts/ or semantics/, where the readers find them.

Without a model there are none; the parts of the room then come from its mesh.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..capture.files import Folders
from ..capture.images import read_radiance, write_ids
from ..capture.rig import CLASS_NAMES, PARTS_FOLDER, SEMANTICS_FOLDER
from ..run.documents import Fields, FileName, Items, read_json
from ..run.messages import Reporter
from ..run.runfolder import explained_write_errors, write_json
from .preparation import Preparation, PreparationFolder
from .tonemap import network_picture

_KINDS = (PARTS_FOLDER, SEMANTICS_FOLDER)
_WRITTEN = Fields(dict.fromkeys(_KINDS, Items(FileName())))


def key(folder: PreparationFolder, preparation: Preparation) -> Any:
    """What the masks depend on besides the merged images."""
    return {"model": preparation.settings.masks, "views": [group.name for group in preparation.used_groups]}


def run(folder: PreparationFolder, preparation: Preparation, reporter: Reporter) -> dict[str, Any]:
    """Write the masks and their classes, or delete those of an earlier start; returns facts for the report.

    Views for which the user has added a mask keep it.

    Raises:
        FiptError: ``model-unusable``, ``package-optional``, and those of reading and writing.
    """
    if not preparation.settings.masks:
        _keep_only(folder, {})
        return {"model": None, "classes": []}
    from .masks_model import find_masks, open_masks_model  # torch and transformers take seconds

    path = Path(preparation.settings.masks).absolute()
    model = open_masks_model(path)
    target = folder.root / model.kind
    written, present = _written(folder), Folders()
    groups = [
        group
        for group in preparation.used_groups
        if f"{group.name}.png" in written[model.kind] or not present.ids(target, [group.name])
    ]
    names = [f"{group.name}.png" for group in groups] + ([CLASS_NAMES] if model.classes else [])
    # Before they are written, so that a step that was stopped knows them again.
    write_json(_record(folder), {**written, model.kind: sorted({*written[model.kind], *names})})
    pixels = np.zeros(max(model.classes, default=0) + 1, np.int64)
    for index, group in enumerate(groups):
        ids = find_masks(model, read_radiance(folder.image(group)), network_picture)
        if model.classes:
            counts = np.bincount(ids.ravel(), minlength=len(pixels))
            pixels = counts + np.pad(pixels, (0, len(counts) - len(pixels)))
        write_ids(target / f"{group.name}.png", ids)
        reporter.progress((index + 1) / len(groups))
    if model.classes:
        write_json(target / CLASS_NAMES, {str(number): name for number, name in model.classes.items()})
    _keep_only(folder, {model.kind: names})
    classes = [
        {
            "id": int(number),
            "name": model.classes.get(int(number), str(number)),
            "share": round(float(pixels[number] / pixels.sum()), 4),
        }
        for number in np.argsort(-pixels, kind="stable")
        if pixels[number]
    ]
    return {"model": str(path), "classes": classes}


def _record(folder: PreparationFolder) -> Path:
    return folder.stage / "masks_written.json"


def _written(folder: PreparationFolder) -> dict[str, list[str]]:
    """The files that this step has written, by their folder."""
    if not _record(folder).is_file():
        return {kind: [] for kind in _KINDS}
    found: dict[str, list[str]] = read_json(_record(folder), _WRITTEN, "Delete it.")
    return found


def _keep_only(folder: PreparationFolder, names: dict[str, list[str]]) -> None:
    """Delete the other masks that this step has written; masks that the user has added stay."""
    kept = {kind: names.get(kind, []) for kind in _KINDS}
    with explained_write_errors(folder.root):
        for kind, earlier in _written(folder).items():
            for name in set(earlier) - set(kept[kind]):
                (folder.root / kind / name).unlink(missing_ok=True)
    write_json(_record(folder), kept)
