"""Reader and writer of the ground truth of a capture in the FIPT authors' layout.

The folders DiffCol (kd), BaseColor, Metallic, Roughness, Emit and IndexMA (0: nothing hit) next to
SPLIT/Image have files with the photographs' names, the folder albedo (a') with their numbers only.
relight.json names views that are lit by one new light.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.metrics import Maps
from fipt_blender.core import conventions
from fipt_blender.core.capture.images import read_ids, read_radiance, write_exr
from fipt_blender.core.capture.views import Capture, View
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.errors import FiptError

COLOR_MAPS = {"kd": "DiffCol", "base_color": "BaseColor", "emission": "Emit"}
VALUE_MAPS = {"roughness": "Roughness", "metallic": "Metallic"}


@dataclass(frozen=True)
class Relight:
    """The relit views of a capture and their light, in Blender's world.

    Attributes:
        vertices: (n, 3) metres, counter-clockwise seen from the side that emits.
        triangles: (m, 3), fronts emit.
        radiance: (3,).
        views: what to render; `image` is the true relit image.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    radiance: np.ndarray
    views: list[View]


def file_names(view: View) -> tuple[str, str]:
    """Names of a view's maps, and of its albedo: "000_0001.exr", "000.exr"; the photograph may be a JPEG."""
    return f"{view.image.stem}.exr", f"{view.image.stem.removesuffix('_0001')}.exr"


def split_folder(view: View) -> Path:
    """The folder train or val that a view's photograph lies in."""
    return view.image.parent.parent


def read_maps(view: View) -> Maps:
    """True maps of one view.

    Raises:
        FiptError: ``truth-missing`` where the capture has no ground truth.
    """
    folder = split_folder(view)
    name, bare = file_names(view)
    try:
        maps = {key: read_radiance(folder / sub / name) for key, sub in COLOR_MAPS.items()}
        maps |= {key: read_radiance(folder / sub / name)[..., 0] for key, sub in VALUE_MAPS.items()}
        a_prime = read_radiance(folder / "albedo" / bare)
        material = read_ids(folder / "IndexMA" / name)
    except FiptError as error:
        raise FiptError.of(
            "truth-missing",
            f"The capture has no complete ground truth: {error.text}",
            "It needs DiffCol, BaseColor, Metallic, Roughness, Emit, albedo and IndexMA beside Image.",
        ) from None
    return Maps(a_prime=a_prime, hit=material > 0, material=material, **maps)


def maps_are_filtered(views: Sequence[Maps]) -> bool:
    """Whether true maps are averages over pixels rather than values at their centres.

    Decided by pixels at steps of roughness: an average is between the values of both sides.
    """
    between = steps = 0
    for view in views:
        values = view.roughness.astype(np.float64)
        height, width = values.shape
        around = [
            values[1 + dy : height - 1 + dy, 1 + dx : width - 1 + dx]
            for dy in (-1, 0, 1)
            for dx in (-1, 0, 1)
            if dx or dy
        ]
        low, high = np.min(around, axis=0), np.max(around, axis=0)
        margin = 0.02 * (high - low)
        here = values[1:-1, 1:-1]
        step = high - low > 0.05
        steps += int(step.sum())
        between += int((step & (here > low + margin) & (here < high - margin)).sum())
    return steps > 0 and between > 0.25 * steps


def write_maps(folder: Path, view: View, maps: Maps) -> None:
    """Write maps of one view below `folder` under the names of the ground truth."""
    name, bare = file_names(view)
    root = folder / split_folder(view).name
    for key, sub in {**COLOR_MAPS, **VALUE_MAPS}.items():
        values = getattr(maps, key)
        write_exr(root / sub / name, values if values.ndim == 3 else np.repeat(values[..., None], 3, axis=2))
    write_exr(root / "albedo" / bare, maps.a_prime)


def read_relight(folder: Path, capture: Capture) -> Relight | None:
    """relight.json of a capture folder, or None where it has none.

    Raises:
        FiptError: ``truth-missing`` where it can't be parsed.
    """
    path = folder / "relight.json"
    if not path.is_file() or not capture.held_back:
        return None
    data = read_document(path, dict)
    try:
        light = data["light"]
        vertices = conventions.transform_points(capture.world_from_source, light["vertices"])
        triangles = np.array(light["faces"], np.int64).reshape(-1, 3)
        normal = conventions.split_similarity(capture.world_from_source)[1] @ light["normal"]
        if np.cross(vertices[1] - vertices[0], vertices[2] - vertices[1]) @ normal < 0.0:
            vertices, triangles = vertices[::-1], len(vertices) - 1 - triangles
        corners = vertices[triangles]
        facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) @ normal
        triangles[facing < 0.0] = triangles[facing < 0.0][:, ::-1]
        views = []
        for entry in data["views"]:
            pose = conventions.fipt_to_opencv_camera(entry["transform_matrix"])
            views.append(
                replace(
                    capture.held_back[int(entry["val_index"])],
                    image=folder / entry["image"],
                    camera_to_world=conventions.transform_poses(capture.world_from_source, pose),
                )
            )
        radiance = np.array(light["radiance"], np.float32).reshape(3)
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise FiptError.of(
            "truth-missing", f"{path} can't be understood ({error}).", "Mend or remove it."
        ) from None
    return Relight(vertices, triangles, radiance, views)
