"""Gives the faces of result meshes the materials of their parts, which are made as they are needed.

Materials of earlier results are built anew and keep the artist's name and adjustments.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import bpy
import numpy as np

from ...bridge.process import Message
from ...core.run.errors import warning
from ..image_datablocks import remove_unused_images
from ..marks import MATERIAL, PART, PART_NAME, REPLACEMENT
from ..room.mesh_arrays import polygon_slots
from ..room.result_meshes import list_names
from . import adjust
from .materials import images_of, materials_by_part, part_material
from .reading import Results
from .replacing import fill_slots


@dataclass
class PartMaterials:
    """The materials of a room's parts.

    Attributes:
        results: of the run.
        images: the maps of each atlas image by their labels; of colour attributes, the one is None.
        names: of the atlas images.
        earlier: materials of earlier results, whose adjustments and replacements are kept.
        reused: those of them that are built anew instead of making new ones.
        made: those made so far, by the indices of part and image.
    """

    results: Results
    images: Sequence[Mapping[str, bpy.types.Image] | None]
    names: Sequence[str]
    earlier: Sequence[bpy.types.Material]
    reused: Sequence[bpy.types.Material]
    made: dict[tuple[int, int], bpy.types.Material] = field(default_factory=dict)

    def __post_init__(self) -> None:
        parts = self.results.parts.parts
        keys, names = {part.key for part in parts}, {part.name: part.key for part in parts}
        self._adjustments: dict[str, adjust.Adjustment] = {}
        self._replacements: dict[str, bpy.types.Material] = {}
        self._lost: list[str] = []
        self._reused = {key: iter(found) for key, found in materials_by_part(self.reused).items()}
        for material in self.earlier:
            values, replacement = adjust.read(material), material.get(REPLACEMENT)
            if values == adjust.NO_ADJUSTMENT and replacement is None:
                continue
            key, name = material.get(PART, ""), material.get(PART_NAME, "")
            kept = key if key in keys else names.get(name)
            if kept is None:
                self._lost.append(name or material.name)
            else:
                self._adjustments[kept] = values
                if replacement is not None:
                    self._replacements[kept] = replacement
        self._images = images_of(self.earlier)

    def assign(
        self,
        mesh: bpy.types.Mesh,
        triangle: np.ndarray,
        estimates: Sequence[bpy.types.Material | None] | None = None,
        laid_out_alike: bool = False,
    ) -> None:
        """Give a result mesh one slot for each material that it uses.

        Args:
            mesh: a result mesh with the artist's slots or, with `estimates`, those of earlier results.
            triangle: (P,) triangle of the room that each polygon shows, -1 for none.
            estimates: the estimated material of each slot; polygons of other slots keep what the artist has
                given them.
            laid_out_alike: whether the earlier results have the same atlas: then polygons without a triangle
                get the new material of their part; otherwise they keep the earlier one.
        """
        own = np.minimum(polygon_slots(mesh), max(len(mesh.materials) - 1, 0))
        # The last ones stand for -1.
        part = np.append(
            self.results.parts.triangle.astype(np.int64) * len(self.names) + self.results.triangle_image, -1
        )
        kept = np.append(self.results.left_alone, True)[triangle]
        number = part[triangle]
        if estimates is not None:
            kept |= ~np.array([material is not None for material in estimates] or [False])[own]
            earlier = np.array([self._number(material) for material in estimates] or [-1])[own]
            again = (triangle < 0) & (earlier >= 0) & laid_out_alike
            number, kept = np.where(again, earlier, number), kept & ~again
        used, slot = np.unique(np.where(kept, -1 - own, number), return_inverse=True)
        originals = list(mesh.materials)
        materials = [
            self._material(*divmod(value, len(self.names))) if value >= 0 else _slot(originals, -1 - value)
            for value in used.tolist()
        ]
        fill_slots(mesh, materials)
        mesh.polygons.foreach_set("material_index", slot.ravel().astype(np.int32))
        mesh.update()

    def _number(self, material: bpy.types.Material | None) -> int:
        """Index of part and image of an earlier material, -1 where there is no such part."""
        keys = [part.key for part in self.results.parts.parts]
        if material is None or material[MATERIAL] not in self.names or material.get(PART) not in keys:
            return -1
        return keys.index(material[PART]) * len(self.names) + self.names.index(material[MATERIAL])

    def _material(self, part: int, image: int) -> bpy.types.Material:
        found = self.made.get((part, image))
        if found is None:
            described = self.results.parts.parts[part]
            found = part_material(
                self.names[image],
                described.key,
                described.name,
                self.images[image],
                self._adjustments.get(described.key, adjust.NO_ADJUSTMENT),
                self.results.uniform.get(described.key),
                next(self._reused.get(described.key, iter(())), None),
            )
            self.made[part, image] = found
            if described.key in self._replacements:
                found[REPLACEMENT] = self._replacements[described.key]
        return found

    def finish(self) -> list[Message]:
        """Remove the images of earlier results that nothing uses, and name the new ones.

        Returns:
            A warning about adjustments of parts that are no longer there.
        """
        remove_unused_images(self._images)
        for name, images in zip(self.names, self.images, strict=True):
            for label, image in (images or {}).items():
                image.name = f"FIPT {name} {label}"
        if not self._lost:
            return []
        return [warning("adjustments-lost", parts=list_names(sorted(set(self._lost))))]


def _slot(materials: Sequence[bpy.types.Material | None], index: int) -> bpy.types.Material | None:
    """The material that Blender shows of a slot: an index beyond the last slot shows the last."""
    return materials[min(index, len(materials) - 1)] if materials else None
