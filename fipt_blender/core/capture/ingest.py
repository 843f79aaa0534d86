# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Engine command `ingest`: converts a capture in any known format to the capture.json of a run.

A rejected capture leaves no files: the photographs, each decoded once, are checked while those that must be
converted are written beside the run's images, which they replace only in the end.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from .. import conventions
from ..run.contents import CapturedView, CapturedViews, UpAxis
from ..run.declared import add_options, converted, options_of
from ..run.errors import FiptError
from ..run.kinds import as_matrix
from ..run.light_size import refuse_full_disk
from ..run.made import Made, file_state, folder_states
from ..run.messages import Reporter
from ..run.paths import is_network
from ..run.replacing import atomic_folder
from ..run.runfolder import RunFolder, write_json
from ..run.settings import make_settings
from ..run.threads import in_threads
from . import checks
from .averaging import means
from .distortion import Undistortion, is_distorted, lens_pinhole, undistorted_pinhole, undistortion
from .encoded import srgb_encoded
from .files import Folders
from .images import (
    EXR_SUFFIX,
    HALF_MAX,
    MAX_PNG_ID,
    file_exposure,
    is_encoded,
    is_plain,
    open_picture,
    read_ids,
    read_radiance,
    read_size,
    threads_for,
    transparent,
    write_codes,
    write_exr,
    write_ids,
)
from .options import CaptureOptions
from .panorama import pinhole_views, placed_panorama, says_panorama
from .photograph_poses import with_photograph_poses
from .places import MASK_FOLDER, MISSING_REMEDY
from .rig import EQUIRECTANGULAR, Pinhole, RigView
from .source import mesh_fusion, read_source, size_note, write_mesh
from .upright import Upright, doubts, find_upright

# Photographs with more pixels than these are rewritten with the bits that they have, 8 (PNG) or 16 (EXR),
# instead of 32: of 12 megapixels 144 MB would be written. Smaller ones keep all bits.
EXACT_PIXELS = 1_000_000
# The smallest value with all digits of a half float; a photograph's median must be so many times that.
LEAST_HALF, DARKER = 2.0**-14, 100.0
# Longer side of the copies that Blender's windows show of larger photographs, and their usual size: what a
# screen can show, and what the pictures beside them are rendered at.
PREVIEW_SIDE = 1920
ID_IMAGES = ("parts", "semantics", "mask")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("capture", type=Path, help="folder of the capture, or its camera file")
    parser.add_argument("run", type=Path, help="run folder; created with default settings if missing")
    add_options(parser, CaptureOptions)


def run(arguments: argparse.Namespace, reporter: Reporter) -> None:
    """Run `ingest` with the command's arguments, unless the same capture has been read already."""
    options = CaptureOptions(**options_of(arguments, CaptureOptions))
    folder, capture = RunFolder(arguments.run), arguments.capture.absolute()
    states = [
        *(folder_states(path, folder.root) for path in (capture, options.images, options.panorama)),
        file_state(options.mesh),
    ]
    made = Made(folder, "capture", states, vars(options), outputs=[folder.capture_json, folder.ingest_json])
    if made.told_again(reporter):
        reporter.done([str(folder.capture_json)])
        return
    ingest(capture, folder, options, reporter)
    made.note(reporter.warnings)


def ingest(capture: Path, run_folder: RunFolder, options: CaptureOptions, reporter: Reporter) -> None:
    """Read a capture, check all of it, then write capture.json and the images that must be converted.

    Raises:
        FiptError: with a code that docs/capture_formats.md lists; capture.json is not written then.
    """
    if run_folder.run_json.exists():
        run_folder.read()
    reporter.plan([0.1, 0.85, 0.05])
    reporter.stage("cameras", "Reading cameras")
    converted(CaptureOptions, vars(options))  # refuses impossible values
    source = read_source(capture.absolute(), options, reporter)
    rig = source.rig
    views = distinct_views(rig.views)
    if len(views) < len(rig.views):
        reporter.warning(
            "photograph-repeated",
            f"{len(views)} photographs have {len(rig.views)} cameras; the first camera of each is used.",
            "Remove the other ones from the camera file.",
        )
    views = _assign_splits(_chosen(views, options.views), options.hold_back)
    in_metres = conventions.world_from_source("z", options.scale)  # distances do not depend on what is up
    if options.panorama is not None:
        others = [view for view in views if view.image.absolute() != options.panorama.absolute()]
        views = distinct_views([*others, _placed(options, in_metres)])
    _check_files(views)
    if rig.one_camera:
        views, note = with_photograph_poses(rig, views, options.scale)
        if note is not None:
            reporter.warning(note.code, note.text, note.remedy)
    views = [
        replace(view, camera_to_world=checks.nearest_rotation(view.name, view.camera_to_world))
        for view in views
    ]
    # What the user has placed is last, and has the world's coordinates whatever is up in the source.
    solved = len(views) - (options.panorama is not None)
    poses = np.array([view.camera_to_world for view in views[:solved]])
    photographs = [pinhole_views(view) for view in views]
    exposures = [file_exposure(view.image) for view in views]
    number = [index for index, several in enumerate(photographs) for _ in several]
    views = [view for several in photographs for view in several]
    pinholes = [_checked_pinhole(view) for view in views]
    for view, pinhole in zip(views, pinholes, strict=True):
        checks.check_view(view.name, pinhole, conventions.transform_poses(in_metres, view.camera_to_world))
    upright = None
    if options.up_axis != "auto":
        upright = Upright(options.up_axis, "option")
    elif rig.up_axis is not None:
        upright = Upright(rig.up_axis, "format")
        for note in doubts(rig.up_axis, poses):
            reporter.warning(note.code, note.text, note.remedy)

    fusion = mesh_fusion(run_folder, source, options)
    if fusion is not None:
        reporter.plan([0.35, 0.6, 0.05])
    remedy = "use photographs whose distortion is undone already, or smaller ones"
    rewritten = sum(_rewritten_bytes(*each) for each in zip(views, pinholes, strict=True))
    refuse_full_disk(run_folder.images, rewritten, remedy)
    is_new = not run_folder.run_json.exists()
    if is_new:
        run_folder.create(make_settings())
    try:
        with atomic_folder(run_folder.images) as images:
            reporter.stage("images", "Reading the photographs")
            written = _read_photographs(images, photographs, exposures, options.clamp_negative, reporter)
            fused = None
            if fusion is not None:
                reporter.stage("fuse", "Fusing the depth images")
                fused = None if fusion.is_kept else fusion.mesh(reporter.progress)
            reporter.stage("write", "Writing the capture")
            mesh = write_mesh(run_folder, source, fusion, fused)
            upright = upright or find_upright(poses, mesh)
    except FiptError:
        if is_new:
            _remove_empty(run_folder)
        raise
    with suppress(OSError):
        run_folder.images.rmdir()  # if nothing had to be converted
    files = [
        {kind: run_folder.images / path.relative_to(images) for kind, path in one.items()} for one in written
    ]
    world_from_source = upright.world_from_source(options.scale)
    if (note := size_note(capture, source, mesh, world_from_source)) is not None:
        reporter.warning(note.code, note.text, note.remedy)
    worlds = [world_from_source if index < solved else in_metres for index in number]
    captured = CapturedViews(
        source=rig.source,
        world_from_source=as_matrix(world_from_source),
        mesh=None if mesh is None else str(mesh),
        offset=tuple(source.offset.tolist()),
        views=tuple(
            _captured(run_folder, *one)
            for one in zip(
                views, pinholes, files, (exposures[index] for index in number), worlds, strict=True
            )
        ),
    )
    up = UpAxis(upright.axis, upright.source, upright.angle)
    # The add-on rewrites capture.json with the views that the artist selects; ingest.json keeps all of them.
    write_json(run_folder.ingest_json, replace(captured, up=up))
    write_json(run_folder.capture_json, captured)
    counts = Counter(view.split for view in views)
    reporter.done(
        [str(run_folder.capture_json)],
        {
            "source": rig.source,
            "train": counts["train"],
            "held_back": counts["held_back"],
            "up_axis": upright.axis,
            "mesh": None if mesh is None else str(mesh),
            "undistorted": sum(is_distorted(view.lens, view.width, view.height) for view in views),
        },
    )


def _placed(options: CaptureOptions, world_from_source: np.ndarray) -> RigView:
    """The panorama that the user has placed, in the source's coordinates.

    Raises:
        FiptError: those of `read_size`.
    """
    assert options.panorama is not None, "asked only where there is one"
    image = options.panorama.absolute()
    view = placed_panorama(image, read_size(image), options.panorama_place, options.panorama_heading)
    pose = conventions.transform_poses(np.linalg.inv(world_from_source), view.camera_to_world)
    return replace(view, camera_to_world=pose, mask=Folders().ids(image.parent / MASK_FOLDER, [view.name]))


def _remove_empty(run_folder: RunFolder) -> None:
    """Remove a run that has nothing but its settings."""
    with suppress(OSError):
        run_folder.stage.rmdir()
        run_folder.results.rmdir()
        if list(run_folder.root.iterdir()) == [run_folder.run_json]:
            run_folder.run_json.unlink()
            run_folder.root.rmdir()


def _chosen(views: list[RigView], count: int) -> list[RigView]:
    """At most `count` views, evenly spread over those that are not held back; all with 0."""
    if not 0 < count < len(views):
        return views
    held_back = [view for view in views if view.split == "held_back"]
    rest = [view for view in views if view.split != "held_back"]
    return [rest[index * len(rest) // count] for index in range(min(count, len(rest)))] + held_back


def distinct_views(views: Sequence[RigView]) -> list[RigView]:
    """The first view of each photograph, with unique names: a.jpg and a.png have the same stem."""
    first: dict[Path, RigView] = {}
    for view in views:
        first.setdefault(view.image, view)
    taken: set[str] = set()
    counts: Counter[str] = Counter()
    unique = []
    for view in first.values():
        name, stem = view.name, view.name.casefold()  # file systems may ignore the case of letters
        while name.casefold() in taken:
            counts[stem] += 1
            name = f"{view.name}~{counts[stem] + 1}"
        taken.add(name.casefold())
        unique.append(replace(view, name=name))
    return unique


def _assign_splits(views: list[RigView], hold_back: int) -> list[RigView]:
    """Give all views a split; held-back views that the capture defines take precedence over `hold_back`.

    Raises:
        FiptError: ``no-views`` where no view is left for training.
    """
    if hold_back and not any(view.split == "held_back" for view in views):
        ordered = sorted(range(len(views)), key=lambda index: views[index].name)
        # From the middle of each N, so that the first and the last photograph are used for training.
        chosen = set(ordered[hold_back // 2 :: hold_back])
        views = [
            replace(view, split="held_back" if index in chosen else "train")
            for index, view in enumerate(views)
        ]
    views = [replace(view, split=view.split or "train") for view in views]
    if not any(view.split == "train" for view in views):
        raise FiptError(
            "no-views", "The capture has no training photograph with a pose.", "Check the camera file."
        )
    return views


def _check_files(views: list[RigView]) -> None:
    """Check that all files exist and have the right format and size.

    Raises:
        FiptError: ``image-missing``, ``image-format``, ``image-size``, ``mask-size`` or ``image-unreadable``.
    """
    missing = [view.missing for view in views if view.missing]
    if missing:
        text = f"Files of {len(missing)} of {len(views)} photographs are missing. {missing[0]}"
        raise FiptError("image-missing", text, MISSING_REMEDY)
    for view in views:
        if is_network(str(view.image)):
            raise FiptError(
                "path-network",
                f"{view.image} is on another computer, which files of a run may not name.",
                "Map the network folder to a drive letter, or copy the capture to your own disk.",
            )
    for view in views:
        for path, code in (
            (view.image, "image-size"),
            (view.parts, "mask-size"),
            (view.semantics, "mask-size"),
            (view.mask, "mask-size"),
        ):
            if path is None:
                continue
            width, height = read_size(path)
            if (width, height) != (view.width, view.height):
                remedy = "Use images of the size for which the cameras were calibrated."
                if (height, width) == (view.width, view.height):
                    remedy = (
                        "The cameras are those of photographs that were turned upright: turn their pixels."
                    )
                text = f"{path} has {width} x {height} pixels, but its camera {view.width} x {view.height}."
                raise FiptError(code, text, remedy)
        if view.lens.model != EQUIRECTANGULAR and says_panorama(view.image, (view.width, view.height)):
            raise FiptError(
                "camera-model",
                f"{view.image} is an equirectangular panorama, but its camera is a {view.lens.model}.",
                "Solve the cameras again with an equirectangular (spherical) one for it, or leave it out.",
            )


def _checked_pinhole(view: RigView) -> Pinhole:
    """The pinhole of the view's image, undistorted where necessary.

    Raises:
        FiptError: ``intrinsics-invalid`` or ``camera-model``.
    """
    pinhole = lens_pinhole(view.lens, view.width, view.height)
    checks.check_intrinsics(view.name, pinhole)
    if not is_distorted(view.lens, view.width, view.height):
        return pinhole
    return undistorted_pinhole(view.lens, view.width, view.height)


def _read_photographs(
    folder: Path,
    photographs: Sequence[Sequence[RigView]],
    exposures: list[float | None],
    clamp_negative: bool,
    reporter: Reporter,
) -> list[dict[str, Path]]:
    """Read all photographs, write what must be converted, and warn about them.

    Args:
        folder: for the images that are written.
        photographs: the views of each.
        exposures: from the files' EXIF, see `file_exposure`.

    Returns:
        the images written of each view, by kind.

    Raises:
        FiptError: those of `read_ids`, `pixel_statistics` and `judge_pixels`.
    """
    statistics, written = [], []
    first = [several[0] for several in photographs]
    # Resamplings are made here, so that the threads share them.
    work = ((folder, several, [_resampling(view) for view in several]) for several in photographs)
    most = threads_for(view.width * view.height for view in first)
    for found, files in in_threads(lambda item: _read_photograph(*item), work, most):
        statistics.append(found)
        written += files
        reporter.progress(len(statistics) / len(photographs))
    notes = checks.judge_pixels([view.name for view in first], statistics, clamp_negative)
    encoded = [is_encoded(view.image) for view in first]
    for note in [*notes, *checks.judge_encoded(encoded, exposures)]:
        reporter.warning(note.code, note.text, note.remedy)
    return written


def _resampling(view: RigView) -> Undistortion | None:
    """What undoes a view's distortion, or cuts it out of a panorama; None where it has none."""
    if not is_distorted(view.lens, view.width, view.height):
        return None
    return undistortion(view.lens, view.width, view.height)


def _read_photograph(
    folder: Path, views: Sequence[RigView], resamplings: Sequence[Undistortion | None]
) -> tuple[checks.PixelStatistics, list[dict[str, Path]]]:
    """Statistics of a photograph's values, and the images written of its views, by kind.

    Bilinear weights are positive, so that no value is negative if clamping precedes the resampling. Id images
    are read, for their errors, also where they stay as they are.

    Args:
        folder: for the images that are written.
        resamplings: what makes each view of the photograph, or None.
    """
    image, layer = views[0].image, views[0].layer
    pixels = read_radiance(image, layer)
    found = checks.pixel_statistics(image, pixels)
    negative = found.minimum < 0.0
    if is_encoded(image):  # clipped and of 8 bits, as is said of all of them at once
        found = replace(found, looks_ldr=False, clipped=0.0)
    if negative:
        pixels = np.maximum(pixels, 0.0)
    plain = not negative and is_plain(image, layer)
    ids = {kind: read_ids(path) for kind in ID_IMAGES if (path := getattr(views[0], kind)) is not None}
    clear = transparent(image)
    if clear is not None:
        ids["mask"] = np.where(clear, 0, ids.get("mask", 1)).astype(np.int32)
        found = replace(found, transparent=float(clear.mean()))
    return found, [
        _write_view(folder, view, resampling, pixels, plain, ids, clear is not None)
        for view, resampling in zip(views, resamplings, strict=True)
    ]


def _write_view(
    folder: Path,
    view: RigView,
    resampling: Undistortion | None,
    pixels: np.ndarray,
    plain: bool,
    ids: dict[str, np.ndarray],
    hides: bool,
) -> dict[str, Path]:
    """Write the images of a view that must be converted.

    Args:
        pixels: (height, width, 3) of its photograph, without negative values.
        plain: whether these are what the file shows to any program.
        ids: id images of its photograph.
        hides: whether its transparent pixels are in the mask, which its file has not.
    """
    written: dict[str, Path] = {}

    def target(kind: str, suffix: str = EXR_SUFFIX) -> Path:
        written[kind] = folder / kind / f"{view.name}{suffix}"
        return written[kind]

    if resampling is not None:
        pixels = resampling.image(pixels)
    if resampling is not None or not plain:
        if pixels[..., 0].size > EXACT_PIXELS and open_picture(view.image).type == "uint8":
            write_codes(target("image", ".png"), srgb_encoded(pixels))
        else:
            write_exr(target("image"), pixels, half=_fits_half(pixels))
    for kind, values in ids.items():
        if resampling is not None or (kind == "mask" and hides):
            cut = values if resampling is None else resampling.ids(values)
            if cut.min() >= 0 and cut.max() <= MAX_PNG_ID:  # faster to read, and smaller
                write_ids(target(kind, ".png"), cut)
            else:
                write_exr(target(kind), cut)
    if max(pixels.shape) > PREVIEW_SIDE:
        _write_preview(view, target, pixels)
    return written


def _write_preview(view: RigView, target: Callable[[str, str], Path], pixels: np.ndarray) -> None:
    """Write a smaller copy of a photograph, with which Blender's windows show it."""
    shrink = PREVIEW_SIDE / max(pixels.shape)
    height, width = (max(1, round(shrink * side)) for side in pixels.shape[:2])
    smaller = means(pixels, width, height)
    if is_encoded(view.image):
        write_codes(target("preview", ".jpg"), srgb_encoded(smaller))
    else:
        write_exr(target("preview", EXR_SUFFIX), smaller, half=True, lossy=True)


def _rewritten_bytes(view: RigView, pinhole: Pinhole) -> int:
    """Expected size of a view's rewritten photograph, 0 where it stays as it is, and of its copy."""
    pixels = pinhole.width * pinhole.height
    preview = 2_000_000 if max(pinhole.width, pinhole.height) > PREVIEW_SIDE else 0
    if not is_distorted(view.lens, view.width, view.height) and is_plain(view.image, view.layer):
        return preview
    if pixels <= EXACT_PIXELS:
        return 12 * pixels
    return preview + (2 if open_picture(view.image).type == "uint8" else 6) * pixels


def _fits_half(pixels: np.ndarray) -> bool:
    """Whether a large image's values may be stored with 16 bits, whose relative error is at most 0.05 %."""
    if pixels[..., 0].size <= EXACT_PIXELS or pixels.max() > HALF_MAX:
        return False
    sample = checks.pixel_sample(pixels)
    positive = sample[sample > 0.0]
    # Smaller values than LEAST_HALF have larger errors.
    return positive.size > 0 and float(np.median(positive)) > DARKER * LEAST_HALF


def _captured(
    run_folder: RunFolder,
    view: RigView,
    pinhole: Pinhole,
    written: dict[str, Path],
    exposure: float | None,
    world_from_source: np.ndarray,
) -> CapturedView:
    """The view's entry in capture.json.

    Args:
        pinhole: of its image, undistorted where necessary.
        written: images that were written of it, by kind.
        exposure: from its file's EXIF.
    """
    files = {"image": view.image, **{kind: getattr(view, kind) for kind in ID_IMAGES}, **written}
    names: dict[str, Any] = {kind: _stored_path(run_folder, path) for kind, path in files.items()}
    encoded = is_encoded(view.image)
    return CapturedView(
        name=view.name,
        split=view.split or "train",
        **asdict(pinhole),
        camera_to_world=as_matrix(conventions.transform_poses(world_from_source, view.camera_to_world)),
        **names,
        encoded=encoded,
        exposure=exposure if encoded else None,
        panorama=view.name.removesuffix(f"@{view.lens.face}") if view.lens.face else None,
    )


def _stored_path(run_folder: RunFolder, path: Path | None) -> str | None:
    """A path as capture.json stores it: relative to the run folder if inside it, else absolute."""
    if path is None:
        return None
    path = path.absolute()
    return path.relative_to(run_folder.root).as_posix() if path.is_relative_to(run_folder.root) else str(path)
