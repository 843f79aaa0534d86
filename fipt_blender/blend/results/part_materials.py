# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Gives the faces of result meshes the materials of their parts, which are made as they are needed.

Materials of earlier results are built anew and keep the artist's name and adjustments.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import bpy
import numpy as np

from ...bridge.process import Message
from ...core.run.parts import RoomParts
from ..image_datablocks import remove_unused_images
from ..marks import PART, PART_NAME
from ..room.arrays import Room
from ..room.mesh_arrays import polygon_slots
from ..room.originals import original_polygons
from ..room.result_meshes import list_names
from . import adjust
from .materials import Surface, images_of, part_material


@dataclass(frozen=True)
class PartFaces:
    """What each triangle of a room shows.

    Attributes:
        parts: of the room.
        triangle_image: (T,) atlas image of each triangle, -1 for none.
        left_alone: (T,) bool, triangles that keep the artist's material.
    """

    parts: RoomParts
    triangle_image: np.ndarray
    left_alone: np.ndarray


@dataclass
class PartMaterials:
    """The materials of a room's parts.

    Attributes:
        faces: what the triangles show.
        images: of each atlas image by the labels of their maps; None for colour attributes.
        names: of the atlas images.
        earlier: materials of earlier results, by atlas image and key of the part.
        made: those made so far, by the indices of atlas image and part.
    """

    faces: PartFaces
    images: Sequence[Mapping[str, bpy.types.Image]] | None
    names: Sequence[str]
    earlier: Mapping[tuple[str, str], bpy.types.Material]
    made: dict[tuple[int, int], bpy.types.Material] = field(default_factory=dict)

    def __post_init__(self) -> None:
        parts = self.faces.parts.parts
        keys, names = {part.key for part in parts}, {part.name: part.key for part in parts}
        self._adjustments: dict[str, adjust.Adjustment] = {}
        self._lost: list[str] = []
        for material in self.earlier.values():
            values = adjust.read(material)
            if values == adjust.NO_ADJUSTMENT:
                continue
            key, name = material.get(PART, ""), material.get(PART_NAME, "")
            kept = key if key in keys else names.get(name)
            if kept is None:
                self._lost.append(name or material.name)
            else:
                self._adjustments[kept] = values
        self._images = images_of(self.earlier.values())

    def assign(self, mesh: bpy.types.Mesh, room: Room, index: int) -> None:
        """Give a result mesh of the object `index` one slot for each material that it uses."""
        of_object = room.triangle_object == index
        polygon = room.triangle_polygon[of_object]
        original = original_polygons(mesh)
        count = max(int(polygon.max(initial=-1)), int(original.max(initial=-1))) + 1
        image = np.full(count, -1)
        # Triangles without area have no image (-1); the polygon takes that of its other triangles.
        order = np.argsort(self.faces.triangle_image[of_object], kind="stable")
        image[polygon[order]] = self.faces.triangle_image[of_object][order]
        known = image[image >= 0]
        image[image < 0] = known[0] if len(known) else 0
        part = np.zeros(count, np.int64)
        part[polygon[::-1]] = self.faces.parts.triangle[of_object][::-1]  # the first triangle's
        kept = np.zeros(count, bool)
        kept[polygon[self.faces.left_alone[of_object]]] = True
        parts = len(self.faces.parts.parts)
        own = polygon_slots(mesh)
        used, slot = np.unique(
            np.where(kept[original], -1 - own, (image * parts + part)[original]), return_inverse=True
        )
        originals = list(mesh.materials)
        materials = [
            self._material(*divmod(value, parts)) if value >= 0 else _slot(originals, -1 - value)
            for value in used.tolist()
        ]
        mesh.materials.clear()
        for material in materials:
            mesh.materials.append(material)
        mesh.polygons.foreach_set("material_index", slot.ravel().astype(np.int32))
        mesh.update()

    def _material(self, image: int, part: int) -> bpy.types.Material:
        if (image, part) not in self.made:
            described = self.faces.parts.parts[part]
            surface = Surface(self.names[image], described.key, described.name)
            self.made[image, part] = part_material(
                surface,
                None if self.images is None else self.images[image],
                self._adjustments.get(described.key, adjust.NO_ADJUSTMENT),
                self.earlier.get((surface.image, surface.key)),
            )
        return self.made[image, part]

    def finish(self) -> list[Message]:
        """Remove the images of earlier results that nothing uses, and name the new ones.

        Returns:
            A warning about adjustments of parts that are no longer there.
        """
        remove_unused_images(self._images)
        for name, images in zip(self.names, self.images or [], strict=False):
            for label, image in images.items():
                image.name = f"FIPT {name} {label}"
        if not self._lost:
            return []
        names = list_names(sorted(set(self._lost)))
        text = f"The estimate no longer has the parts that you have adjusted: {names}."
        remedy = "Adjust the parts that have taken their place."
        return [{"type": "warning", "code": "adjustments-lost", "text": text, "remedy": remedy}]


def _slot(materials: Sequence[bpy.types.Material | None], index: int) -> bpy.types.Material | None:
    """The material that Blender shows of a slot: an index beyond the last slot shows the last."""
    return materials[min(index, len(materials) - 1)] if materials else None


def materials_by_part(
    materials: Iterable[bpy.types.Material],
) -> dict[str, list[bpy.types.Material]]:
    """Estimated materials by the keys of their parts."""
    by_part: dict[str, list[bpy.types.Material]] = {}
    for material in materials:
        by_part.setdefault(material.get(PART, ""), []).append(material)
    return by_part
