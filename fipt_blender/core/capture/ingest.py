"""Engine command `ingest`: converts a capture in any known format to the capture.json of a run.

A rejected capture leaves no files: the photographs, each decoded once after its pose, are checked while those
that must be converted are written beside the run's images, which they replace only in the end.
"""

from __future__ import annotations

import argparse
import shutil
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

import numpy as np

from .. import conventions
from ..run.contents import CapturedViews, UpAxis
from ..run.declared import add_options, converted, options_of
from ..run.documents import optional_document
from ..run.errors import FiptError, Problem
from ..run.kinds import as_matrix
from ..run.light_size import refuse_full_disk
from ..run.made import Made, file_state, folder_states
from ..run.messages import Reporter
from ..run.names import free_name
from ..run.paths import is_network
from ..run.replacing import atomic_folder
from ..run.runfolder import RunFolder, write_json
from ..run.settings import make_settings
from ..run.threads import in_threads
from . import checks
from .corrections import NONE
from .depth_images import write_fused
from .files import Folders
from .formats.registry import FORMATS
from .images import read_size, threads_for
from .mistakes import COMPARED, Scene, examine
from .options import CaptureOptions
from .panorama import pinhole_views, placed_panorama, says_panorama
from .photograph import ID_IMAGES, Files, Photograph
from .places import MASK_FOLDER
from .pose_refinement import refine_poses
from .relation import sight
from .rig import EQUIRECTANGULAR, MESH_SUFFIXES, RigView
from .source import Source, read_source, size_note, write_mesh
from .upright import Upright, doubts, find_upright

USUAL_SIZES = 2.0, 10.0  # metres, of a room's longest side; others may be in another unit


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("capture", type=Path, help="folder of the capture, or its camera file")
    parser.add_argument("run", type=Path, help="run folder; created with default settings if missing")
    add_options(parser, CaptureOptions)


def run(arguments: argparse.Namespace, reporter: Reporter) -> None:
    """Run `ingest` with the command's arguments, unless the same capture has been read already."""
    options = CaptureOptions(**options_of(arguments, CaptureOptions))
    folder, capture = RunFolder(arguments.run), arguments.capture.absolute()
    named = folder.made("capture-files")  # photographs and mesh may lie beside the capture's folder
    found = optional_document(named, _Files)
    if found is not None and _made(folder, capture, options, found).told_again(reporter):
        reporter.done([str(folder.capture_json)])
        return
    named.unlink(missing_ok=True)  # until the capture is whole
    found = ingest(capture, folder, options, reporter)
    with _made(folder, capture, options, found).making(reporter.warnings):
        write_json(named, found)


@dataclass(frozen=True)
class _Files:
    """made/capture-files.json: the files that a capture was read from, wherever they lie."""

    files: tuple[str, ...]


def _made(folder: RunFolder, capture: Path, options: CaptureOptions, found: _Files) -> Made:
    """Whether capture.json is still that of all these files, and of the meshes in their folders."""
    files = [Path(file) for file in found.files]
    folders = {capture.parent, *(path for file in files for path in file.parents[:2])}
    beside = [
        path for each in sorted(folders) for suffix in MESH_SUFFIXES for path in each.glob(f"*{suffix}")
    ]
    states = [
        *(folder_states(path, folder.root) for path in (capture, options.images, options.panorama)),
        [file_state(path) for path in (options.mesh, *files, *sorted(beside))],
    ]
    return Made(folder, "capture", states, vars(options), outputs=[folder.capture_json, folder.ingest_json])


def ingest(capture: Path, run_folder: RunFolder, options: CaptureOptions, reporter: Reporter) -> _Files:
    """Read a capture, check all of it, then write capture.json and the images that must be converted.

    Returns:
        the files that were read.
    """
    if run_folder.run_json.exists():
        run_folder.read()
    reporter.plan([0.1, 0.4, 0.45, 0.05])
    reporter.stage("cameras", "Reading cameras")
    converted(CaptureOptions, vars(options))  # refuses impossible values
    source = read_source(capture.absolute(), options, reporter)
    rig = source.rig
    views = distinct_views(rig.views)
    if len(views) < len(rig.views):
        reporter.warning("photograph-repeated", number_of_views=len(views), number_of_views_2=len(rig.views))
    views = _assign_splits(_chosen(views, options.views), options.hold_back)
    in_metres = conventions.world_from_source("z", options.scale)  # distances do not depend on what is up
    if options.panorama is not None:
        others = [view for view in views if view.image.absolute() != options.panorama.absolute()]
        views = distinct_views([*others, _placed(options, in_metres)])
    _check_files(views)
    views = [
        replace(view, camera_to_world=checks.nearest_rotation(view.name, view.camera_to_world))
        for view in views
    ]
    # What the user has placed is last, and has the world's coordinates whatever is up in the source.
    solved = len(views) - (options.panorama is not None)
    photographs, pose_errors = _photographs(views, in_metres), None
    # A solve with points is the result of a bundle adjustment itself.
    if not options.keep_poses and not hasattr(FORMATS[rig.source], "points"):
        reporter.stage("poses", "Checking the photographs' poses")
        refined = refine_poses(rig, views, options.scale, reporter)
        views, rig, pose_errors = refined.views, replace(rig, depths=refined.depths), refined.errors
        photographs = _photographs(views, in_metres)
    poses = np.array([view.camera_to_world for view in views[:solved]])
    upright = None
    if options.up_axis != "auto":
        upright = Upright(options.up_axis, "option")
    elif rig.up_axis is not None:
        upright = Upright(rig.up_axis, "format")

    reporter.plan([0.35, 0.6, 0.05] if source.is_fused else [0.9, 0.1])
    remedy = "use photographs whose distortion is undone already, or smaller ones"
    rewritten = sum(photograph.rewritten_bytes for photograph in photographs)
    refuse_full_disk(run_folder.images, rewritten, remedy)
    with _new_run(run_folder):
        with atomic_folder(run_folder.images) as images:
            reporter.stage("images", "Reading the photographs")
            written, shown = _convert(images, photographs, options.clamp_negative, reporter)
            notes = _judged(source, photographs[:solved], shown[:solved], options)
            if not notes and options.up_axis == "auto" and rig.up_axis is not None:
                notes = doubts(rig.up_axis, poses, rig.source)
            for note in notes:
                reporter.warn(note)
            if source.is_fused:
                reporter.stage("fuse", "Fusing the depth images")
                fused = write_fused(run_folder, rig.depths, options, reporter.progress)
            reporter.stage("write", "Writing the capture")
            mesh = fused if source.is_fused else write_mesh(run_folder, source)
            upright = upright or find_upright(poses, mesh)
        with suppress(OSError):
            run_folder.images.rmdir()  # if nothing had to be converted
        world_from_source = upright.world_from_source(options.scale)
        doubt = size_note(capture, source, mesh, world_from_source)
        # Cameras and mesh that do not belong together explain an odd size.
        if doubt is not None and not any(each.code == "mesh-elsewhere" for each in notes):
            reporter.warn(doubt)
        worlds = [world_from_source] * solved + [in_metres] * (len(views) - solved)
        items = zip(photographs, written, worlds, strict=True)
        entries = (photograph.captured(run_folder, files, world) for photograph, files, world in items)
        captured = CapturedViews(
            source=rig.source,
            world_from_source=as_matrix(world_from_source),
            mesh=None if mesh is None else str(mesh),
            offset=tuple(source.offset.tolist()),
            views=tuple(chain.from_iterable(entries)),
        )
        up = UpAxis(upright.axis, upright.source, upright.angle)
        # The add-on writes capture.json again with the views that the artist selects.
        write_json(run_folder.ingest_json, replace(captured, up=up, poses=pose_errors))
        write_json(run_folder.capture_json, captured)
    counts = Counter(view.split for view in captured.views)
    reporter.done(
        [str(run_folder.capture_json)],
        {
            "source": rig.source,
            "train": counts["train"],
            "held_back": counts["held_back"],
            "up_axis": upright.axis,
            "mesh": None if mesh is None else str(mesh),
            "undistorted": sum(sum(photograph.distorted) for photograph in photographs),
        },
    )
    read = [source.mesh, *(getattr(view, kind) for view in views for kind in ("image", *ID_IMAGES))]
    return _Files(tuple(sorted({str(path.absolute()) for path in read if path is not None})))


def _photographs(views: Sequence[RigView], in_metres: np.ndarray) -> list[Photograph]:
    """The files of the views, whose cameras are checked.

    Args:
        in_metres: (4, 4) similarity from the source's coordinates.
    """
    step = -(-len(views) // COMPARED)
    photographs = [
        Photograph(tuple(pinhole_views(view)), index % step == 0) for index, view in enumerate(views)
    ]
    for photograph in photographs:
        for view, pinhole in zip(photograph.views, photograph.pinholes, strict=True):
            pose = conventions.transform_poses(in_metres, view.camera_to_world)
            checks.check_view(view.name, pinhole, pose)
    return photographs


def _placed(options: CaptureOptions, world_from_source: np.ndarray) -> RigView:
    """The panorama that the user has placed, in the source's coordinates."""
    assert options.panorama is not None, "asked only where there is one"
    image = options.panorama.absolute()
    view = placed_panorama(image, read_size(image), options.panorama_place, options.panorama_heading)
    pose = conventions.transform_poses(np.linalg.inv(world_from_source), view.camera_to_world)
    return replace(view, camera_to_world=pose, mask=Folders().ids(image.parent / MASK_FOLDER, [view.name]))


@contextmanager
def _new_run(run_folder: RunFolder) -> Iterator[None]:
    """The run folder is there while the block runs; one that was made for it goes again where it fails."""
    is_new = not run_folder.run_json.exists()
    if is_new:
        run_folder.create(make_settings())
    try:
        yield
    except BaseException:
        if is_new:  # `create` refuses a folder that holds anything else
            shutil.rmtree(run_folder.root, ignore_errors=True)
        raise


def _chosen(views: list[RigView], count: int) -> list[RigView]:
    """At most `count` views, evenly spread over those that are not held back; all with 0."""
    if not 0 < count < len(views):
        return views
    held_back = [view for view in views if view.split == "held_back"]
    rest = [view for view in views if view.split != "held_back"]
    count = min(count, len(rest))
    return [rest[index * len(rest) // count] for index in range(count)] + held_back


def distinct_views(views: Sequence[RigView]) -> list[RigView]:
    """The first view of each photograph, with unique names: a.jpg and a.png have the same stem."""
    first: dict[Path, RigView] = {}
    for view in views:
        first.setdefault(view.image, view)
    taken: set[str] = set()
    unique = []
    for view in first.values():
        unique.append(replace(view, name=free_name(view.name, taken, "~", str.casefold)))
        taken.add(unique[-1].name.casefold())
    return unique


def _assign_splits(views: list[RigView], hold_back: int) -> list[RigView]:
    """Give all views a split; held-back views that the capture defines take precedence over `hold_back`."""
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
        raise FiptError("no-views.assign-splits")
    return views


def _check_files(views: list[RigView]) -> None:
    """Check that all files exist and have the right format and size."""
    missing = [view.missing for view in views if view.missing]
    if missing:
        text = f"Files of {len(missing)} of {len(views)} photographs are missing. {missing[0]}"
        raise FiptError("image-missing.check-files", text=text)
    for view in views:
        if is_network(str(view.image)):
            raise FiptError("path-network.check-files", image=view.image)
    for view in views:
        for kind in ("image", *ID_IMAGES):
            path, code = getattr(view, kind), "image-size" if kind == "image" else "mask-size"
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
                raise FiptError.of(code, text, remedy)
        if view.lens.model != EQUIRECTANGULAR and says_panorama(view.image, (view.width, view.height)):
            raise FiptError("camera-model.check-files", image=view.image, model=view.lens.model)


def _judged(
    source: Source,
    photographs: Sequence[Photograph],
    shown: Sequence[Sequence[np.ndarray | None]],
    options: CaptureOptions,
) -> list[Problem]:
    """A warning where cameras, points, mesh and photographs do not belong together, with what explains it.

    Args:
        shown: what is compared of each view of each photograph.
    """
    if options.correct == NONE:
        return []
    sights = []
    back = np.eye(4)
    back[:3, 3] = source.offset  # mistakes of poses are those of the source's coordinates
    for photograph, images in zip(photographs, shown, strict=True):
        for view, pinhole, image in zip(photograph.views, photograph.pinholes, images, strict=True):
            sights.append(sight(conventions.transform_poses(back, view.camera_to_world), pinhole, image))
    has_mesh = source.vertices is not None and len(source.triangles) > 0
    mesh = (source.vertices + source.offset, source.triangles) if has_mesh else None
    scene = Scene.of(sights, mesh, source.solved + source.offset)
    size = options.scale * float(np.ptp(mesh[0], axis=0).max()) if mesh is not None else USUAL_SIZES[0]
    doubt = not USUAL_SIZES[0] <= size <= USUAL_SIZES[1]
    finding = None if scene is None else examine(scene, source.rig.source, doubt=doubt)
    if scene is None or finding is None:
        return []
    if finding.is_sure and not options.correct:
        raise finding.error(at_import=True)
    return [finding.note(scene, source.mesh)]


def _convert(
    folder: Path, photographs: Sequence[Photograph], clamp_negative: bool, reporter: Reporter
) -> tuple[list[list[Files]], list[list[np.ndarray | None]]]:
    """Read all photographs, write what must be converted, and warn about them.

    Args:
        folder: for the images that are written.

    Returns:
        what was written and what is compared of each view of each photograph.
    """
    statistics, written, shown = [], [], []
    # Resamplings are made here, so that the threads share them.
    work = ((photograph, photograph.resamplings()) for photograph in photographs)
    first = [photograph.views[0] for photograph in photographs]
    most = threads_for(view.width * view.height for view in first)
    for found, files, images in in_threads(lambda item: item[0].convert(folder, item[1]), work, most):
        statistics.append(found)
        written.append(files)
        shown.append(images)
        reporter.progress(len(statistics) / len(photographs))
    pictures = [photograph.picture for photograph in photographs]
    encoded, exposures = zip(*((picture.is_encoded, picture.exposure) for picture in pictures), strict=True)
    judged = checks.judge_pixels([view.name for view in first], statistics, clamp_negative)
    for note in chain(judged, checks.judge_encoded(encoded, exposures)):
        reporter.warn(note)
    return written, shown
