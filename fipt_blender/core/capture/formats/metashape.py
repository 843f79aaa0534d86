# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Reader for Agisoft Metashape's camera XML (File > Export > Export Cameras).

Source: Metashape's user manual, appendix "Camera models". Poses are camera to chunk with OpenCV axes; the
chunk's transform leads to the coordinates of exported meshes. Metashape's P1 and P2 are OpenCV's p2 and p1.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from ...conventions import transform_poses
from ...run.errors import FiptError
from ..options import CaptureOptions
from ..places import Places
from ..rig import EQUIRECTANGULAR, Lens, Rig, RigView, WellFormed
from .radial import distorting_lens
from .rig_files import (
    camera_file,
    cameras_off,
    largest_model,
    number,
    numbers,
    pixel_size,
    read_xml_rig,
    similarity,
)

NAME = "metashape"
LOOKS_FOR = "an XML file with chunk, sensors and cameras"
_RADIAL = ("k1", "k2", "k3", "k4")
_UNSUPPORTED = ("p3", "p4", "b2")


@dataclass(frozen=True, eq=False)
class _Sensor:
    """A calibrated camera: image size, lens, and its pose (4, 4) in the camera that leads its rig."""

    size: tuple[int, int]
    lens: Lens
    offset: np.ndarray


def find(path: Path) -> Path | None:
    """The camera file at a path or in a folder, None without one."""
    return camera_file(path, (".xml",), lambda text: "<chunk" in text and "<sensor" in text)


def read(file: Path, options: CaptureOptions) -> Rig:
    """Read the aligned and enabled cameras of the largest chunk or component; a rig's follow its master.

    Metashape does not define an up axis.

    Raises:
        FiptError: ``rig-damaged``, ``camera-model`` or ``intrinsics-missing``.
    """
    places = Places.around(file, options)
    with WellFormed(file):
        chunks = [chunk for chunk in read_xml_rig(file).iter("chunk") if chunk.find("cameras") is not None]
        chunks = [chunk for chunk in chunks if _is_on(chunk)] or chunks
        models = [model for chunk in chunks for model in _models(file, chunk, places)]
    views, notes = largest_model(models, str(file))
    off = [camera for chunk in chunks for camera in _cameras(chunk) if not _is_on(camera)]
    notes = (*notes, *cameras_off(file, [camera.get("label", "") for camera in off]))
    return places.rig(NAME, views, None, places.mesh(), notes)


def _models(file: Path, chunk: Element, places: Places) -> list[list[RigView]]:
    """The views of each component of a chunk.

    Raises:
        ValueError: what is wrong.
    """
    sensors = {sensor.get("id"): sensor for sensor in chunk.iterfind("sensors/sensor")}
    cameras = {camera.get("id"): camera for camera in _cameras(chunk)}
    transforms = {part.get("id"): _transform(part) for part in chunk.iterfind("components/component")}
    whole = _transform(chunk)
    calibrated: dict[str | None, _Sensor] = {}
    models: dict[str | None, list[RigView]] = {}
    for camera in sorted(cameras.values(), key=lambda camera: camera.get("label", "")):
        master = cameras.get(camera.get("master_id"))
        pose = _pose(camera) if master is None or camera.find("transform") is not None else _pose(master)
        if pose is None or not _is_on(camera):
            continue
        key = camera.get("sensor_id") or (master.get("sensor_id") if master is not None else None)
        if key not in sensors:
            raise ValueError(f"the camera {camera.get('label')!r} has no sensor")
        if key not in calibrated:
            calibrated[key] = _sensor(file, sensors[key])
        sensor = calibrated[key]
        if master is not None and camera.find("transform") is None:
            pose = pose @ sensor.offset
        component = camera.get("component_id") or (master.get("component_id") if master is not None else None)
        pose = transform_poses(transforms.get(component, whole), pose)
        models.setdefault(component, []).append(
            places.view(camera.get("label") or "unnamed", sensor.size, sensor.lens, pose)
        )
    return list(models.values())


def _cameras(chunk: Element) -> list[Element]:
    return list(chunk.iterfind("cameras//camera"))


def _is_on(element: Element) -> bool:
    """Whether a camera or chunk is enabled in Metashape."""
    return element.get("enabled", "true").strip().lower() not in ("false", "0")


def _pose(camera: Element) -> np.ndarray | None:
    """Camera-to-chunk (4, 4), None for a camera that was not aligned."""
    element = camera.find("transform")
    return None if element is None else numbers(element.text or "", 16).reshape(4, 4)


def _transform(element: Element) -> np.ndarray:
    """Similarity (4, 4) from a chunk or component to the world, the identity where it has no transform."""
    transform = element.find("transform")
    if transform is None:
        return np.eye(4)
    return similarity(
        number(transform.findtext("scale", "1")),
        numbers(transform.findtext("rotation", "1 0 0 0 1 0 0 0 1"), 9).reshape(3, 3),
        numbers(transform.findtext("translation", "0 0 0"), 3),
    )


def _sensor(file: Path, sensor: Element) -> _Sensor:
    """The calibration of a sensor, the adjusted one where there are several.

    Raises:
        ValueError: what is wrong.
        FiptError: ``camera-model`` or ``intrinsics-missing``.
    """
    calibrations = sensor.findall("calibration")
    adjusted = [entry for entry in calibrations if entry.get("class") == "adjusted"]
    calibration = next(iter((*adjusted, *calibrations)), Element("calibration"))
    kind = calibration.get("type") or sensor.get("type") or "frame"
    if kind != "spherical" and calibration.find("f") is None:
        raise FiptError(
            "intrinsics-missing",
            f"{file} has the sensor {sensor.get('label', '')[:80]!r} without a calibrated focal length.",
            "Align the photographs in Metashape, then export the cameras again.",
        )
    resolution = sensor.find("resolution")
    if resolution is None:
        resolution = calibration.find("resolution")
    if resolution is None:
        raise ValueError("a sensor has no resolution")
    size = pixel_size(resolution.get("width"), resolution.get("height"))
    values = {entry.tag: number(entry.text) for entry in calibration if entry.tag in _PARAMETERS}
    return _Sensor(size, _lens(file, kind, values, size), _offset(sensor))


_PARAMETERS = ("f", "cx", "cy", "b1", "p1", "p2", *_RADIAL, *_UNSUPPORTED)


def _offset(sensor: Element) -> np.ndarray:
    """Pose (4, 4) of a sensor in the camera that leads its rig; the identity for that camera itself."""
    return similarity(
        1.0,
        numbers(sensor.findtext("rotation", "1 0 0 0 1 0 0 0 1"), 9).reshape(3, 3),
        numbers(sensor.findtext("translation", sensor.findtext("location", "0 0 0")), 3),
    )


def _lens(file: Path, kind: str, values: dict[str, float], size: tuple[int, int]) -> Lens:
    """The lens of a calibration; b1 widens the pixels, cx and cy are offsets from the image's centre."""
    if kind == "spherical" and not any(value for name, value in values.items() if name != "f"):
        return Lens(EQUIRECTANGULAR, (float(size[0]), float(size[1])))
    if kind not in ("frame", "fisheye") or any(values.get(key) for key in _UNSUPPORTED):
        raise FiptError(
            "camera-model",
            f"{file} has a camera of the type {kind[:40]!r}{_nonzero(values)}, which is not supported.",
            "Use the types Frame or Fisheye without B2, P3 and P4, or Spherical without parameters (Tools >"
            " Camera Calibration), align again.",
        )
    focal = values["f"]
    intrinsics = (
        focal + values.get("b1", 0.0),
        focal,
        0.5 * size[0] + values.get("cx", 0.0),
        0.5 * size[1] + values.get("cy", 0.0),
    )
    tangential = (values.get("p2", 0.0), values.get("p1", 0.0))
    k1, k2, k3, k4 = (values.get(key, 0.0) for key in _RADIAL)
    if kind == "frame":
        return distorting_lens(intrinsics, size, (k1, k2, k3, k4), tangential)
    return Lens("THIN_PRISM_FISHEYE", (*intrinsics, k1, k2, *tangential, k3, k4, 0.0, 0.0))


def _nonzero(values: dict[str, float]) -> str:
    names = ", ".join(key.upper() for key in _UNSUPPORTED if values.get(key))
    return f" with {names}" if names else ""
