# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""COLMAP models as `prepare` keeps them: written as a whole, transformed, and asked for rays and depths."""

from __future__ import annotations

import errno
import os
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap

from ..core.capture.files import Names, ambiguous, name_parts
from ..core.capture.formats.colmap_sizes import check_model
from ..core.capture.rig import Rig
from ..core.run.errors import FiptError
from ..core.run.runfolder import explained_write_errors

_SOLVE_AGAIN = "Solve the cameras again (step solve)."


def write_model(folder: Path, model: pycolmap.Reconstruction) -> None:
    """Write a model in COLMAP's binary format; a model that is there is replaced by a complete one.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    temporary = folder.with_name(f".{os.getpid()}.{folder.name}")
    with explained_write_errors(folder):
        temporary.mkdir(parents=True, exist_ok=True)
        try:
            try:
                model.write_binary(str(temporary))
                check_model(temporary)
            except (RuntimeError, ValueError) as error:
                # pycolmap reports neither the system's reason nor that it could write a part only.
                raise OSError(errno.ENOSPC, str(error)) from None
            if folder.exists():
                shutil.rmtree(folder)
            os.replace(temporary, folder)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)


def read_model(folder: Path) -> pycolmap.Reconstruction:
    """Read a model that `write_model` has written.

    Raises:
        FiptError: ``file-missing`` or ``file-damaged``.
    """
    if not (folder / "cameras.bin").is_file():
        raise FiptError("file-missing", f"{folder} holds no solved cameras.", _SOLVE_AGAIN)
    try:
        check_model(folder)
        return pycolmap.Reconstruction(str(folder))
    except (RuntimeError, ValueError, IndexError, OSError) as error:
        raise FiptError("file-damaged", f"{folder} can't be read ({error}).", _SOLVE_AGAIN) from None


def poses(model: pycolmap.Reconstruction) -> np.ndarray:
    """(V, 4, 4) camera-to-world of the placed views, in the order of their numbers."""
    placed = [model.images[index].cam_from_world() for index in sorted(model.reg_image_ids())]
    return np.array([np.vstack([pose.inverse().matrix(), [0.0, 0.0, 0.0, 1.0]]) for pose in placed])


@dataclass(frozen=True)
class WantedView:
    """A view of the capture: its name, its size, and paths of files by which a rig may call it."""

    name: str
    width: int
    height: int
    files: tuple[str, ...]


def model_from_rig(rig: Rig, wanted: list[WantedView]) -> pycolmap.Reconstruction:
    """A model without points of the views of an existing solve; sizes may differ by one factor.

    Args:
        rig: the existing solve.
        wanted: the capture's views; those that the rig lacks are left out.

    Raises:
        FiptError: ``solve-foreign`` where no view is found, ``solve-size`` where an image has another shape,
            ``file-ambiguous`` where a name fits several views, or a view several names.
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
                f"The existing solve has {found.width} x {found.height} pixels for {found.name}, but the "
                f"photograph has {view.width} x {view.height}.",
                "Use the solve of these photographs, neither cropped nor rotated nor undistorted.",
            )
        camera.rescale(view.width, view.height)
        model.add_camera_with_trivial_rig(camera)
        world_to_camera = np.linalg.inv(found.camera_to_world)[:3]
        image = pycolmap.Image(name=view.name, camera_id=number, image_id=number)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(world_to_camera))
    if not model.num_images():
        raise FiptError(
            "solve-foreign",
            "The existing solve has none of the photographs: no name agrees.",
            "Use the solve of these photographs; its images are named like the photographs or the groups.",
        )
    return model
