# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Step `masks`: semantic classes of all views as id images in semantics/, where the readers find them.

Without a model there are none; the parts of the room then come from its mesh.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from ..capture.images import read_radiance
from ..capture.rig import CLASS_NAMES, SEMANTICS_FOLDER
from ..run.documents import FileName, Items, read_json
from ..run.messages import Reporter
from ..run.runfolder import atomic_path, explained_write_errors, write_json
from .preparation import Preparation, PreparationFolder
from .tonemap import display_picture


def key(folder: PreparationFolder, preparation: Preparation) -> Any:
    """What the masks depend on besides the merged images."""
    return {"model": preparation.settings.masks, "views": [group.name for group in preparation.used_groups]}


def run(folder: PreparationFolder, preparation: Preparation, reporter: Reporter) -> dict[str, Any]:
    """Write the masks and their classes, or delete those of an earlier start; returns facts for the report.

    Raises:
        FiptError: ``model-unusable``, ``package-optional``, and those of reading and writing.
    """
    target = folder.root / SEMANTICS_FOLDER
    if not preparation.settings.masks:
        _keep_only(folder, [])
        return {"model": None, "classes": []}
    from .segmentation import Segmenter  # torch and transformers take seconds

    model = Path(preparation.settings.masks).absolute()
    segmenter = Segmenter(model)
    groups = preparation.used_groups
    pixels = np.zeros(max(segmenter.classes, default=0) + 1, np.int64)
    for index, group in enumerate(groups):
        ids = segmenter(display_picture(read_radiance(folder.image(group))))
        counts = np.bincount(ids.ravel(), minlength=len(pixels))
        pixels = counts + np.pad(pixels, (0, len(counts) - len(pixels)))
        buffer = io.BytesIO()
        Image.fromarray(ids.astype(np.uint16)).save(buffer, "PNG")
        with atomic_path(target / f"{group.name}.png") as temporary:
            temporary.write_bytes(buffer.getbuffer())
        reporter.progress((index + 1) / len(groups))
    write_json(target / CLASS_NAMES, {str(number): name for number, name in segmenter.classes.items()})
    _keep_only(folder, [CLASS_NAMES, *(f"{group.name}.png" for group in groups)])
    classes = [
        {
            "id": int(number),
            "name": segmenter.classes.get(int(number), str(number)),
            "share": round(float(pixels[number] / pixels.sum()), 4),
        }
        for number in np.argsort(-pixels, kind="stable")
        if pixels[number]
    ]
    return {"model": str(model), "classes": classes}


def _keep_only(folder: PreparationFolder, names: list[str]) -> None:
    """Delete the other masks that this step has written; masks that the user has added stay."""
    written = folder.stage / "masks_written.json"
    earlier = read_json(written, Items(FileName()), "Delete it.") if written.is_file() else []
    with explained_write_errors(folder.root):
        for name in set(earlier) - set(names):
            (folder.root / SEMANTICS_FOLDER / name).unlink(missing_ok=True)
    write_json(written, names)
