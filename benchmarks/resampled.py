# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A run's input with another number of views, pixels or triangles, for benchmarks/scaling.py.

Photographs are resampled to other sizes. Additional views are existing ones whose camera is rotated a little
and zoomed in until the photograph covers the frame: a rotation has no parallax, so that photographs, cameras
and mesh still agree. Meshes are subdivided, or their vertices are merged.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fipt_blender.core.capture.images import read_ids, read_radiance, write_exr
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.runfolder import RunFolder, write_json

TURN_DEGREES = 4.0
Entry = dict[str, Any]  # one view of capture.json


def write_views(source: RunFolder, target: RunFolder, count: int, height: int | None = None) -> int:
    """Write capture.json of `target` and the images that it needs; returns the number of pixels per view.

    Args:
        source: run with the photographs; held-back ones are left out.
        target: run that gets the resampled views.
        count: number of views.
        height: of each view in pixels, with the same aspect ratio; None: unchanged.

    Raises:
        FiptError: ``views-none``, or an image can't be read or written.
    """
    data = read_document(source.capture_json, dict)
    train = [entry for entry in data["views"] if entry["split"] == "train"]
    if not train:
        raise FiptError("views-none", "The capture has no training views.", "Add photographs.")
    entries = []
    for number, (first, turn) in enumerate(planned_views(train, count)):
        size = (first["width"], first["height"])
        if height is not None:
            size = (max(1, round(height * size[0] / size[1])), height)
        entry = resized(turned(first, turn), *size) | {"name": f"train/{number:04d}"}
        for kind in ("image", "parts", "semantics", "mask"):
            if first.get(kind):
                path = source.resolve(first[kind])
                ids = kind != "image"
                image = warped(read_ids(path) if ids else read_radiance(path), first, entry, ids)
                entry[kind] = f"images/{kind}/{number:04d}.exr"
                write_exr(target.root / entry[kind], image)
        entries.append(entry)
    write_json(target.capture_json, {**data, "views": entries})
    return int(entries[0]["width"] * entries[0]["height"])


def planned_views(views: Sequence[Entry], count: int) -> list[tuple[Entry, np.ndarray]]:
    """`count` views, each with a (3, 3) rotation: a subset of the given views, or repetitions of them."""
    if count <= len(views):
        return [(views[i * len(views) // count], np.eye(3)) for i in range(count)]
    rng = np.random.default_rng(0)
    plan = []
    for i in range(count):
        axis = rng.normal(size=3)
        repetition = i // len(views)
        angle = np.radians(TURN_DEGREES) * rng.uniform(0.25, 1.0) if repetition else 0.0
        plan.append((views[i % len(views)], rotation(axis, angle)))
    return plan


def rotation(axis: np.ndarray, angle: float) -> np.ndarray:
    """(3, 3) rotation about an axis by an angle in radians (Rodrigues)."""
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


def resized(entry: Entry, width: int, height: int) -> Entry:
    """The same view with another resolution."""
    x, y = width / entry["width"], height / entry["height"]
    scaled = {"fx": entry["fx"] * x, "cx": entry["cx"] * x, "fy": entry["fy"] * y, "cy": entry["cy"] * y}
    return {**entry, **scaled, "width": width, "height": height}


def turned(entry: Entry, turn: np.ndarray) -> Entry:
    """The view rotated by `turn` (3, 3) in camera axes, zoomed in until its frame is inside the original."""
    pose = np.array(entry["camera_to_world"], np.float64)
    pose[:3, :3] = pose[:3, :3] @ turn
    result = {**entry, "camera_to_world": pose.tolist()}
    width, height = entry["width"], entry["height"]
    corners = np.array([[0, 0], [width, 0], [0, height], [width, height]], np.float64)
    while True:
        x, y = source_pixels(entry, result, corners).T
        if min(x.min(), y.min()) >= -1e-6 and x.max() <= width + 1e-6 and y.max() <= height + 1e-6:
            return result
        result["fx"], result["fy"] = result["fx"] * 1.02, result["fy"] * 1.02


def source_pixels(source: Entry, target: Entry, pixels: np.ndarray) -> np.ndarray:
    """(N, 2) pixel positions in `source` of what `target`, at the same position, sees at `pixels` (N, 2)."""
    local = (pixels - [target["cx"], target["cy"]]) / [target["fx"], target["fy"]]
    local = np.concatenate([local, np.ones((len(local), 1))], axis=1)
    axes = [np.array(entry["camera_to_world"], np.float64)[:3, :3] for entry in (target, source)]
    direction = local @ axes[0].T @ axes[1]
    return direction[:, :2] / direction[:, 2:] * [source["fx"], source["fy"]] + [source["cx"], source["cy"]]


def warped(image: np.ndarray, source: Entry, target: Entry, ids: bool) -> np.ndarray:
    """The image (H, W, ...) of `target`: means over its pixels, or for ids the values at their centres."""
    width, height = target["width"], target["height"]
    side = 1 if ids else max(1, round(2.0 * source["fx"] / target["fx"]))
    steps = (np.arange(side) + 0.5) / side
    y, x = np.mgrid[:height, :width]
    base = np.stack([x.ravel(), y.ravel()], axis=1).astype(np.float64)
    total: np.ndarray | float = 0.0
    for shift_y in steps:
        for shift_x in steps:
            total = total + _look_up(image, source_pixels(source, target, base + [shift_x, shift_y]), ids)
    mean = np.asarray(total) / side**2
    return mean.reshape(height, width, *image.shape[2:]).astype(image.dtype)


def _look_up(image: np.ndarray, position: np.ndarray, nearest: bool) -> np.ndarray:
    """Values at (N, 2) positions in pixels (centres at +0.5), clamped to the image."""
    high = np.array([image.shape[1], image.shape[0]]) - 1
    if nearest:
        x, y = np.clip(np.floor(position).astype(np.int64), 0, high).T
        return image[y, x]
    inside = np.clip(position - 0.5, 0.0, high)
    low = np.minimum(inside.astype(np.int64), np.maximum(high - 1, 0))
    weight = inside - low
    result: np.ndarray | float = 0.0
    for corner in (np.array([0, 0]), np.array([1, 0]), np.array([0, 1]), np.array([1, 1])):
        x, y = np.minimum(low + corner, high).T
        share = np.where(corner, weight, 1.0 - weight).prod(axis=1)
        result = result + image[y, x] * share.reshape(-1, *[1] * (image.ndim - 2))
    return np.asarray(result)


def write_room(source: RunFolder, target: RunFolder, count: int) -> int:
    """Write room.npz of `target` with about `count` triangles; returns how many there are."""
    with np.load(source.room_npz, allow_pickle=False) as data:
        arrays = {name: data[name] for name in data.files}
    arrays = with_triangles(arrays, count)
    np.savez(target.room_npz, **arrays)
    return len(arrays["triangles"])


def with_triangles(arrays: Mapping[str, np.ndarray], count: int) -> dict[str, np.ndarray]:
    """The arrays of room.npz with about `count` triangles."""
    if count < len(arrays["triangles"]):
        return merged_vertices(arrays, count)
    result = dict(arrays)
    while len(result["triangles"]) < count:
        result = split_largest(result, -(-(count - len(result["triangles"])) // 3))
    return result


def split_largest(arrays: Mapping[str, np.ndarray], count: int) -> dict[str, np.ndarray]:
    """Split the `count` largest triangles, or all, into four each; the surface stays the same."""
    vertices, triangles = arrays["vertices"], arrays["triangles"]
    corners = vertices[triangles].astype(np.float64)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    count = min(count, len(triangles))
    chosen = np.sort(np.argpartition(-area, count - 1)[:count])
    rest = np.delete(np.arange(len(triangles)), chosen)
    result = {
        name: np.concatenate([values[rest], np.repeat(values[chosen], 4, axis=0)])
        for name, values in arrays.items()
        if name.startswith("triangle_")
    }
    middles = 0.5 * (corners[chosen] + np.roll(corners[chosen], -1, axis=1))
    new = len(vertices) + np.arange(3 * count).reshape(-1, 3)
    result["vertices"] = np.concatenate([vertices, middles.reshape(-1, 3).astype(np.float32)])
    (a, b, c), (ab, bc, ca) = triangles[chosen].T, new.T
    faces = np.stack([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]], axis=0).transpose(2, 0, 1)
    result["triangles"] = np.concatenate([triangles[rest], faces.reshape(-1, 3)]).astype(np.int32)
    normals = arrays["corner_normals"][chosen].astype(np.float64)
    between = normals + np.roll(normals, -1, axis=1)
    length = np.linalg.norm(between, axis=2, keepdims=True)
    between = np.where(length > 1e-6, between / np.maximum(length, 1e-6), normals)
    (n_a, n_b, n_c), (n_ab, n_bc, n_ca) = (each.transpose(1, 0, 2) for each in (normals, between))
    parts = [[n_a, n_ab, n_ca], [n_ab, n_b, n_bc], [n_ca, n_bc, n_c], [n_ab, n_bc, n_ca]]
    smooth = np.array(parts).transpose(2, 0, 1, 3).reshape(-1, 3, 3).astype(np.float32)
    result["corner_normals"] = np.concatenate([arrays["corner_normals"][rest], smooth])
    return result


def merged_vertices(arrays: Mapping[str, np.ndarray], count: int) -> dict[str, np.ndarray]:
    """Merge the vertices of each cell of a grid into their mean; cells as small as `count` allows."""
    vertices, triangles = arrays["vertices"].astype(np.float64), arrays["triangles"]
    low = vertices.min(axis=0)
    extent = float((vertices.max(axis=0) - low).max())

    def merge(size: float) -> tuple[np.ndarray, np.ndarray]:
        cells = np.floor((vertices - low) / size).astype(np.int64)
        _, label = np.unique(cells, axis=0, return_inverse=True)
        label = label.reshape(-1)
        a, b, c = label[triangles].T
        return label, np.flatnonzero((a != b) & (b != c) & (c != a))

    small, large = 1e-5 * extent, extent
    for _ in range(24):
        size = np.sqrt(small * large)
        if len(merge(size)[1]) > count:
            small = size
        else:
            large = size
    label, kept = merge(large)
    if not len(kept):  # a single cell would leave nothing
        label, kept = merge(small)
    number = np.bincount(label)
    mean = np.stack([np.bincount(label, column) for column in vertices.T], axis=1) / number[:, None]
    result = {name: values[kept] for name, values in arrays.items() if name != "vertices"}
    return result | {
        "vertices": mean.astype(np.float32),
        "triangles": label[triangles[kept]].astype(np.int32),
    }
