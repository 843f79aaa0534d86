# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Engine command `textures`: the estimated fields sampled at every texel of the atlas.

Each texel's centre is a point on the room; the fields are queried there, and the space between islands is
padded.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from ..capture.views import load_capture
from ..device.variant import set_variant
from ..job.errors import FiptError
from ..job.messages import Reporter
from ..job.runfolder import RunFolder, atomic_path, read_json, write_json
from .padding import pad
from .raster import nearest_triangle_map

QUERY_POINTS = 1 << 18
PAD_TEXELS = 8
MAPS = ("base_color", "roughness", "metallic", "confidence")


class FieldSource(Protocol):
    """What baking asks of the estimate; `core.material.fields.RoomFields` is one."""

    def query(
        self, positions: np.ndarray, triangles: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]: ...
    def confidence(self, positions: np.ndarray, triangles: np.ndarray) -> np.ndarray: ...


@dataclass
class Samples:
    """The fields at points of the room."""

    base_color: np.ndarray  # (N,3)
    roughness: np.ndarray  # (N,)
    metallic: np.ndarray  # (N,)
    confidence: np.ndarray  # (N,3) of the others, 0 where no photograph saw the point


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument("run", type=Path, help="run folder with estimated fields and an atlas")


def run(arguments: argparse.Namespace, reporter: Reporter) -> None:
    """Bake the textures of a run, and the maps of a few of its views.

    Raises:
        FiptError: ``file-missing`` or ``file-damaged`` where an earlier step did not finish.
    """
    folder = RunFolder(arguments.run)
    set_variant(folder.read().device)
    # These import Mitsuba, which finds an LLVM of its own where the variant was not chosen before.
    from ..material.fields import RoomFields
    from .view_maps import write_view_maps

    fields = RoomFields.load(folder)
    reporter.plan([1.0])
    reporter.stage("textures", "Baking textures")
    files = bake(folder, fields, reporter.progress)
    files += write_view_maps(folder, fields, load_capture(folder).views)
    reporter.done([str(path) for path in files])


def bake(
    folder: RunFolder,
    fields: FieldSource,
    progress: Callable[[float], None] = lambda fraction: None,
) -> list[Path]:
    """Write textures/ and textures.json, or corner_fields.npz in colour-attribute mode.

    Args:
        folder: with room and atlas.
        fields: what to bake.
        progress: called with 0 to 1.

    Returns:
        The files written.
    """
    atlas = read_json(folder.atlas_json)
    arrays = _load(folder.atlas_npz, ("corner_uv", "triangle_image"))
    room = _load(folder.room_npz, ("vertices", "triangles"))
    corners = room["vertices"][room["triangles"]]
    if atlas["mode"] == "color_attribute":
        return [_bake_corners(folder, fields, corners, progress)]
    entries = atlas["images"]
    listed: list[dict[str, str]] = []
    # One image is padded and written while the next is sampled: never more than two in memory.
    with ThreadPoolExecutor(1) as writer:
        writing: Future[dict[str, str]] | None = None
        for index, entry in enumerate(entries):
            texel, samples = _sample_image(fields, entry, index, arrays, corners)
            if writing is not None:
                listed.append(writing.result())
            writing = writer.submit(_write_image, folder, entry, texel, samples)
            progress((index + 1) / (len(entries) + 1))
        if writing is not None:
            listed.append(writing.result())
    progress(1.0)
    write_json(folder.textures_json, {"images": listed})
    written = [folder.root / each[name] for each in listed for name in MAPS]
    return [*written, folder.textures_json]


def _sample_image(
    fields: FieldSource, entry: dict, index: int, arrays: dict[str, np.ndarray], corners: np.ndarray
) -> tuple[np.ndarray, Samples]:
    """Flat indices (M,) of the texels that triangles of image number `index` cover, and the fields there.

    Args:
        entry: of the image in atlas.json.
        arrays: of atlas.npz. corners: (T,3,3) f32 world.
    """
    mine = np.flatnonzero(arrays["triangle_image"] == index)
    width, height = int(entry["width"]), int(entry["height"])
    uv = arrays["corner_uv"][mine] * np.array([width, height], np.float64)
    texel, triangle, weights = nearest_triangle_map(uv, width, height)
    positions = np.einsum("nk,nkc->nc", weights, corners[mine[triangle]]).astype(np.float32)
    return texel, sample_fields(fields, positions, mine[triangle])


def sample_fields(fields: FieldSource, positions: np.ndarray, triangles: np.ndarray) -> Samples:
    """Query the fields in chunks; values are clipped to what a texture may hold.

    Args:
        fields: the estimate.
        positions: (N,3) f32 world.
        triangles: (N,) int, on which they lie.
    """
    count = len(positions)
    result = Samples(
        np.zeros((count, 3), np.float32),
        np.zeros(count, np.float32),
        np.zeros(count, np.float32),
        np.zeros((count, 3), np.float32),
    )
    for first in range(0, count, QUERY_POINTS):
        chunk = slice(first, first + QUERY_POINTS)
        base_color, roughness, metallic = fields.query(positions[chunk], triangles[chunk])
        result.base_color[chunk] = np.clip(base_color, 0.0, 1.0)
        result.roughness[chunk] = np.clip(np.reshape(roughness, -1), 0.0, 1.0)
        result.metallic[chunk] = np.clip(np.reshape(metallic, -1), 0.0, 1.0)
        result.confidence[chunk] = fields.confidence(positions[chunk], triangles[chunk])
    return result


def _load(path: Path, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    try:
        with np.load(path, allow_pickle=False) as data:
            return {name: data[name] for name in names}
    except FileNotFoundError:
        raise FiptError("file-missing", f"{path} does not exist.", "Run the step that writes it.") from None
    except (OSError, KeyError, ValueError) as error:
        raise FiptError("file-damaged", f"{path} can't be read ({error}).", "Write it again.") from None


def _write_image(folder: RunFolder, entry: dict, texel: np.ndarray, samples: Samples) -> dict[str, str]:
    """Write the maps of one image; returns its entry in textures.json."""
    from ..capture.images import write_exr

    width, height = int(entry["width"]), int(entry["height"])
    filled = np.zeros(width * height, bool)
    filled[texel] = True
    image = np.zeros((width * height, 8), np.float32)
    image[texel] = np.column_stack(
        [samples.base_color, samples.roughness, samples.metallic, samples.confidence]
    )
    # Row 0 is v = 0 here and the top in files.
    padded = pad(image.reshape(height, width, 8), filled.reshape(height, width), PAD_TEXELS)[::-1]
    planes = padded[..., :3], padded[..., 3], padded[..., 4], padded[..., 5:]
    listed = {"name": str(entry["name"])}
    for name, plane in zip(MAPS, planes, strict=True):
        listed[name] = f"textures/{entry['name']}.{name}.exr"
        write_exr(folder.root / listed[name], plane, half=True)
    return listed


def _bake_corners(
    folder: RunFolder,
    fields: FieldSource,
    corners: np.ndarray,
    progress: Callable[[float], None],
) -> Path:
    count = len(corners)
    # A thousandth inwards: at a corner itself the neighbouring surface could answer.
    inwards = corners + 1e-3 * (corners.mean(axis=1, keepdims=True) - corners)
    positions = inwards.reshape(-1, 3).astype(np.float32)
    samples = sample_fields(fields, positions, np.repeat(np.arange(count), 3))
    path = folder.textures / "corner_fields.npz"
    with atomic_path(path) as temporary:
        np.savez(
            temporary,
            base_color=samples.base_color.reshape(count, 3, 3),
            roughness=samples.roughness.reshape(count, 3),
            metallic=samples.metallic.reshape(count, 3),
            confidence=samples.confidence.reshape(count, 3, 3),
        )
    progress(1.0)
    return path
