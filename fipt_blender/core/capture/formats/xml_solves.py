"""Readers of solves in XML files: Metashape's, and BlocksExchange of ContextCapture and iTwin Capture.

Sources: Metashape's user manual, appendix "Camera models"; Bentley's ContextCapture User Guide,
"BlocksExchange XML/XMZ format" and "Perspective camera model"; the iTwin Platform's schema "CC Orientations".
Both have OpenCV's p2 and p1 as P1 and P2, and no up axis.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from ...alignment.turns import turn_by
from ...conventions import transform_poses
from ...run.errors import FiptError, problem
from ..places import Places
from ..rig import EQUIRECTANGULAR, Lens, RigView
from .radial import distorting_lens
from .rig_files import (
    Models,
    Program,
    camera_pose,
    cameras_off,
    number,
    numbers,
    pixel_size,
    read_xml_rig,
    similarity,
    unsupported,
)

# Parameters of Metashape's lenses.
_RADIAL = ("k1", "k2", "k3", "k4")
_UNSUPPORTED = ("p3", "p4", "b2")
_PARAMETERS = ("f", "cx", "cy", "b1", "p1", "p2", *_RADIAL, *_UNSUPPORTED)
_CARTESIAN = ("LOCAL", "ENU", "ENGCRS")  # beginnings of systems whose numbers may be small
_DIRECTIONS = {"Right": (1, 0, 0), "Left": (-1, 0, 0), "Down": (0, 1, 0), "Up": (0, -1, 0)}
_MATRIX = "M_00 M_01 M_02 M_10 M_11 M_12 M_20 M_21 M_22"  # BlocksExchange's rotations


# ------------------------------------------------------------------------------------------------ Metashape


def _metashape(file: Path, places: Places) -> Models:
    """The aligned and enabled cameras of each chunk and component; a rig's follow its master.

    Poses are camera to chunk with OpenCV axes; the chunk's transform leads to the coordinates of exported
    meshes.
    """
    chunks = [chunk for chunk in read_xml_rig(file).iter("chunk") if chunk.find("cameras") is not None]
    chunks = [chunk for chunk in chunks if _is_on(chunk)] or chunks
    models = [model for chunk in chunks for model in _components(file, chunk, places)]
    off = [camera for chunk in chunks for camera in _cameras(chunk) if not _is_on(camera)]
    return models, cameras_off(file, [camera.get("label", "") for camera in off])


# A calibrated camera: image size, lens, and its pose (4, 4) in the camera that leads its rig.
_Sensor = tuple[tuple[int, int], Lens, np.ndarray]


def _components(file: Path, chunk: Element, places: Places) -> list[list[RigView]]:
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
    for camera in cameras.values():
        master = cameras.get(camera.get("master_id"))
        pose = (
            _chunk_pose(camera)
            if master is None or camera.find("transform") is not None
            else _chunk_pose(master)
        )
        if pose is None or not _is_on(camera):
            continue
        key = camera.get("sensor_id") or (master.get("sensor_id") if master is not None else None)
        if key not in sensors:
            raise ValueError(f"the camera {camera.get('label')!r} has no sensor")
        if key not in calibrated:
            calibrated[key] = _sensor(file, sensors[key])
        size, lens, offset = calibrated[key]
        if master is not None and camera.find("transform") is None:
            pose = pose @ offset
        component = camera.get("component_id") or (master.get("component_id") if master is not None else None)
        pose = transform_poses(transforms.get(component, whole), pose)
        view = places.view(camera.get("label") or "unnamed", size, lens, pose)
        models.setdefault(component, []).append(view)
    return list(models.values())


def _cameras(chunk: Element) -> list[Element]:
    return list(chunk.iterfind("cameras//camera"))


def _is_on(element: Element) -> bool:
    """Whether a camera or chunk is enabled in Metashape."""
    return element.get("enabled", "true").strip().lower() not in ("false", "0")


def _chunk_pose(camera: Element) -> np.ndarray | None:
    """Camera-to-chunk (4, 4), None for a camera that was not aligned."""
    element = camera.find("transform")
    return None if element is None else numbers(element.text or "", 16).reshape(4, 4)


def _transform(element: Element) -> np.ndarray:
    """Similarity (4, 4) from a chunk or component to the world, the identity where it has no transform."""
    transform = element.find("transform")
    if transform is None:
        return np.eye(4)
    scale = number(transform.findtext("scale", "1"))
    return _placed(transform, scale, transform.findtext("translation", "0 0 0"))


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
        raise FiptError("intrinsics-missing.sensor", file=file, get=sensor.get("label", "")[:80])
    resolution = sensor.find("resolution")
    if resolution is None:
        resolution = calibration.find("resolution")
    if resolution is None:
        raise ValueError("a sensor has no resolution")
    size = pixel_size(resolution.get("width"), resolution.get("height"))
    values = {entry.tag: number(entry.text) for entry in calibration if entry.tag in _PARAMETERS}
    place = sensor.findtext("translation", sensor.findtext("location", "0 0 0"))
    return size, _metashape_lens(file, kind, values, size), _placed(sensor, 1.0, place)


def _placed(element: Element, scale: float, place: str) -> np.ndarray:
    """Similarity (4, 4) of an element's rotation, a scale and a place as text."""
    rotation = numbers(element.findtext("rotation", "1 0 0 0 1 0 0 0 1"), 9).reshape(3, 3)
    return similarity(scale, rotation, numbers(place, 3))


def _metashape_lens(file: Path, kind: str, values: dict[str, float], size: tuple[int, int]) -> Lens:
    """The lens of a calibration; b1 widens the pixels, cx and cy are offsets from the image's centre."""
    if kind == "spherical" and not any(value for name, value in values.items() if name != "f"):
        return Lens(EQUIRECTANGULAR, (float(size[0]), float(size[1])))
    if kind not in ("frame", "fisheye") or any(values.get(key) for key in _UNSUPPORTED):
        names = ", ".join(key.upper() for key in _UNSUPPORTED if values.get(key))
        raise unsupported(
            file,
            f"a camera of the type {kind[:40]!r}{' with ' * bool(names)}{names}",
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


# ------------------------------------------------------------------------------------------- BlocksExchange


def _blocksexchange(file: Path, places: Places) -> Models:
    """The photographs with a pose of each block and component.

    Rotations lead from the world to the axes that CameraOrientation names; the centre of the first pixel is
    (0, 0).
    """
    models: dict[tuple[int, str, str], list[RigView]] = {}
    lost = []
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
                view = _photo_view(file, system, group, photo, places)
                models.setdefault((index, system, component), []).append(view)
    text = f"{file} has {len(lost)} photographs without a pose (the first is {''.join(lost[:1])[:200]!r})."
    if not models:
        raise FiptError("no-views.blocksexchange", text=text)
    note = problem("pose-lost.blocksexchange", text=text)
    return list(models.values()), (note,) * bool(lost)


def _photo_view(file: Path, system: str, group: Element, photo: Element, places: Places) -> RigView:
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
        raise FiptError("pose-unsupported.photo-view", file=file, system=system[:40])
    size = pixel_size(*_values(group, "ImageDimensions", "Width Height"))
    pose = camera_pose(axes @ _rotation(file, photo), centre)
    return places.view(photo.findtext("ImagePath", ""), size, _block_lens(file, group, size), pose)


def _values(element: Element, path: str, keys: str) -> np.ndarray:
    return np.array([number(element.findtext(f"{path}/{key}")) for key in keys.split()])


def _rotation(file: Path, photo: Element) -> np.ndarray:
    """Rotation (3, 3) from the world to the axes of CameraOrientation."""
    if photo.find("Pose/Rotation/M_00") is not None:
        return _values(photo, "Pose/Rotation", _MATRIX).reshape(3, 3)
    if photo.find("Pose/Rotation/Omega") is None:
        raise FiptError("pose-unsupported.rotation", file=file)
    x, y, z = np.diag(np.radians(_values(photo, "Pose/Rotation", "Omega Phi Kappa")))
    return (turn_by(x) @ turn_by(y) @ turn_by(z)).T


def _block_lens(file: Path, group: Element, size: tuple[int, int]) -> Lens:
    """The lens of a photogroup. SensorSize is that of the photographs' longer side."""
    model = group.findtext("CameraModelType", "Perspective").strip()
    skew = number(group.findtext("Skew", "0"))
    if model != "Perspective" or skew != 0.0 or group.find("PrincipalPoint/xmm") is not None:
        what = f"a camera of the type {model[:40]!r}, a skew or a principal point in millimetres"
        raise unsupported(file, what, "Export undistorted photographs with their cameras in pixels.")
    focal = group.findtext("FocalLengthPixels")
    if focal is None and (group.find("FocalLength") is None or group.find("SensorSize") is None):
        raise FiptError("intrinsics-missing.block-lens", file=file)
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


PROGRAMS = (
    Program(
        "metashape",
        "an XML file with chunk, sensors and cameras",
        (".xml",),
        lambda text: "<chunk" in text and "<sensor" in text,
        _metashape,
    ),
    Program(
        "blocksexchange",
        "an XML file with BlocksExchange and Photogroups",
        (".xml",),
        lambda text: "<BlocksExchange" in text,
        _blocksexchange,
    ),
)
