# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The base colour of a view as two versions of a run have it, wiped side by side over the view."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np

from ...core.run.documents import load_document
from ...core.run.result_contents import Maps
from ...core.run.runfolder import RunFolder
from ...core.run.versions import version_folder
from ..image_datablocks import load_radiance
from ..marks import view_cameras
from . import cameras, compare


def show(scene: bpy.types.Scene, run: RunFolder, version: str) -> bool:
    """Compare a version, on the left, with the present results; whether both have a view of the scene.

    Args:
        scene: its camera becomes that of the view, unless it is one of those that both have.
        run, version: see `versions`.

    Raises:
        FiptError: ``version-missing``.
    """
    pictures = [_pictures(version_folder(run, version).results), _pictures(run.results)]
    present = view_cameras(scene)
    names = [name for name in pictures[0] if name in pictures[1] and name in present]
    if not names:
        return False
    name = next((name for name in names if present[name] == scene.camera), names[0])
    left, right = (_pixels(found[name]) for found in pictures)
    if left is None or right is None:
        return False
    cameras.use_view(scene, present[name])
    compare.start_pair(scene, left, right)
    return True


def _pixels(path: Path) -> np.ndarray | None:
    """The linear values (H,W,4) of a picture; None where it can't be read."""
    image = load_radiance(path)
    if image is None:
        return None
    image.reload()  # another version may have been there
    values = compare.pixels_of(image) if min(image.size) > 0 else None
    if not image.users:
        bpy.data.images.remove(image)
    return values


def _pictures(results: Path) -> dict[str, Path]:
    """The pictures of base colour by the names of their views; none where no textures were baked."""
    try:
        entries = load_document(results / "maps" / "maps.json", Maps).views
    except (OSError, ValueError):
        return {}
    # The paths are those in the run's results; a version has the same files in its own folder.
    return {entry.view: results / "maps" / Path(entry.base_color).name for entry in entries}
