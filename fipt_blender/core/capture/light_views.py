# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The views at the resolution of light, which a budget decides and not the photographs.

Where the views have more pixels than the budget, each is averaged to fewer: a pixel is the mean radiance of
those that it covers, masks by majority. The files are below ``light/`` of the run folder; a name contains a
digest of what the file was made from, so that a resumed run keeps it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..run.light_size import light_size, light_views_count
from ..run.runfolder import RunFolder, atomic_path
from ..run.threads import in_threads
from .averaging import majority, means
from .encoded import is_clipped, missing
from .images import threads_for, write_exr
from .rig import CLASS_NAMES
from .views import View

# From this share of clipped pixels on, the mean of codes is only a bound, and clipped, too.
CLIPPED_SHARE = 0.02


def chosen_views(views: Sequence[View], light_pixels: float) -> list[View]:
    """All views, or those whose cameras differ most, where the budget can't serve all of them.

    Args:
        views: at full size.
        light_pixels: millions of pixels of all views together.
    """
    count = light_views_count([(view.width, view.height) for view in views], light_pixels)
    if count >= len(views):
        return list(views)
    poses = np.array([view.camera_to_world for view in views])
    places = poses[:, :3, 3] - np.median(poses[:, :3, 3], axis=0)
    extent = max(float(np.median(np.linalg.norm(places, axis=1))), 1e-9)
    # A turn by 60 degrees differs as much as a move by that extent.
    features = np.concatenate([places / extent, poses[:, :3, 2]], axis=1)
    chosen = [0]
    distance = np.full(len(views), np.inf)
    while len(chosen) < count:
        distance = np.minimum(distance, np.linalg.norm(features - features[chosen[-1]], axis=1))
        chosen.append(int(distance.argmax()))
    return [views[index] for index in sorted(set(chosen))]


def light_views(
    run: RunFolder,
    views: Sequence[View],
    light_pixels: float,
    begin: Callable[[], None] = lambda: None,
    progress: Callable[[float], None] = lambda fraction: None,
) -> list[View]:
    """The views of an estimation at the resolution of light.

    Where the budget suffices for all pixels, these are the same objects, and nothing is written. Files that
    are already there are kept.

    Args:
        views: at full size.
        light_pixels: the budget, millions of pixels of all views together.
        begin: called before the first file is made.
        progress: called with the share (0..1) of the views that are done.

    Raises:
        FiptError: those of reading a view's images, ``disk-full`` or ``run-unwritable``.
    """
    views = chosen_views(views, light_pixels)
    sizes = light_size([(view.width, view.height) for view in views], light_pixels)
    lights = [_at_size(run, view, size) for view, size in zip(views, sizes, strict=True)]
    pairs = [
        (view, light)
        for view, light in zip(views, lights, strict=True)
        if light is not view and not all(path.is_file() for path in light.files)
    ]
    if pairs:
        begin()
        most = threads_for(view.width * view.height for view, _ in pairs)
        for done, _ in enumerate(in_threads(_make, pairs, most), 1):
            progress(done / len(pairs))
    _copy_class_names([pair for pair in zip(views, lights, strict=True) if pair[0] is not pair[1]])
    _remove_others(run, lights)
    return lights


def _at_size(run: RunFolder, view: View, size: tuple[int, int]) -> View:
    """The view with the files that it has at a size; the view itself where that is its own."""
    if size == (view.width, view.height):
        return view

    def file(kind: str, path: Path | None) -> Path | None:
        return None if path is None else _file(run, view, kind, path, size)

    return replace(
        view.resized(*size),
        image=_file(run, view, "image", view.image, size),
        parts=file("parts", view.parts),
        semantics=file("semantics", view.semantics),
        mask=file("mask", view.mask),
    )


def _file(run: RunFolder, view: View, kind: str, source: Path, size: tuple[int, int]) -> Path:
    """The averaged file of an image of a view; its name identifies what it is made from.

    Raises:
        FiptError: ``image-missing``.
    """
    try:
        status = source.stat()
    except OSError:
        raise missing(source) from None
    # The first is to be raised when the averaging changes.
    facts = (1, kind, view.encoded, status.st_size, status.st_mtime_ns, *size)
    digest = hashlib.sha256(repr(facts).encode()).hexdigest()[:12]
    return run.light / kind / f"{view.name}-{digest}.exr"


def _make(pair: tuple[View, View]) -> None:
    """Write the images of a view at the resolution of light that are not there."""
    view, light = pair
    if not light.image.is_file():
        write_exr(light.image, light_radiance(view, light.width, light.height))
    for kind, read in (("parts", view.part_ids), ("semantics", view.semantic_ids), ("mask", view.masked)):
        path = getattr(light, kind)
        if path is None or path.is_file():
            continue
        ids = read()
        assert ids is not None
        if kind == "mask":  # of what must not be used, any share spoils the mean
            ids = means(ids[..., None], light.width, light.height)[..., 0] == 0.0
            write_exr(path, ids.astype(np.float32))
        else:
            write_exr(path, majority(ids, light.width, light.height))


def light_radiance(view: View, width: int, height: int) -> np.ndarray:
    """The photograph with fewer pixels, (height, width, 3) float32, units as of `View.radiance`.

    Of photographs that are not HDR, pixels of which a relevant share is clipped in a channel are so, too.

    Raises:
        FiptError: those of `View.radiance`.
    """
    radiance = view.radiance()
    result = means(radiance, width, height)
    if view.encoded:
        clipped = is_clipped(radiance)
        if clipped.any():
            result[means(clipped, width, height) >= CLIPPED_SHARE] = 1.0
    return result


def _copy_class_names(pairs: Sequence[tuple[View, View]]) -> None:
    """Copy the names of semantic classes to the averaged masks of views (full size, averaged)."""
    folders = {
        light.semantics.parent: view.semantics.parent
        for view, light in pairs
        if view.semantics is not None and light.semantics is not None
    }
    for target, source in folders.items():
        if (source / CLASS_NAMES).is_file():
            with atomic_path(target / CLASS_NAMES) as temporary:
                temporary.write_bytes((source / CLASS_NAMES).read_bytes())


def _remove_others(run: RunFolder, lights: Sequence[View]) -> None:
    """Remove averaged files that none of the views has."""
    if not run.light.is_dir():
        return
    kept = {path for view in lights for path in view.files}
    for path in list(run.light.rglob("*.exr")):
        if path not in kept:
            path.unlink()
