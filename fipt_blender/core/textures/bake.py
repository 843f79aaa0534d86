# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Engine command `textures`: sample the estimate at every texel of the atlas, and add photographs' detail.

The estimate is queried at the surface point of each texel's centre; the texels between UV islands are padded.
Where photographs have more pixels than light was solved at, base colour gets their detail (:mod:`.detail`).
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np

from ..capture.views import load_capture
from ..device.variant import set_variant
from ..run.arrays import write_arrays
from ..run.documents import read_document
from ..run.messages import Reporter
from ..run.parts import RoomParts, read_parts
from ..run.replacing import atomic_folder
from ..run.result_contents import AtlasImage, AtlasImages, TextureImage, Textures, UniformPart
from ..run.run_files import read_atlas, read_room_files
from ..run.runfolder import RunFolder, write_json
from ..run.shapes import CORNER_FIELDS_ARRAYS
from ..surface.stored import stored_geometry
from .padding import pad
from .raster import nearest_triangle_map

if TYPE_CHECKING:
    from .detail import DetailInput

QUERY_POINTS = 1 << 18  # points per query
MAPS = ("base_color", "roughness", "metallic", "confidence")
# A part whose texels differ by less has one value: half a step of 8-bit textures.
ONE_VALUE = 0.002


class FieldSource(Protocol):
    """What baking needs of an estimate; `core.material.fields.RoomFields` implements it."""

    def query(
        self, positions: np.ndarray, triangles: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]: ...
    def confidence(self, positions: np.ndarray, triangles: np.ndarray) -> np.ndarray: ...


@dataclass
class Samples:
    """The estimate at surface points; float32."""

    base_color: np.ndarray  # (N,3)
    roughness: np.ndarray  # (N,)
    metallic: np.ndarray  # (N,)
    confidence: np.ndarray  # (N,3) of the three above, 0 where no photograph saw the point


class PartRanges:
    """The values that the texels of each part have: of a part of one value, a material needs no textures.

    Args:
        parts: of the room; None where they do not matter.
    """

    def __init__(self, parts: RoomParts | None) -> None:
        self._parts = parts
        count = 0 if parts is None else len(parts.parts)
        self._low, self._high = np.full((count, 5), np.inf), np.full((count, 5), -np.inf)

    def add(self, samples: Samples, triangles: np.ndarray) -> None:
        """Texels on triangles (N,)."""
        if self._parts is None or not len(triangles):
            return
        values = np.column_stack([samples.base_color, samples.roughness, samples.metallic])
        part = self._parts.triangle[triangles]
        order = np.argsort(part, kind="stable")
        values, part = values[order], part[order]
        first = np.flatnonzero(np.concatenate([[True], part[1:] != part[:-1]]))
        of = part[first]
        self._low[of] = np.minimum(self._low[of], np.minimum.reduceat(values, first))
        self._high[of] = np.maximum(self._high[of], np.maximum.reduceat(values, first))

    def uniform(self) -> tuple[UniformPart, ...]:
        """The parts of one value."""
        if self._parts is None:
            return ()
        of_one = (self._high - self._low <= ONE_VALUE).all(axis=1) & (self._low[:, 0] < np.inf)
        middle = (0.5 * (self._low + self._high)).tolist()
        return tuple(
            UniformPart(part.key, (red, green, blue), roughness, metallic)
            for part, is_one, (red, green, blue, roughness, metallic) in zip(
                self._parts.parts, of_one, middle, strict=True
            )
            if is_one
        )


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument("run", type=Path, help="run folder with an estimate and an atlas")


def run(arguments: argparse.Namespace, reporter: Reporter) -> None:
    """Bake the textures of a run, and maps of a few of its views.

    Raises:
        FiptError: ``file-missing`` or ``file-damaged`` if an earlier step has not finished; ``disk-full`` or
            ``run-unwritable``.
    """
    folder = RunFolder(arguments.run)
    set_variant(folder.read().device)
    # Imported here because these modules import Mitsuba, for which the variant must be chosen first.
    from ..material.fields import RoomFields
    from .detail import load_input
    from .view_maps import write_view_maps

    fields = RoomFields.load(folder)
    reporter.plan([1.0])
    reporter.stage("textures", "Baking textures")
    given = load_input(folder, reporter)
    room, names = read_room_files(folder)
    ranges = PartRanges(read_parts(folder, room["triangle_object"], names.objects))
    if given is not None and read_document(folder.atlas_json, AtlasImages).mode != "color_attribute":
        files = bake_with_detail(folder, fields, given, fields.units.triangle, ranges, reporter.progress)
    else:
        files = bake(folder, fields, reporter.progress, ranges)
    files += write_view_maps(folder, fields, load_capture(folder).views)
    reporter.done([str(path) for path in files])


def bake(
    folder: RunFolder,
    fields: FieldSource,
    progress: Callable[[float], None] = lambda fraction: None,
    ranges: PartRanges | None = None,
) -> list[Path]:
    """Replace textures/: textures.json and its images, or corner_fields.npz in colour-attribute mode.

    Args:
        folder: the run, with room and atlas.
        fields: the estimate.
        progress: called with the share that is done.
        ranges: of the room's parts, by which textures.json says which have one value.

    Returns:
        The files written.
    """
    room, _ = read_room_files(folder)
    atlas, arrays = read_atlas(folder, len(room["triangles"]))
    scan = stored_geometry(folder, room)
    corners = (scan.vertices if scan else room["vertices"])[room["triangles"]]
    with atomic_folder(folder.textures) as new:
        if atlas.mode == "color_attribute":
            names = [_bake_corners(new, fields, corners)]
        else:
            ranges = ranges or PartRanges(None)
            names = _bake_images(new, fields, atlas.images, arrays, corners, progress, ranges)
    progress(1.0)
    return [folder.textures / name for name in names]


def _bake_images(
    folder: Path,
    fields: FieldSource,
    entries: Sequence[AtlasImage],
    arrays: dict[str, np.ndarray],
    corners: np.ndarray,
    progress: Callable[[float], None],
    ranges: PartRanges,
) -> list[str]:
    """Write the maps of all images of the atlas, and textures.json; returns the names of the files.

    Args:
        folder: for the files.
        fields: the estimate.
        entries: the images in atlas.json.
        arrays: content of atlas.npz.
        corners: (T,3,3) f32 world.
        progress: called with the share that is done.
        ranges: to which the texels are added.
    """
    listed: list[TextureImage] = []
    # One image is padded and written, and the surface of the next one found, while an image is sampled.
    with ThreadPoolExecutor(1) as writer, ThreadPoolExecutor(1) as finder:
        writing: Future[TextureImage] | None = None
        finding = [finder.submit(_surface_points, entry, 0, arrays, corners) for entry in entries[:1]]
        for index, entry in enumerate(entries):
            texel, positions, triangles = finding.pop().result()
            if index + 1 < len(entries):
                following = entries[index + 1]
                finding.append(finder.submit(_surface_points, following, index + 1, arrays, corners))
            samples = sample_fields(fields, positions, triangles)
            ranges.add(samples, triangles)
            if writing is not None:
                listed.append(writing.result())
            writing = writer.submit(_write_image, folder, entry, texel, samples)
            progress((index + 1) / (len(entries) + 1))
        if writing is not None:
            listed.append(writing.result())
    return _list_images(folder, listed, ranges)


def _list_images(folder: Path, listed: list[TextureImage], ranges: PartRanges) -> list[str]:
    """Write textures.json with the images that :func:`_write_image` has written; returns all files' names."""
    write_json(folder / "textures.json", Textures(tuple(listed), ranges.uniform()))
    return [*(Path(getattr(image, name)).name for image in listed for name in MAPS), "textures.json"]


def bake_with_detail(
    folder: RunFolder,
    fields: FieldSource,
    given: DetailInput,
    part: np.ndarray,
    ranges: PartRanges,
    progress: Callable[[float], None] = lambda fraction: None,
) -> list[Path]:
    """Like :func:`bake`, with the photographs' detail in base colour; not in colour-attribute mode.

    Args:
        given: views, photographs and shadings.
        part: (T,) int part of each triangle, -1 without one.
        ranges: of the room's parts.
        progress: called with the share that is done.
    """
    from ..surface.room import load_room
    from .detail import add_detail, stored_texels

    room = load_room(folder)
    atlas, arrays = read_atlas(folder, len(room.triangles))
    corners = room.vertices[room.triangles]
    entries = atlas.images
    sizes = [np.array([entry.width, entry.height], np.int64) for entry in entries]
    listed: list[TextureImage] = []
    with stored_texels(folder, int(sum(size.prod() for size in sizes))) as store:
        ends, places = [0], []
        for index, entry in enumerate(entries):
            texel, positions, triangles = _surface_points(entry, index, arrays, corners)
            # Texels beside each other stay together, so that views skip what they can't see.
            order = np.argsort(_tile(texel, entry.width), kind="stable")
            places.append(texel[order].astype(np.int32))
            rows = slice(ends[-1], ends[-1] + len(order))
            positions, triangles = positions[order], triangles[order]
            samples = sample_fields(fields, positions, triangles)
            store.position[rows], store.triangle[rows] = positions, triangles
            store.size[rows] = _texel_sizes(arrays["corner_uv"] * sizes[index], corners)[triangles]
            for item in dataclasses.fields(samples):
                getattr(store, item.name)[rows] = getattr(samples, item.name)
            ends.append(rows.stop)
            progress(0.5 * (index + 1) / len(entries))
        texels = store.first(ends[-1])
        color = add_detail(texels, given, room, part, lambda share: progress(0.5 + 0.4 * share))
        with atomic_folder(folder.textures) as new:
            for index, entry in enumerate(entries):
                rows = slice(ends[index], ends[index + 1])
                samples = Samples(
                    color[rows], texels.roughness[rows], texels.metallic[rows], texels.confidence[rows]
                )
                ranges.add(samples, np.asarray(texels.triangle[rows]))
                listed.append(_write_image(new, entry, places[index], samples))
                progress(0.9 + 0.1 * (index + 1) / len(entries))
            names = _list_images(new, listed, ranges)
    return [folder.textures / name for name in names]


def _tile(texel: np.ndarray, width: int) -> np.ndarray:
    """Number of the square of 64 x 64 texels in which a texel (flat index) lies."""
    row, column = np.divmod(texel, width)
    return (row // 64) * (width // 64 + 1) + column // 64


def _texel_sizes(uv: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """(T,) width of a texel on each triangle, metres; uv (T,3,2) in texels, corners (T,3,3)."""
    across, along = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    flat = np.abs(across[:, 0] * along[:, 1] - across[:, 1] * along[:, 0])
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return np.sqrt(area / np.maximum(flat, 1e-12)).astype(np.float32)


def _surface_points(
    entry: AtlasImage, index: int, arrays: dict[str, np.ndarray], corners: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The surface in an image of the atlas.

    Args:
        entry: the image's entry in atlas.json.
        index: of the image.
        arrays: content of atlas.npz.
        corners: (T,3,3) f32 world.

    Returns:
        Flat indices (M,) of the texels that its triangles cover, and the surface point (M,3) f32 and the
        triangle (M,) of each.
    """
    of_image = np.flatnonzero(arrays["triangle_image"] == index)
    width, height = entry.width, entry.height
    uv = arrays["corner_uv"][of_image] * np.array([width, height], np.float64)
    texel, triangle, weights = nearest_triangle_map(uv, width, height)
    positions = np.einsum("nk,nkc->nc", weights, corners[of_image[triangle]]).astype(np.float32)
    return texel, positions, of_image[triangle]


def sample_fields(fields: FieldSource, positions: np.ndarray, triangles: np.ndarray) -> Samples:
    """Query the estimate in chunks; values are clipped to [0, 1].

    Args:
        fields: the estimate.
        positions: (N,3) f32 world.
        triangles: (N,) int triangle of each position.
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


def _write_image(folder: Path, entry: AtlasImage, texel: np.ndarray, samples: Samples) -> TextureImage:
    """Pad and write the maps of one image; returns the names of their files."""
    from ..capture.images import write_exr

    width, height = entry.width, entry.height
    filled = np.zeros(width * height, bool)
    filled[texel] = True
    image = np.zeros((width * height, 8), np.float32)
    image[texel] = np.column_stack(
        [samples.base_color, samples.roughness, samples.metallic, samples.confidence]
    )
    # Row 0 is v = 0 here, but the top row in image files. Islands grow by 8 texels.
    padded = pad(image.reshape(height, width, 8), filled.reshape(height, width), 8)[::-1]
    planes = padded[..., :3], padded[..., 3], padded[..., 4], padded[..., 5:]
    files = {name: f"{entry.name}.{name}.exr" for name in MAPS}
    for file, plane in zip(files.values(), planes, strict=True):
        write_exr(folder / file, plane, half=True)
    return TextureImage(entry.name, **{name: f"textures/{file}" for name, file in files.items()})


def _bake_corners(folder: Path, fields: FieldSource, corners: np.ndarray) -> str:
    """Write the maps at the corners (T,3,3) of all triangles; returns the file's name."""
    count = len(corners)
    # Sampled a thousandth inwards: a corner itself may lie on the neighbouring surface too.
    inwards = corners + 1e-3 * (corners.mean(axis=1, keepdims=True) - corners)
    positions = inwards.reshape(-1, 3).astype(np.float32)
    samples = sample_fields(fields, positions, np.repeat(np.arange(count), 3))
    path = folder / "corner_fields.npz"
    write_arrays(
        path,
        CORNER_FIELDS_ARRAYS,
        base_color=samples.base_color.reshape(count, 3, 3),
        roughness=samples.roughness.reshape(count, 3),
        metallic=samples.metallic.reshape(count, 3),
        confidence=samples.confidence.reshape(count, 3, 3),
    )
    return path.name
