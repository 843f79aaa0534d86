"""Step `solve`: cameras of the merged images, by pycolmap or from an existing solve, as sparse/0.

stage/solve holds the copies in which features are found, the database that a stopped solve goes on with,
and the model in the frame of the solve.
"""

from __future__ import annotations

import errno
import io
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
from PIL import Image

from ..core.capture.encoded import tone_mapped
from ..core.capture.files import Names, ambiguous, name_parts
from ..core.capture.formats import colmap
from ..core.capture.formats.colmap_sizes import check_model
from ..core.capture.formats.registry import read_rig
from ..core.capture.images import JPEG_QUALITY, read_radiance, read_size
from ..core.capture.options import CaptureOptions
from ..core.capture.rig import Rig
from ..core.run.errors import FiptError
from ..core.run.messages import Reporter, within
from ..core.run.replacing import atomic_folder
from ..core.run.runfolder import atomic_path, explained_write_errors
from . import lens
from .brackets import listed
from .facts import LeftOut, Registered, SolveFacts
from .preparation import Group, Preparation, PreparationFolder
from .solving import Solve, SolveView, camera_groups, copy_name, registered_names, solve

_COPIES_SHARE = 0.1  # of the step's time
POOR_ERROR = 1.5  # pixels of mean reprojection error; a good solve has less than one
SMALL_SIDE = 1000  # pixels; in smaller images, most photographs of a room have too few features
FEW_VIEWS = 3  # of one camera; with less, its focal length is hardly determined


def key(folder: PreparationFolder, preparation: Preparation) -> Any:
    """What the cameras depend on besides the merged images."""
    settings = preparation.settings
    lenses = [
        [group.name, *_lens_facts(preparation, group)] if not settings.cameras else [group.name]
        for group in preparation.used_groups
    ]
    return {"cameras": settings.cameras, "seed": settings.seed, "lenses": lenses}


def run(folder: PreparationFolder, preparation: Preparation, reporter: Reporter) -> SolveFacts:
    """Solve the cameras, or take those of an existing solve; returns facts for the report."""
    groups = preparation.used_groups
    missing = [group.name for group in groups if not folder.image(group).is_file()]
    if missing:
        raise FiptError("image-missing.run", missing=listed(missing))
    changed = _write_copies(folder, groups, reporter)
    if preparation.settings.cameras:
        solved = _existing(folder, preparation, reporter)
    else:
        if changed:  # features and matches are of other images
            with explained_write_errors(folder.stage):
                for file in folder.solve.glob("database.db*"):
                    file.unlink()
        solved = _solve(folder, preparation, reporter)
    for image in solved.model.images.values():
        image.name += ".exr"
    write_model(folder.model, solved.model)
    write_model(folder.sparse, solved.model)
    facts = _facts(solved)
    _warn(solved, facts, len(groups), reporter)
    return facts


def _solve(folder: PreparationFolder, preparation: Preparation, reporter: Reporter) -> Solve:
    views = []
    for group in preparation.used_groups:
        width, height = read_size(folder.image(group))
        camera = "|".join(str(value) for value in _lens_facts(preparation, group))
        start = lens.start(preparation.of(group)[0], width, height)
        views.append(SolveView(group.name, width, height, camera, *start))
    progress = within(reporter.progress, _COPIES_SHARE, 1.0)
    solved = solve(folder.solve, views, preparation.settings.seed, progress)
    for indices in camera_groups(views):
        if len(indices) < FEW_VIEWS < len(views):
            names = listed([views[index].name for index in indices])
            reporter.warning("camera-few-views", names=names)
    return solved


def _lens_facts(preparation: Preparation, group: Group) -> list[Any]:
    photograph = preparation.of(group)[0]
    return [getattr(photograph, name) for name in ("make", "model", "lens", "focal_length", "focal_35mm")]


def _write_copies(folder: PreparationFolder, groups: list[Group], reporter: Reporter) -> bool:
    """Write the copies of all views; whether any differs from the one that was there."""
    changed = False
    for index, group in enumerate(groups):
        buffer = io.BytesIO()
        picture = tone_mapped(read_radiance(folder.image(group)))
        Image.fromarray(picture).save(buffer, "JPEG", quality=JPEG_QUALITY)
        copy = folder.solve / "copies" / copy_name(group.name)
        if not copy.is_file() or copy.read_bytes() != buffer.getvalue():
            changed = True
            with atomic_path(copy) as temporary:
                temporary.write_bytes(buffer.getvalue())
        reporter.progress(_COPIES_SHARE * (index + 1) / len(groups))
    return changed


def _existing(folder: PreparationFolder, preparation: Preparation, reporter: Reporter) -> Solve:
    """The cameras of an existing solve, in any format that the capture readers know."""
    rig = read_rig(Path(preparation.settings.cameras).absolute(), "auto", CaptureOptions())
    for note in rig.notes:
        reporter.warn(note)
    wanted = []
    for group in preparation.used_groups:
        width, height = read_size(folder.image(group))
        wanted.append(SolveView(group.name, width, height, files=(group.name, *group.photographs)))
    model = model_from_rig(rig, wanted)
    placed = registered_names(model)
    left_out = tuple(
        LeftOut(group.name, "the existing solve does not have it", "Solve the cameras again with it.")
        for group in preparation.used_groups
        if group.name not in placed
    )
    return Solve(model, left_out, (len(placed),))


def _facts(solved: Solve) -> SolveFacts:
    model = solved.model
    registered = []
    for index in sorted(model.reg_image_ids(), key=lambda index: model.images[index].name):
        image = model.images[index]
        errors = [model.points3D[item.point3D_id].error for item in image.points2D if item.has_point3D()]
        error = round(float(np.mean(errors)), 3) if errors else None
        registered.append(Registered(image.name.removesuffix(".exr"), len(errors), error))
    error = round(model.compute_mean_reprojection_error(), 3) if model.num_points3D() else None
    return SolveFacts(tuple(registered), solved.left_out, solved.sizes, error)


def _warn(solved: Solve, facts: SolveFacts, count: int, reporter: Reporter) -> None:
    if len(solved.sizes) > 1:
        reporter.warning(
            "solve-split",
            number_of_sizes=len(solved.sizes),
            sizes=", ".join(str(size) for size in solved.sizes),
        )
    if solved.left_out:
        names = listed([item.name for item in solved.left_out])
        side = max(max(camera.width, camera.height) for camera in solved.model.cameras.values())
        remedy = solved.left_out[0].remedy
        if side < SMALL_SIDE:
            remedy = f"The images have {side} pixels, which show few features: set a larger working width."
        reporter.warning(
            "solve-left-out",
            number_of_left_out=len(solved.left_out),
            count=count,
            names=names,
            name=solved.left_out[0].name,
            reason=solved.left_out[0].reason,
            remedy=remedy,
        )
    error = facts.reprojection_error
    if error is not None and error > POOR_ERROR:
        reporter.warning("solve-inaccurate", error=error)


def write_model(folder: Path, model: pycolmap.Reconstruction) -> None:
    """Write a model in COLMAP's binary format; a model that is there is replaced by a complete one."""
    with atomic_folder(folder) as new:
        try:
            model.write_binary(str(new))
            check_model(new)
        except (RuntimeError, ValueError) as error:
            with explained_write_errors(folder):
                # pycolmap reports neither the system's reason nor that it could write a part only.
                raise OSError(errno.ENOSPC, str(error)) from None


def read_model(folder: Path) -> pycolmap.Reconstruction:
    """Read a model that `write_model` has written."""
    if not (folder / "cameras.bin").is_file():
        raise FiptError("file-missing.read-model", folder=folder)
    return colmap.opened(colmap.Model(folder, folder))


def poses(model: pycolmap.Reconstruction) -> np.ndarray:
    """(V, 4, 4) camera-to-world of the placed views, in the order of their numbers."""
    placed = [model.images[index].cam_from_world() for index in sorted(model.reg_image_ids())]
    return np.array([np.vstack([pose.inverse().matrix(), [0.0, 0.0, 0.0, 1.0]]) for pose in placed])


def model_from_rig(rig: Rig, wanted: list[SolveView]) -> pycolmap.Reconstruction:
    """A model without points of the views of an existing solve; sizes may differ by one factor.

    Args:
        rig: the existing solve.
        wanted: the capture's views; those that the rig lacks are left out.
    """
    called = {f"{index}/{view.name}": view for index, view in enumerate(rig.views)}
    names = Names(called)
    taken: dict[str, str] = {}
    model = pycolmap.Reconstruction()
    for view in wanted:
        # A photograph's whole path says more than the group's name, and that more than a file's name.
        files = sorted(view.files, key=lambda file: "/" not in file or not names.ending(name_parts(file)))
        name = next(filter(None, map(names.find, files)), None)
        if name is None:
            continue
        if taken.setdefault(name, view.name) != view.name:
            raise ambiguous(called[name].name, [taken[name], view.name])
        found = called[name]
        number = model.num_images() + 1
        camera = pycolmap.Camera(
            camera_id=number,
            model=found.lens.model,
            width=found.width,
            height=found.height,
            params=found.lens.parameters,
        )
        ratio = (view.width / found.width) / (view.height / found.height)
        # Rounding to whole pixels explains less.
        if abs(ratio - 1.0) > 0.01:
            raise FiptError(
                "solve-size",
                width=found.width,
                height=found.height,
                name=found.name,
                width_2=view.width,
                height_2=view.height,
            )
        camera.rescale(view.width, view.height)
        model.add_camera_with_trivial_rig(camera)
        world_to_camera = np.linalg.inv(found.camera_to_world)[:3]
        image = pycolmap.Image(name=view.name, camera_id=number, image_id=number)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(world_to_camera))
    if not model.num_images():
        raise FiptError("solve-foreign")
    return model
