# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Engine command `ingest`: a capture in any known format becomes capture.json of a run.

Everything is checked before anything is written, so that a refused capture leaves nothing behind.
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from .. import conventions
from ..job.errors import FiptError
from ..job.messages import Reporter
from ..job.runfolder import RunFolder, write_json
from ..job.settings import make_settings
from . import checks
from .distortion import Pinhole, is_distorted, lens_pinhole, undistorted_pinhole, undistortion
from .formats import FORMATS, read_rig
from .images import is_rec709, read_ids, read_radiance, read_size, write_exr
from .rig import ReadOptions, Rig, RigView
from .views import CAPTURE_FORMAT, CAPTURE_VERSION

DEFAULT_HOLD_BACK = 8
ID_IMAGES = ("parts", "semantics", "mask")


@dataclass(frozen=True)
class IngestOptions:
    """What the user may choose about a capture.

    Attributes:
        format: a name of `FORMATS`, or "auto".
        mesh: the room's mesh in the capture's coordinates; None takes the one found beside the rig.
        up_axis: a name of `conventions.UP_AXES`, or "auto": what the format says, else the axis nearest
            to the cameras' mean up direction.
        scale: metres per unit of the capture.
        hold_back: every Nth view is held back in formats that have no splits; 0 holds none back.
        clamp_negative: take negative radiance of any size as zero.
        read: options of the readers.
    """

    format: str = "auto"
    mesh: Path | None = None
    up_axis: str = "auto"
    scale: float = 1.0
    hold_back: int = DEFAULT_HOLD_BACK
    clamp_negative: bool = False
    read: ReadOptions = field(default_factory=ReadOptions)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("capture", type=Path, help="folder of the capture (or its transforms.json)")
    parser.add_argument("run", type=Path, help="run folder; made with default settings where missing")
    parser.add_argument("--format", choices=("auto", *FORMATS), default="auto", help="layout of the capture")
    parser.add_argument("--mesh", type=Path, help="the room's mesh, in the capture's coordinates")
    parser.add_argument(
        "--up-axis",
        choices=("auto", *conventions.UP_AXES),
        default="auto",
        help="axis of the capture that points up (write --up-axis=-y for negative ones)",
    )
    parser.add_argument(
        "--scale", type=float, default=1.0, metavar="METRES", help="metres per unit of the capture"
    )
    parser.add_argument(
        "--hold-back",
        type=int,
        default=DEFAULT_HOLD_BACK,
        metavar="N",
        help="hold back every Nth view where the capture has no held-back views of its own; 0: none",
    )
    parser.add_argument(
        "--images", type=Path, metavar="FOLDER", help="where the HDR images lie (not for fipt-synthetic)"
    )
    parser.add_argument("--clamp-negative", action="store_true", help="take negative radiance as zero")
    parser.add_argument(
        "--undo-applied-transform",
        action="store_true",
        help="transforms.json: the mesh has the coordinates from before nerfstudio's applied_transform",
    )


def run(arguments: argparse.Namespace, reporter: Reporter) -> None:
    """Read, check and write the capture; see `ingest`."""
    options = IngestOptions(
        format=arguments.format,
        mesh=arguments.mesh,
        up_axis=arguments.up_axis,
        scale=arguments.scale,
        hold_back=arguments.hold_back,
        clamp_negative=arguments.clamp_negative,
        read=ReadOptions(arguments.images, arguments.undo_applied_transform),
    )
    ingest(arguments.capture, RunFolder(arguments.run), options, reporter)


def ingest(capture: Path, run_folder: RunFolder, options: IngestOptions, reporter: Reporter) -> None:
    """Read a capture, check all of it, then write capture.json and the images that had to change.

    Raises:
        FiptError: with the codes that docs/capture_formats.md lists; capture.json is then not written.
    """
    if run_folder.run_json.exists():
        run_folder.read()
    reporter.plan([0.1, 0.7, 0.2])
    reporter.stage("cameras", "Reading cameras")
    _check_options(options)
    rig = read_rig(capture.absolute(), options.format, options.read)
    for note in rig.notes:
        reporter.warning(note.code, note.text, note.remedy)
    views = _assign_splits(_unique_names(rig.views), options.hold_back)
    _check_files(views)
    mesh = _mesh(rig, options)
    up_axis = options.up_axis if options.up_axis != "auto" else rig.up_axis or guess_up_axis(views)
    world_from_source = _world_from_source(up_axis, options.scale)
    views = [
        replace(view, camera_to_world=checks.nearest_rotation(view.name, view.camera_to_world))
        for view in views
    ]
    pinholes = [_checked_pinhole(view) for view in views]

    reporter.stage("images", "Checking photographs")
    statistics = []
    for index, view in enumerate(views):
        statistics.append(checks.pixel_statistics(view.image, read_radiance(view.image)))
        for ids in (view.parts, view.semantics, view.mask):
            if ids is not None:
                read_ids(ids)
        reporter.progress((index + 1) / len(views))
    for note in checks.judge_pixels([view.name for view in views], statistics, options.clamp_negative):
        reporter.warning(note.code, note.text, note.remedy)

    reporter.stage("write", "Writing the capture")
    if not run_folder.run_json.exists():
        run_folder.create(make_settings())
    written: list[Path] = []
    try:
        entries = []
        for index, (view, pinhole) in enumerate(zip(views, pinholes, strict=True)):
            files = _write_images(run_folder, view, statistics[index].minimum < 0.0, written)
            entries.append(_entry(run_folder, view, pinhole, files, world_from_source))
            reporter.progress((index + 1) / len(views))
    except BaseException:
        for path in written:
            path.unlink(missing_ok=True)
        raise
    data = {
        "format": CAPTURE_FORMAT,
        "version": CAPTURE_VERSION,
        "source": rig.source,
        "world_from_source": world_from_source.tolist(),
        "mesh": None if mesh is None else str(mesh),
        "views": entries,
    }
    # The window writes capture.json anew from the views that the artist ticks; this one keeps them all.
    write_json(run_folder.ingest_json, data)
    write_json(run_folder.capture_json, data)
    counts = Counter(view.split for view in views)
    reporter.done(
        [str(run_folder.capture_json)],
        {
            "source": rig.source,
            "train": counts["train"],
            "held_back": counts["held_back"],
            "up_axis": up_axis,
            "mesh": None if mesh is None else str(mesh),
            "undistorted": sum(is_distorted(view.lens, view.width, view.height) for view in views),
        },
    )


def guess_up_axis(views: list[RigView]) -> str:
    """The source axis nearest to the mean up direction of the cameras: photographs are held level."""
    up = -np.mean([view.camera_to_world[:3, 1] for view in views], axis=0)
    axis = int(np.argmax(np.abs(up)))
    return ("-" if up[axis] < 0.0 else "") + "xyz"[axis]


def _check_options(options: IngestOptions) -> None:
    if options.hold_back < 0 or options.hold_back == 1:
        raise FiptError(
            "setting-invalid",
            f"Holding back every {options.hold_back}th view leaves no capture.",
            "Give 0 (none) or a number from 2 on.",
        )


def _world_from_source(up_axis: str, scale: float) -> np.ndarray:
    try:
        return conventions.world_from_source(up_axis, scale)
    except ValueError as error:
        raise FiptError(
            "setting-invalid", f"The {error}.", "Give a scale above zero and a known up axis."
        ) from None


def _unique_names(views: tuple[RigView, ...]) -> list[RigView]:
    """The views with names told apart: a.jpg and a.png have the same stem."""
    seen: Counter[str] = Counter()
    result = []
    for view in views:
        seen[view.name.lower()] += 1
        count = seen[view.name.lower()]
        result.append(view if count == 1 else replace(view, name=f"{view.name}~{count}"))
    return result


def _assign_splits(views: list[RigView], hold_back: int) -> list[RigView]:
    """Splits for all views; the format's own ones win over `hold_back`.

    Raises:
        FiptError: ``no-views`` where nothing is left to learn from.
    """
    if hold_back and not any(view.split == "held_back" for view in views):
        ordered = sorted(range(len(views)), key=lambda index: views[index].name)
        # from the middle of each N, so that the first and the last photograph stay
        chosen = set(ordered[hold_back // 2 :: hold_back])
        views = [
            replace(view, split="held_back" if index in chosen else "train")
            for index, view in enumerate(views)
        ]
    views = [replace(view, split=view.split or "train") for view in views]
    if not any(view.split == "train" for view in views):
        raise FiptError(
            "no-views", "The capture has no photographs with a pose to learn from.", "Check the camera file."
        )
    return views


def _check_files(views: list[RigView]) -> None:
    """Check that all files are there, of the right kind and size.

    Raises:
        FiptError: ``image-missing``, ``image-ldr``, ``image-size``, ``mask-size`` or ``image-unreadable``.
    """
    files = [path for view in views for path in (view.image, view.mask) if path is not None]
    missing = [path for path in files if not path.is_file()]
    if missing:
        raise FiptError(
            "image-missing",
            f"{len(missing)} of {len(files)} images do not exist; the first is {missing[0]}.",
            "Restore them, or name their folder (Photographs in the import settings, --images).",
        )
    for view in views:
        if view.image.suffix.lower() != ".exr":
            read_radiance(view.image)  # raises with the reason
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
                raise FiptError(
                    code,
                    f"{path} is {width} x {height} pixels; its camera has {view.width} x {view.height}.",
                    "Use images of the size that the cameras were calibrated for.",
                )


def _mesh(rig: Rig, options: IngestOptions) -> Path | None:
    if options.mesh is None:
        return None if rig.mesh is None else rig.mesh.absolute()
    if not options.mesh.is_file():
        raise FiptError("mesh-missing", f"The mesh {options.mesh} does not exist.", "Correct the path.")
    return options.mesh.absolute()


def _checked_pinhole(view: RigView) -> Pinhole:
    """What the view's image becomes: its own pinhole, or that of the undistorted image."""
    own = lens_pinhole(view.lens, view.width, view.height)
    checks.check_intrinsics(view.name, own.width, own.height, own.fx, own.fy, own.cx, own.cy)
    if not is_distorted(view.lens, view.width, view.height):
        return own
    return undistorted_pinhole(view.lens, view.width, view.height)


def _write_images(
    run_folder: RunFolder, view: RigView, negative: bool, written: list[Path]
) -> dict[str, Path | None]:
    """Write the images of a view that must change; the paths of all that it has.

    Bilinear weights are positive, so that clamping before the resampling leaves nothing negative.
    """
    files: dict[str, Path | None] = {"image": view.image, **{kind: getattr(view, kind) for kind in ID_IMAGES}}
    distorted = is_distorted(view.lens, view.width, view.height)
    if not distorted and not negative and is_rec709(view.image):
        return files

    def write(kind: str, pixels: np.ndarray) -> None:
        target = run_folder.images / kind / f"{view.name}.exr"
        write_exr(target, pixels)
        written.append(target)
        files[kind] = target

    pixels = np.maximum(read_radiance(view.image), 0.0)
    if not distorted:
        write("image", pixels)
        return files
    resampling = undistortion(view.lens, view.width, view.height)
    write("image", resampling.image(pixels))
    for kind in ID_IMAGES:
        source = files[kind]
        if source is not None:
            write(kind, resampling.ids(read_ids(source)))
    return files


def _entry(
    run_folder: RunFolder,
    view: RigView,
    pinhole: Pinhole,
    files: dict[str, Path | None],
    world_from_source: np.ndarray,
) -> dict[str, Any]:
    """The view as capture.json holds it."""
    return {
        "name": view.name,
        "split": view.split,
        **asdict(pinhole),
        "camera_to_world": conventions.transform_poses(world_from_source, view.camera_to_world).tolist(),
        **{kind: _stored_path(run_folder, path) for kind, path in files.items()},
    }


def _stored_path(run_folder: RunFolder, path: Path | None) -> str | None:
    """Relative inside the run folder, absolute elsewhere."""
    if path is None:
        return None
    path = path.absolute()
    return path.relative_to(run_folder.root).as_posix() if path.is_relative_to(run_folder.root) else str(path)
