"""Camera files of other programs, written by the rules of their documentation from cameras of known poses.

Nothing here uses the readers' code: each writer states its program's axes and units itself.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from samples.camera_poses import random_rotation

FLIP_YZ = np.diag([1.0, -1.0, -1.0])  # OpenCV's camera axes from OpenGL's, and back


@dataclass
class Shot:
    """A photograph: pixels, intrinsics, OpenCV's coefficients, rotation from the world and centre."""

    name: str
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    rotation: np.ndarray
    centre: np.ndarray
    k: tuple[float, ...] = ()
    p: tuple[float, float] = (0.0, 0.0)
    fisheye: bool = False

    @property
    def pose(self) -> np.ndarray:
        """Camera to world (4, 4), OpenCV axes."""
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = self.rotation.T, self.centre
        return pose

    def pixel(self, point: np.ndarray) -> np.ndarray:
        """The pixel of a point in the world, by OpenCV's camera models with any number of coefficients."""
        x, y, z = self.rotation @ (point - self.centre)
        x, y = x / z, y / z
        radius = math.hypot(x, y)
        if self.fisheye:
            angle = math.atan(radius)
            x, y = x * angle / radius, y * angle / radius
        square = x * x + y * y
        radial = 1.0 + sum(k * square ** (i + 1) for i, k in enumerate(self.k))
        p1, p2 = self.p
        u = x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x)
        v = y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y
        return np.array([self.fx * u + self.cx, self.fy * v + self.cy])


@dataclass
class Style:
    """What a program's cameras can have."""

    k: tuple[float, ...] = ()
    p: tuple[float, float] = (0.0, 0.0)
    aspect: float = 1.0
    off_centre: tuple[float, float] = (2.5, -1.5)
    fisheye: bool = False


def make_shots(style: Style | None = None, count: int = 4) -> list[Shot]:
    """Landscape and portrait in turn, anywhere and turned in any way."""
    style = style or Style()
    rng = np.random.default_rng(11)
    shots = []
    for index in range(count):
        width, height = (480, 320) if index % 2 == 0 else (320, 480)
        focal = 400.0 + index
        cx, cy = 0.5 * width + style.off_centre[0], 0.5 * height + style.off_centre[1]
        rotation, centre = random_rotation(rng), rng.uniform(-3.0, 3.0, 3)
        shots.append(
            Shot(f"IMG_{index:04d}.jpg", width, height, focal * style.aspect, focal, cx, cy, rotation, centre,
                 style.k, style.p, style.fisheye)
        )  # fmt: skip
    return shots


def write_photographs(folder: Path, shots: list[Shot]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for shot in shots:
        Image.new("RGB", (shot.width, shot.height), (90, 90, 90)).save(folder / Path(shot.name).name)


def text(values) -> str:
    return " ".join(f"{float(value):.12g}" for value in np.ravel(values))


def quaternion(rotation: np.ndarray) -> list[float]:
    """w, x, y, z of a rotation."""
    x, y, z, w = Rotation.from_matrix(rotation).as_quat()
    return [w, x, y, z]


# -------------------------------------------------------------------------------- Meshroom, OpenSfM, OpenMVG


def write_meshroom(folder: Path, shots: list[Shot], version: tuple[int, int, int]) -> None:
    """cameras.sfm; all numbers are texts. The world is that of the mesh file, whose Y and Z are negated."""
    views, intrinsics, poses = [], [], []
    for index, shot in enumerate(shots):
        shared = {"width": str(shot.width), "height": str(shot.height)}
        path = f"B:\\photos\\{shot.name}"
        views.append(
            {"viewId": str(index), "poseId": str(index), "intrinsicId": str(70 + index), "path": path, **shared}
        )
        rotation, centre = (FLIP_YZ @ shot.rotation.T).T, FLIP_YZ @ shot.centre
        stored = [str(rotation[row, column]) for column in range(3) for row in range(3)]
        transform = {"rotation": stored, "center": [str(value) for value in centre]}
        poses.append({"poseId": str(index), "pose": {"transform": transform, "locked": "0"}})
        intrinsics.append({"intrinsicId": str(70 + index), **shared, **meshroom_lens(shot, version)})
    folder.mkdir(parents=True, exist_ok=True)
    data = {"version": [str(v) for v in version], "views": views, "intrinsics": intrinsics, "poses": poses}
    (folder / "cameras.sfm").write_text(json.dumps(data, indent=1))
    write_photographs(folder / "images", shots)


def meshroom_lens(shot: Shot, version: tuple[int, int, int]) -> dict:
    """Focal lengths in pixels until 1.2.1, in millimetres on a sensor of 6.4 mm from 1.2.2 on."""
    lens: dict = {"distortionParams": [str(value) for value in (*shot.k, *(shot.p if any(shot.p) else ()))]}
    kind = {0: "none", 1: "radialk1", 3: "radialk3", 5: "brown", 4: "fisheye"}[len(lens["distortionParams"])]
    old = {"none": "pinhole", "radialk1": "radial1", "radialk3": "radial3", "fisheye": "fisheye4"}
    if version >= (1, 2, 8):
        lens |= {"type": "pinhole", "distortionType": kind, "undistortionType": "none"}
    else:
        lens["type"] = old.get(kind, kind)
    offset = (0.0, 0.0) if version < (1, 2, 1) else (shot.width / 2, shot.height / 2)
    lens["principalPoint"] = [str(shot.cx - offset[0]), str(shot.cy - offset[1])]
    if version < (1, 2, 0):
        return {**lens, "pxFocalLength": str(shot.fx)}
    if version < (1, 2, 2):
        return {**lens, "pxFocalLength": [str(shot.fx), str(shot.fy)]}
    focal = shot.fy if version >= (1, 2, 11) else shot.fx
    ratio = shot.fx / shot.fy if version < (1, 2, 5) else shot.fy / shot.fx
    return {**lens, "sensorWidth": "6.4", "focalLength": str(focal * 6.4 / shot.width), "pixelRatio": str(ratio)}


def write_opensfm(folder: Path, groups: list[list[Shot]], kind: str, points: Sequence[np.ndarray] = ()) -> None:
    """reconstruction.json: lengths over the longer side, axis times angle, translation; sparse points."""
    stored = {str(index): {"coordinates": list(point)} for index, point in enumerate(points)}
    models = []
    for shots in groups:
        model: dict = {"cameras": {}, "shots": {}, "points": stored, "reference_lla": {}}
        for shot in shots:
            side = max(shot.width, shot.height)
            camera = {"projection_type": kind, "width": shot.width, "height": shot.height}
            camera |= {f"k{i + 1}": value for i, value in enumerate(shot.k)}
            if kind in ("perspective", "fisheye"):
                camera["focal"] = shot.fx / side
            else:
                camera |= {"focal_x": shot.fx / side, "focal_y": shot.fy / side, "p1": shot.p[0], "p2": shot.p[1]}
                camera |= {"c_x": (shot.cx - shot.width / 2) / side, "c_y": (shot.cy - shot.height / 2) / side}
            model["cameras"][f"camera of {shot.name}"] = camera
            w, x, y, z = quaternion(shot.rotation)
            length = math.sqrt(x * x + y * y + z * z)
            factor = 2.0 * math.atan2(length, w) / length if length else 0.0
            model["shots"][shot.name] = {
                "camera": f"camera of {shot.name}",
                "rotation": [x * factor, y * factor, z * factor],
                "translation": (-shot.rotation @ shot.centre).tolist(),
            }
        models.append(model)
    write_photographs(folder / "images", [shot for shots in groups for shot in shots])
    (folder / "reconstruction.json").write_text(json.dumps(models))


def write_openmvg(folder: Path, shots: list[Shot], kind: str, key: str) -> None:
    """sfm_data.json as cereal writes it: a type's name only where it first appears."""
    views, intrinsics, extrinsics = [], [], []
    for index, shot in enumerate(shots):
        wrapped = {"id": 2147483650 + index, "data": {
            "local_path": "/", "filename": shot.name, "width": shot.width, "height": shot.height,
            "id_view": index, "id_intrinsic": index, "id_pose": index,
        }}  # fmt: skip
        views.append({"key": index, "value": {"polymorphic_id": 1073741824, "ptr_wrapper": wrapped}})
        data = {
            "width": shot.width, "height": shot.height, "focal_length": shot.fx,
            "principal_point": [shot.cx, shot.cy],
        }  # fmt: skip
        if key:
            data[key] = [*shot.k, *(shot.p if key == "disto_t2" else ())]
        first = {"polymorphic_id": 2147483649, "polymorphic_name": kind}
        value = {**(first if index == 0 else {"polymorphic_id": 1}), "ptr_wrapper": {"id": 1, "data": data}}
        intrinsics.append({"key": index, "value": value})
        extrinsics.append({"key": index, "value": {"rotation": shot.rotation.tolist(), "center": shot.centre.tolist()}})
    data = {"sfm_data_version": "0.3", "root_path": "/home/someone/images", "views": views,
            "intrinsics": intrinsics, "extrinsics": extrinsics, "structure": []}  # fmt: skip
    write_photographs(folder / "images", shots)
    (folder / "sfm_data.json").write_text(json.dumps(data))


# -------------------------------------------------------------------------------------------- BlocksExchange

# Rows: the camera's axes X, Y and Z as the format names them, in OpenCV's.
ORIENTATIONS = {
    "XRightYDown": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "XRightYUp": [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
    "XDownYRight": [[0, 1, 0], [1, 0, 0], [0, 0, -1]],
    "XUpYRight": [[0, -1, 0], [1, 0, 0], [0, 0, 1]],
}


def write_blocksexchange(
    folder: Path, shots: list[Shot], orientation: str = "XRightYDown", angles: bool = False, system: str = ""
) -> None:
    """block.xml. With `angles` in place of matrices, focal lengths are in millimetres of a sensor of 36 mm."""
    groups = ""
    for index, shot in enumerate(shots):
        matrix = np.array(ORIENTATIONS[orientation]) @ shot.rotation
        values = {f"M_{row}{column}": matrix[row, column] for row in range(3) for column in range(3)}
        focal = f"<FocalLengthPixels>{shot.fx!r}</FocalLengthPixels>"
        if angles:
            values = {
                "Omega": math.degrees(math.atan2(-matrix[2, 1], matrix[2, 2])),
                "Phi": math.degrees(math.asin(matrix[2, 0])),
                "Kappa": math.degrees(math.atan2(-matrix[1, 0], matrix[0, 0])),
            }
            millimetres = shot.fx * 36.0 / max(shot.width, shot.height)
            focal = f"<SensorSize>36</SensorSize><FocalLength>{millimetres!r}</FocalLength>"
        k1, k2, k3 = (*shot.k, 0.0, 0.0, 0.0)[:3]
        lens = {"K1": k1, "K2": k2, "K3": k3, "P1": shot.p[1], "P2": shot.p[0]}
        groups += (
            f"<Photogroup><ImageDimensions>{tags({'Width': shot.width, 'Height': shot.height})}</ImageDimensions>"
            f"<CameraModelType>Perspective</CameraModelType>{focal}"
            f"<CameraOrientation>{orientation}</CameraOrientation>"
            f"<PrincipalPoint>{tags({'x': shot.cx - 0.5, 'y': shot.cy - 0.5})}</PrincipalPoint>"
            f"<Distortion>{tags(lens)}</Distortion><AspectRatio>{shot.fy / shot.fx!r}</AspectRatio><Skew>0</Skew>"
            f"<Photo><Id>{index}</Id><ImagePath>{shot.name}</ImagePath><Component>1</Component>"
            f"<Pose><Rotation>{tags(values)}</Rotation>"
            f"<Center>{tags(dict(zip('xyz', shot.centre, strict=True)))}</Center></Pose></Photo></Photogroup>\n"
        )
    write_photographs(folder, shots)
    (folder / "block.xml").write_text(
        '<?xml version="1.0" encoding="utf-8"?>\n<BlocksExchange version="3.2"><SpatialReferenceSystems><SRS>'
        f"<Id>2</Id><Definition>{system}</Definition></SRS></SpatialReferenceSystems>"
        f"<Block><SRSId>2</SRSId><Photogroups>{groups}</Photogroups></Block></BlocksExchange>"
    )


def tags(values: dict[str, float]) -> str:
    return "".join(f"<{key}>{float(value)!r}</{key}>" for key, value in values.items())


# ---------------------------------------------------------------------------------------------- Bundler, NVM


def write_bundler(folder: Path, shots: list[Shot]) -> None:
    """bundle/bundle.out and list.txt, with one camera that was not solved."""
    lines = ["# Bundle file v0.3", f"{len(shots) + 1} 1"]
    for shot in shots:
        rotation = FLIP_YZ @ shot.rotation  # the camera's Y points up and its Z backward
        lines.append(text([shot.fx, *(*shot.k, 0.0, 0.0)[:2]]))
        lines += [text(row) for row in rotation]
        lines.append(text(-rotation @ shot.centre))
    lines += ["0 0 0"] * 5 + ["0.1 0.2 0.3", "90 90 90", "1 0 12 1.5 2.5"]
    (folder / "bundle").mkdir(parents=True)
    (folder / "bundle" / "bundle.out").write_text("\n".join(lines) + "\n")
    names = [f"./{shot.name} 0 {shot.fx}" for shot in shots] + ["./lost.jpg"]
    (folder / "list.txt").write_text("\n".join(names) + "\n")
    write_photographs(folder, shots)


def write_nvm(folder: Path, groups: list[list[Shot]], distortion: float = 0.0, fixed: str = "") -> None:
    """model.nvm with several models; `distortion` undoes the lens's."""
    lines = [f"NVM_V3 {fixed}".strip(), ""]
    for shots in groups:
        lines.append(str(len(shots)))
        for shot in shots:
            numbers = text([shot.fx, *quaternion(shot.rotation), *shot.centre, distortion, 0.0])
            lines.append(f"images/{shot.name} {numbers}")
        lines += ["", "1", "0.1 0.2 0.3 90 90 90 1 0 12 1.5 2.5", ""]
    lines += ["0", "", "#the last part of the file", "0"]
    write_photographs(folder / "images", [shot for shots in groups for shot in shots])
    (folder / "model.nvm").write_text("\n".join(lines) + "\n")


# ------------------------------------------------------------------------------ Polycam, Record3D, scanners


def write_polycam(folder: Path, shots: list[Shot], alignment: np.ndarray, corrected: bool) -> None:
    """keyframes/ and mesh_info.json; `alignment` (4, 4) leads from the cameras' world to the mesh."""
    cameras, photographs = ("corrected_cameras", "corrected_images") if corrected else ("cameras", "images")
    (folder / "keyframes" / cameras).mkdir(parents=True)
    for shot in shots:
        pose = np.linalg.inv(alignment) @ shot.pose
        pose[:3, 1:3] *= -1.0  # Y up, Z backward
        data = {f"t_{row}{column}": pose[row, column] for row in range(3) for column in range(4)}
        data |= {"fx": shot.fx, "fy": shot.fy, "cx": shot.cx, "cy": shot.cy, "blur_score": 200.0}
        data |= {"width": shot.width, "height": shot.height}
        (folder / "keyframes" / cameras / f"{Path(shot.name).stem}.json").write_text(json.dumps(data))
    write_photographs(folder / "keyframes" / photographs, shots)
    stored = [float(value) for value in alignment.T.ravel()]
    (folder / "mesh_info.json").write_text(json.dumps({"alignmentTransform": stored}))
    (folder / "raw.glb").write_bytes(b"glTF")


def write_record3d(folder: Path, shots: list[Shot], each_frame: bool) -> None:
    """metadata.json and rgb/; one size for all frames."""
    poses = []
    for shot in shots:
        w, x, y, z = quaternion(shot.rotation.T @ FLIP_YZ)
        poses.append([x, y, z, w, *shot.centre])
    first = shots[0]
    data = {"w": first.width, "h": first.height, "fps": 60, "dw": 192, "dh": 256, "poses": poses}
    data["K"] = [first.fx, 0, 0, 0, first.fy, 0, first.cx, first.cy, 1]
    if each_frame:
        data["perFrameIntrinsicCoeffs"] = [[shot.fx, shot.fy, shot.cx, shot.cy] for shot in shots]
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "metadata.json").write_text(json.dumps(data))
    write_photographs(folder / "rgb", shots)


def write_scanner_app(folder: Path, shots: list[Shot]) -> None:
    """frame_*.json with ARKit's pose by rows (Y up, Z backward); a last frame has no photograph."""
    write_photographs(folder, shots)
    for shot in [*shots, replace(shots[0], name="frame_99999.jpg")]:
        pose = shot.pose @ np.diag([1.0, -1.0, -1.0, 1.0])
        matrix = [shot.fx, 0.0, shot.cx, 0.0, shot.fy, shot.cy, 0.0, 0.0, 1.0]
        data = {"cameraPoseARFrame": pose.ravel().tolist(), "intrinsics": matrix, "motionQuality": 1}
        (folder / shot.name).with_suffix(".json").write_text(json.dumps(data))
    (folder / "export.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")


def write_scannetpp(folder: Path, shots: list[Shot], held_back: int) -> None:
    """dslr/nerfstudio/transforms.json: X and Y of the world swapped and Z negated; the last frame is bad."""
    frames = []
    for shot in shots:
        pose = shot.pose
        pose[:3, 1:3] *= -1.0
        pose = pose[[1, 0, 2, 3]]
        pose[2] *= -1.0
        stem = Path(shot.name).stem
        frames.append(
            {"file_path": shot.name, "mask_path": f"{stem}.png", "transform_matrix": pose.tolist(), "is_bad": False}
        )
    frames.append({**frames[0], "file_path": "bad.JPG", "is_bad": True})
    shot = shots[0]
    data = {"fl_x": shot.fx, "fl_y": shot.fy, "cx": shot.cx, "cy": shot.cy, "w": shot.width, "h": shot.height}
    data |= {f"k{i + 1}": value for i, value in enumerate(shot.k)}
    data |= {"camera_model": "OPENCV_FISHEYE", "has_mask": True}
    data |= {"frames": frames[:held_back] + frames[-1:], "test_frames": frames[held_back:-1]}
    (folder / "dslr" / "nerfstudio").mkdir(parents=True)
    (folder / "dslr" / "nerfstudio" / "transforms.json").write_text(json.dumps(data))
    write_photographs(folder / "dslr" / "resized_images", shots)
    (folder / "dslr" / "resized_anon_masks").mkdir()
    for shot in shots:
        mask = Image.new("L", (shot.width, shot.height), 255)
        mask.save(folder / "dslr" / "resized_anon_masks" / f"{Path(shot.name).stem}.png")
    (folder / "scans").mkdir()
    header = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nelement face 1\nend_header\n"
    (folder / "scans" / "mesh_aligned_0.05.ply").write_text(header)
