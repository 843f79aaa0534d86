"""Engine command `textures`: sample the estimate at every texel of the atlas, and add photographs' detail.

The estimate is queried at the surface point of each texel's centre; the texels between UV islands are padded.
Where photographs have more pixels than light was solved at, base colour gets their detail (:mod:`.detail`).
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.ndimage import distance_transform_edt

from ..capture.views import load_capture
from ..device.variant import set_variant
from ..run.documents import read_document
from ..run.made import Made, content_digest
from ..run.messages import Reporter
from ..run.parts import RoomParts, read_parts
from ..run.replacing import atomic_folder
from ..run.result_contents import AtlasImage, AtlasImages, TextureImage, Textures, UniformPart
from ..run.run_files import AtlasArrays, CornerFields, read_room
from ..run.runfolder import RunFolder, write_json
from ..run.store import read_arrays, write_arrays
from ..run.versions import results_id
from .raster import nearest_triangle_map
from .texels import FieldSource, Texels, sample_fields

MAPS = ("base_color", "roughness", "metallic", "confidence")
# A part whose texels differ by less has one value: half a step of 8-bit textures.
ONE_VALUE = 0.002
# Texels and a function that is told the share that is done, to their (N, 3) base colour with more detail.
Detail = Callable[[Texels, Callable[[float], None]], np.ndarray]


def uniform_parts(parts: RoomParts, images: Iterable[Texels]) -> tuple[UniformPart, ...]:
    """The parts whose texels all have one value: their material needs no textures."""
    low = np.full((len(parts.parts), 5), np.inf)
    high = -low
    for texels in images:
        values = np.column_stack([texels.base_color, texels.roughness, texels.metallic])
        part = parts.triangle[texels.triangle]
        order = np.argsort(part, kind="stable")
        of, first = np.unique(part[order], return_index=True)
        if len(of):
            low[of] = np.minimum(low[of], np.minimum.reduceat(values[order], first))
            high[of] = np.maximum(high[of], np.maximum.reduceat(values[order], first))
    found = []
    for index in np.flatnonzero((high - low <= ONE_VALUE).all(axis=1) & (low[:, 0] < np.inf)):
        red, green, blue, roughness, metallic = (0.5 * (low[index] + high[index])).tolist()
        found.append(UniformPart(parts.parts[index].key, (red, green, blue), roughness, metallic))
    return tuple(found)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument("run", type=Path, help="run folder with an estimate and an atlas")


def run(arguments: argparse.Namespace, reporter: Reporter) -> None:
    """Bake the textures of a run, and maps of a few of its views, unless they are those of the estimate."""
    folder = RunFolder(arguments.run)
    made = textures_made(folder)
    if made.told_again(reporter):
        reporter.done([])
        return
    set_variant(folder.read().device)
    # Imported here because these modules import Mitsuba, for which the variant must be chosen first.
    from ..material.fields import RoomFields
    from ..surface.room import load_room
    from .detail import add_detail, load_input
    from .view_maps import write_view_maps

    fields = RoomFields.load(folder)
    reporter.plan([1.0])
    reporter.stage("textures", "Baking textures")
    given, detail = load_input(folder, reporter), None
    if given is not None:
        detail = partial(add_detail, given, load_room(folder), fields.units.triangle)
    room = read_room(folder)
    parts = read_parts(folder, room.triangle_object, room.objects)
    with made.making(reporter.warnings):
        files = bake(folder, fields, reporter.progress, parts, detail)
        files += write_view_maps(folder, fields, load_capture(folder).views)
    reporter.done([str(path) for path in files])


def textures_made(folder: RunFolder) -> Made:
    """Whether the textures of a run are those of its estimate and its atlas."""
    atlas = content_digest(folder.atlas_json, folder.atlas_npz)
    return Made(
        folder, "textures", results_id(folder), atlas, folder.read().detail, outputs=[folder.textures]
    )


def bake(
    folder: RunFolder,
    fields: FieldSource,
    progress: Callable[[float], None] = lambda fraction: None,
    parts: RoomParts | None = None,
    detail: Detail | None = None,
) -> list[Path]:
    """Replace textures/: textures.json and its images, or corner_fields.npz in colour-attribute mode.

    Args:
        folder: the run, with room and atlas.
        fields: the estimate.
        progress: called with the share that is done.
        parts: of the room, of which textures.json says which have one value.
        detail: of the photographs, which images get.

    Returns:
        The files written.
    """
    room = read_room(folder)
    atlas, arrays = read_document(folder.atlas_json, AtlasImages), read_arrays(folder.atlas_npz, AtlasArrays)
    corners = (room.scan or room).vertices[room.triangles]
    folder.stage.mkdir(parents=True, exist_ok=True)
    with (
        atomic_folder(folder.textures) as new,
        TemporaryDirectory(dir=folder.stage, prefix="texels-", ignore_cleanup_errors=True) as scratch,
    ):
        if atlas.mode == "color_attribute":
            names = [_bake_corners(new, fields, corners)]
        else:
            surface = _sampled(Path(scratch), fields, atlas.images, arrays, corners, progress)
            names = _write_images(new, atlas.images, *surface, progress, parts, detail)
    progress(1.0)
    return [folder.textures / name for name in names]


def _sampled(
    folder: Path,
    fields: FieldSource,
    entries: Sequence[AtlasImage],
    arrays: AtlasArrays,
    corners: np.ndarray,
    progress: Callable[[float], None],
) -> tuple[list[Texels], list[np.ndarray], Texels]:
    """The estimate at the texels of all images.

    Args:
        folder: for arrays. entries: the images in atlas.json. arrays: content of atlas.npz.
        corners: (T, 3, 3) float32 world.

    Returns:
        The texels of each image, their flat indices in it, and the texels of all images, on the same memory.
    """
    store = Texels.create(sum(entry.width * entry.height for entry in entries), folder)
    first, of_images, places = 0, [], []
    for index, entry in enumerate(entries):
        texel, positions, triangles = _surface_points(entry, index, arrays, corners)
        # Texels beside each other stay together, so that views skip what they can't see.
        order = np.argsort(_tile(texel, entry.width), kind="stable")
        texels = store.rows(slice(first, first + len(order)))
        texels.position[:], texels.triangle[:] = positions[order], triangles[order]
        size = np.array([entry.width, entry.height], np.int64)
        texels.size[:] = _texel_sizes(arrays.corner_uv * size, corners)[triangles[order]]
        sample_fields(fields, texels)
        of_images.append(texels)
        places.append(texel[order].astype(np.int32))
        first += len(order)
        progress(0.5 * (index + 1) / len(entries))
    return of_images, places, store.rows(slice(first))


def _write_images(
    folder: Path,
    entries: Sequence[AtlasImage],
    of_images: Sequence[Texels],
    places: Sequence[np.ndarray],
    every: Texels,
    progress: Callable[[float], None],
    parts: RoomParts | None,
    detail: Detail | None,
) -> list[str]:
    """Write the maps of all images and textures.json; returns the names of the files.

    Args:
        of_images, places, every: what :func:`_sampled` returned; others as of :func:`bake`.
    """
    color = every.base_color
    if detail is not None:
        color = detail(every, lambda share: progress(0.5 + 0.4 * share))
    baked, listed, first = [], [], 0
    for index, (entry, texels, place) in enumerate(zip(entries, of_images, places, strict=True)):
        baked.append(dataclasses.replace(texels, base_color=color[first : first + len(texels)]))
        first += len(texels)
        listed.append(_write_image(folder, entry, place, baked[-1]))
        progress(0.9 + 0.1 * (index + 1) / len(entries))
    uniform = uniform_parts(parts, baked) if parts else ()
    write_json(folder / "textures.json", Textures(tuple(listed), uniform))
    return [*(Path(getattr(image, name)).name for image in listed for name in MAPS), "textures.json"]


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
    entry: AtlasImage, index: int, arrays: AtlasArrays, corners: np.ndarray
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
    of_image = np.flatnonzero(arrays.triangle_image == index)
    width, height = entry.width, entry.height
    uv = arrays.corner_uv[of_image] * np.array([width, height], np.float64)
    texel, triangle, weights = nearest_triangle_map(uv, width, height)
    positions = np.einsum("nk,nkc->nc", weights, corners[of_image[triangle]]).astype(np.float32)
    return texel, positions, of_image[triangle]


def _write_image(folder: Path, entry: AtlasImage, texel: np.ndarray, texels: Texels) -> TextureImage:
    """Pad and write the maps of one image; returns the names of their files."""
    from ..capture.images import write_exr

    width, height = entry.width, entry.height
    filled = np.zeros(width * height, bool)
    filled[texel] = True
    image = np.zeros((width * height, 8), np.float32)
    image[texel] = np.column_stack([texels.base_color, texels.roughness, texels.metallic, texels.confidence])
    # Row 0 is v = 0 here, but the top row in image files.
    padded = pad(image.reshape(height, width, 8), filled.reshape(height, width))[::-1]
    planes = padded[..., :3], padded[..., 3], padded[..., 4], padded[..., 5:]
    files = {name: f"{entry.name}.{name}.exr" for name in MAPS}
    for file, plane in zip(files.values(), planes, strict=True):
        write_exr(folder / file, plane, half=True)
    return TextureImage(entry.name, **{name: f"textures/{file}" for name, file in files.items()})


def pad(image: np.ndarray, filled: np.ndarray) -> np.ndarray:
    """(H, W, C) an image whose texels between UV islands are as the nearest of one; zero without islands.

    Filtering and mipmaps therefore never read an empty texel.

    Args:
        image: (H, W, C), zero where not `filled` (H, W) bool.
    """
    if not filled.any():
        return image
    return image[tuple(distance_transform_edt(~filled, return_distances=False, return_indices=True))]


def _bake_corners(folder: Path, fields: FieldSource, corners: np.ndarray) -> str:
    """Write the maps at the corners (T,3,3) of all triangles; returns the file's name."""
    count = len(corners)
    # Sampled a thousandth inwards: a corner itself may lie on the neighbouring surface too.
    inwards = corners + 1e-3 * (corners.mean(axis=1, keepdims=True) - corners)
    samples = Texels.create(3 * count)
    samples.position[:], samples.triangle[:] = inwards.reshape(-1, 3), np.repeat(np.arange(count), 3)
    sample_fields(fields, samples)
    path = folder / "corner_fields.npz"
    values = CornerFields(
        base_color=samples.base_color.reshape(count, 3, 3),
        roughness=samples.roughness.reshape(count, 3),
        metallic=samples.metallic.reshape(count, 3),
        confidence=samples.confidence.reshape(count, 3, 3),
    )
    write_arrays(path, values)
    return path.name
