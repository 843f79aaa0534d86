# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Reader for BlocksExchange XML of ContextCapture and iTwin Capture, which Metashape and others export, too.

Source: Bentley's ContextCapture User Guide, "BlocksExchange XML/XMZ format" and "Perspective camera model";
the iTwin Platform's documentation has the schema as "CC Orientations". Rotations lead from the world to the
axes that CameraOrientation names; the centre of the first pixel is (0, 0); P1 and P2 are OpenCV's p2 and p1.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from ...alignment.turns import turn_by
from ...run.errors import FiptError
from ..options import CaptureOptions
from ..places import Places
from ..rig import Lens, Note, Rig, RigView, WellFormed
from .radial import distorting_lens
from .rig_files import camera_file, camera_pose, largest_model, number, pixel_size, read_xml_rig

NAME = "blocksexchange"
LOOKS_FOR = "an XML file with BlocksExchange and Photogroups"
_CARTESIAN = ("LOCAL", "ENU", "ENGCRS")  # beginnings of systems whose numbers may be small
_DIRECTIONS = {"Right": (1, 0, 0), "Left": (-1, 0, 0), "Down": (0, 1, 0), "Up": (0, -1, 0)}
_MATRIX = "M_00 M_01 M_02 M_10 M_11 M_12 M_20 M_21 M_22"
_LOCAL = "Export cameras and mesh in a local coordinate system."
_ALIGN = "Export the block after its aerotriangulation."


def find(path: Path) -> Path | None:
    """The camera file at a path or in a folder, None without one."""
    return camera_file(path, (".xml",), lambda text: "<BlocksExchange" in text)


def read(file: Path, options: CaptureOptions) -> Rig:
    """Read the photographs with a pose of the largest block or component. The format defines no up axis.

    Raises:
        FiptError: ``rig-damaged``, ``camera-model``, ``intrinsics-missing``, ``pose-unsupported`` or
            ``no-views``.
    """
    places = Places.around(file, options)
    models: dict[tuple[int, str, str], list[RigView]] = {}
    lost = []
    with WellFormed(file):
        root = read_xml_rig(file)
        systems = {system.findtext("Id"): system.findtext("Definition", "") for system in root.iter("SRS")}
        for index, block in enumerate(root.iter("Block")):
            for group in block.iterfind("Photogroups/Photogroup"):
                system = systems.get(group.findtext("SRSId", block.findtext("SRSId")), "").strip()
                for photo in group.iterfind("Photo"):
                    component = photo.findtext("Component", "1").strip()
                    parts = photo.find("Pose/Rotation"), photo.find("Pose/Center")
                    if component == "0" or None in parts:  # 0: not aligned
                        lost.append(photo.findtext("ImagePath", ""))
                        places.find(lost[-1])  # it is told of here, and not as one without a camera
                        continue
                    view = _view(file, system, group, photo, places)
                    models.setdefault((index, system, component), []).append(view)
    views, notes = largest_model(list(models.values()), str(file))
    text = f"{file} has {len(lost)} photographs without a pose (the first is {''.join(lost[:1])[:200]!r})."
    if not views:
        raise FiptError("no-views", text, _ALIGN)
    if lost:
        notes += (Note("pose-lost", text, "Align these photographs, too, or leave them out there."),)
    views = tuple(sorted(views, key=lambda view: view.name))
    return places.rig(NAME, views, None, places.mesh(), notes)


def _view(file: Path, system: str, group: Element, photo: Element, places: Places) -> RigView:
    """The view of a photograph with a pose.

    Args:
        file: for messages.
        system: definition of the reference system; "" for a local one.
        group, photo: elements.
        places: where the photograph lies.
    """
    x, _, y = group.findtext("CameraOrientation", "XRightYDown").strip().removeprefix("X").partition("Y")
    axes = np.stack([_DIRECTIONS[x], _DIRECTIONS[y], np.cross(_DIRECTIONS[x], _DIRECTIONS[y])], axis=1)
    centre = _values(photo, "Pose/Center", "x y z")
    earth = system and not system.upper().startswith(_CARTESIAN)
    if earth and np.abs(centre[:2]).max() <= 180.0:  # maps and geocentric systems have larger numbers
        text = f"{file} has positions in degrees of longitude and latitude ({system[:40]!r})."
        raise FiptError("pose-unsupported", text, _LOCAL)
    size = pixel_size(*_values(group, "ImageDimensions", "Width Height"))
    pose = camera_pose(axes @ _rotation(file, photo), centre)
    return places.view(photo.findtext("ImagePath", ""), size, _lens(file, group, size), pose)


def _values(element: Element, path: str, keys: str) -> np.ndarray:
    return np.array([number(element.findtext(f"{path}/{key}")) for key in keys.split()])


def _rotation(file: Path, photo: Element) -> np.ndarray:
    """Rotation (3, 3) from the world to the axes of CameraOrientation."""
    if photo.find("Pose/Rotation/M_00") is not None:
        return _values(photo, "Pose/Rotation", _MATRIX).reshape(3, 3)
    if photo.find("Pose/Rotation/Omega") is None:
        text = f"{file} has rotations that are neither matrices nor the angles Omega, Phi and Kappa."
        raise FiptError("pose-unsupported", text, "Export rotations as matrices.")
    x, y, z = np.diag(np.radians(_values(photo, "Pose/Rotation", "Omega Phi Kappa")))
    return (turn_by(x) @ turn_by(y) @ turn_by(z)).T


def _lens(file: Path, group: Element, size: tuple[int, int]) -> Lens:
    """The lens of a photogroup. SensorSize is that of the photographs' longer side."""
    model = group.findtext("CameraModelType", "Perspective").strip()
    skew = number(group.findtext("Skew", "0"))
    if model != "Perspective" or skew != 0.0 or group.find("PrincipalPoint/xmm") is not None:
        text = f"{file} has a camera of the type {model[:40]!r}, a skew or a principal point in millimetres."
        raise FiptError("camera-model", text, "Export undistorted photographs with their cameras in pixels.")
    focal = group.findtext("FocalLengthPixels")
    if focal is None and (group.find("FocalLength") is None or group.find("SensorSize") is None):
        text = f"{file} has a photogroup without FocalLengthPixels, or FocalLength and SensorSize."
        raise FiptError("intrinsics-missing", text, _ALIGN)
    if focal is None:
        fx = number(group.findtext("FocalLength")) * max(size) / number(group.findtext("SensorSize"))
    else:
        fx = number(focal)
    cx, cy = 0.5 * np.array(size)
    if group.find("PrincipalPoint") is not None:
        cx, cy = _values(group, "PrincipalPoint", "x y") + 0.5
    k1, k2, k3, p1, p2 = (
        number(group.findtext(f"Distortion/{key}", "0")) for key in "K1 K2 K3 P1 P2".split()
    )
    intrinsics = (fx, fx * number(group.findtext("AspectRatio", "1")), float(cx), float(cy))
    return distorting_lens(intrinsics, size, (k1, k2, k3), (p2, p1))
