"""The results of a run as Apply Results reads them: parts, atlas, textures and emitters."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...core.run.documents import read_document
from ...core.run.errors import FiptError
from ...core.run.parts import RoomParts, read_parts
from ...core.run.result_contents import AtlasImages, EmitterFixture, Emitters, TextureImage
from ...core.run.run_files import AtlasArrays, CornerFields, LeftAlone, RoomMesh, read_room
from ...core.run.runfolder import RunFolder
from ...core.run.store import read_arrays
from ..color_spaces import to_scene_linear
from ..lights.fixtures import triangle_fixtures
from ..marks import MAP
from ..room.islands import uv_islands
from ..room.uv_layer import UV_LAYER
from .materials import MAPS, read_textures

_AGAIN = "Apply the results again."
_ESTIMATE_AGAIN = "Run the estimation again."


@dataclass(frozen=True)
class Results:
    """The results of a run.

    Attributes:
        room: the exported room.
        parts: of the room.
        left_alone: (T,) bool, triangles that keep the artist's material.
        corner_uv: (T,3,2) of the atlas.
        triangle_image: (T,) int, on which of its images a triangle lies; 0 for colour attributes.
        entries: the images of textures.json; empty for colour attributes.
        uniform: base colour, roughness and metallic of parts of one value, by their keys.
        corner_fields: values of colour attributes by map; empty for UVs.
        emitters: the fixtures of emitters.json.
    """

    room: RoomMesh
    parts: RoomParts
    left_alone: np.ndarray
    corner_uv: np.ndarray
    triangle_image: np.ndarray
    entries: Sequence[TextureImage]
    uniform: dict[str, tuple[float, ...]]
    corner_fields: dict[str, np.ndarray]
    emitters: Sequence[EmitterFixture]

    @cached_property
    def laid_out(self) -> str:
        """A digest of the atlas."""
        digest = hashlib.blake2b(self.corner_uv.tobytes() + self.triangle_image.tobytes(), digest_size=16)
        digest.update(repr((sorted(self.corner_fields), [each.name for each in self.entries])).encode())
        return digest.hexdigest()

    @cached_property
    def layers(self) -> dict[str, np.ndarray]:
        """(T,3,C) values of the face corners by layer."""
        if not self.corner_fields:
            return {UV_LAYER: self.corner_uv}
        layers = {}
        for key, (label, is_data) in MAPS.items():
            values = np.ones((len(self.corner_uv), 3, 4), np.float32)
            # Data maps are grey colours, so that solid shading can draw them too.
            field = self.corner_fields[key].reshape(len(values), 3, -1)
            values[..., :3] = field if is_data else to_scene_linear(field)
            layers[MAP.format(label)] = values
        return layers

    @cached_property
    def fixture(self) -> np.ndarray:
        """(T,) index of the fixture of each triangle, -1 for none."""
        return triangle_fixtures(self.emitters, len(self.corner_uv))

    def charts(self) -> np.ndarray:
        """(T,) number of the surface on which each triangle's values are continuous."""
        if self.corner_fields:
            return self.parts.triangle + 1
        apart = 2.0 * self.triangle_image[:, None, None]  # on different images
        return uv_islands(self.room.triangles, self.corner_uv + apart)


def read_results(run: RunFolder) -> Results:
    room = read_room(run)
    count = len(room.triangles)
    atlas = read_document(run.atlas_json, AtlasImages, _AGAIN)
    arrays = read_arrays(run.atlas_npz, AtlasArrays, _AGAIN)
    corner_fields: dict[str, np.ndarray] = {}
    entries: Sequence[TextureImage] = ()
    uniform: dict[str, tuple[float, ...]] = {}
    if atlas.mode == "color_attribute":
        path = run.textures / "corner_fields.npz"
        corner_fields = vars(read_arrays(path, CornerFields, _AGAIN))
    else:
        entries, uniform = read_textures(run)
        if len(entries) != len(atlas.images):
            raise FiptError(
                "file-damaged.read-results", textures_json=run.textures_json, atlas_json=run.atlas_json
            )
    parts = read_parts(run, room.triangle_object, room.objects)
    left_alone = np.zeros(count, bool)
    if run.left_alone_npz.is_file():
        found = read_arrays(run.left_alone_npz, LeftAlone, _ESTIMATE_AGAIN)
        left_alone = of_whole_polygons(room, found.left_alone)
    return Results(
        room=room,
        parts=parts,
        left_alone=left_alone,
        corner_uv=arrays.corner_uv,
        triangle_image=own_images(arrays.triangle_image, parts.triangle, room.triangle_object),
        entries=entries,
        uniform=uniform,
        corner_fields=corner_fields,
        emitters=read_document(run.emitters_json, Emitters, _ESTIMATE_AGAIN).fixtures,
    )


def of_whole_polygons(room: RoomMesh, chosen: np.ndarray) -> np.ndarray:
    """(T,) bool, the triangles of polygons of which some triangle is chosen, (T,) bool."""
    both = np.stack([room.triangle_object, room.triangle_polygon], axis=1)
    _, polygon = np.unique(both, axis=0, return_inverse=True)
    result: np.ndarray = np.bincount(polygon.ravel(), chosen)[polygon.ravel()] > 0
    return result


def own_images(image: np.ndarray, part: np.ndarray, owner: np.ndarray) -> np.ndarray:
    """(T,) image of each triangle; those without area, which have none (-1), take that of others beside them.

    Args:
        image: (T,) int. part, owner: (T,) int, of each triangle; those of one part and object have one image.
    """
    both = part.astype(np.int64) * (int(owner.max(initial=0)) + 1) + owner
    found = image.astype(np.int64)
    for group in (both, part.astype(np.int64), owner.astype(np.int64)):
        largest = np.full(int(group.max(initial=0)) + 1, -1, np.int64)
        np.maximum.at(largest, group, found)
        found = np.where(found < 0, largest[group], found)
    return np.maximum(found, 0)
