"""results/parts.json: what the units of an estimate are called, how large they are and what they are made of.

The units themselves are in parts.npz. Blender makes one material for each of them, and lists them.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..capture.rig import CLASS_NAMES
from ..capture.views import View
from ..material.fields import RoomFields
from ..parts.labels import Parts, choose_source, fuse_masks, mesh_borders
from ..pixels.grouped import grouped_means
from ..pixels.store import PixelStore
from ..run.documents import read_document
from ..run.parts import readable, unique_names
from ..run.result_contents import PartList, RoomPart
from ..run.runfolder import RunFolder, write_json
from ..surface.room import Room

# Cells whose values are averaged.
MAX_CELLS = 50_000
# Two surfaces are one if each holds this share of the other's area; a surface has a direction or a class if
# this share of it has.
SAME, MAJORITY = 0.9, 0.7
# A surface is at the floor or the ceiling within this share of the room's height, and a wall from this share
# of the room's area.
END, LARGE = 0.1, 0.03
# Names that programs give to materials that nobody named; an object's name says more.
_UNNAMED = re.compile(r"(default)?[ _]?material[ ._]?\d*", re.IGNORECASE)
_NAMES_OF_IDS = {"mask": "Part {}", "class": "Class {}"}


def write_part_list(
    run: RunFolder,
    room: Room,
    parts: Parts,
    views: Sequence[View],
    pixels: PixelStore,
    fields: RoomFields,
    areas: Mapping[int, str] | None = None,
) -> list[str]:
    """Write results/parts.json (docs/run_folder.md) and return the names of the units.

    Args:
        room, parts: of the estimation.
        views: the training views, in the order of `pixels`.
        pixels: their pixels.
        fields: the estimate; its units are listed.
        areas: names of the units that hints have made.
    """
    unit = fields.units.triangle
    count = len(fields.units.single)
    classes = _semantic_classes(room, views, pixels, unit, count)
    source = choose_source(room, views)
    areas = areas or {}
    of_mesh = mesh_borders(room, source) is not None
    keys = [_key(source, room, parts, unit, index, of_mesh) for index in range(count)]
    keys = unique_names([f"area:{areas[index]}" if index in areas else key for index, key in enumerate(keys)])
    names = _names(room, source, unit, keys, classes)
    names = unique_names([areas.get(index, name) for index, name in enumerate(names)])
    seen = np.zeros(count + 1, np.int64)
    for first, last in itertools.pairwise(pixels.ranges):
        triangle = np.asarray(pixels.triangle[first:last])
        seen += np.bincount(unit[triangle[triangle >= 0]] + 1, minlength=count + 1)
    size = np.bincount(unit + 1, minlength=count + 1)
    area = np.bincount(unit + 1, room.areas, minlength=count + 1)
    values = _mean_values(fields, count)
    listed = []
    for index in range(count):
        part = RoomPart(
            unit=index,
            key=keys[index],
            name=names[index],
            class_name=classes[index] or None,
            single=bool(fields.units.single[index]),
            triangles=int(size[index + 1]),
            pixels=int(seen[index + 1]),
            area=round(float(area[index + 1]), 6),
        )
        if np.isfinite(values[index]).all():
            r, g, b, roughness, metallic, *trust = values[index].round(4).tolist()
            part = replace(
                part,
                base_color=(r, g, b),
                roughness=roughness,
                metallic=metallic,
                confidence=(trust[0], trust[1], trust[2]),
            )
        listed.append(part)
    write_json(run.parts_json, PartList(source, tuple(listed)))
    return names


def _mean_values(fields: RoomFields, count: int) -> np.ndarray:
    """(count, 8) means over the seen cells of each unit: base colour, roughness, metallic, confidences."""
    cells = fields.cells
    rows = np.arange(0, len(cells.part), max(len(cells.part) // MAX_CELLS, 1))
    rows = rows[cells.part[rows] >= 0]
    if not len(rows):
        return np.full((count, 8), np.nan)
    units, first = np.unique(fields.units.triangle, return_index=True)
    triangle = first[np.searchsorted(units, cells.part[rows])]  # any of the unit's
    points = cells.points[rows].astype(np.float64)
    values = np.column_stack([*fields.query(points, triangle), fields.confidence(points, triangle)])
    return grouped_means(values, cells.part[rows], count)


def _key(source: str, room: Room, parts: Parts, unit: np.ndarray, index: int, of_mesh: bool) -> str:
    """A text that names a unit in other estimates of the room, too, as far as its source allows.

    Args:
        of_mesh: whether slots or objects give the units their borders, although the source is masks.
    """
    if parts.kind == "part" and index < len(parts.ids) and not of_mesh:
        return f"mask:{parts.ids[index]}"
    if parts.kind == "semantic" and index < len(parts.ids):
        return f"class:{parts.ids[index]}"
    triangle = int(np.argmax(unit == index))
    if of_mesh:
        source = "materials" if room.triangle_material[triangle] >= 0 else "objects"
    if source == "objects":
        return f"object:{room.objects[room.triangle_object[triangle]]}"
    if source == "materials":
        return f"material:{room.materials[room.triangle_material[triangle]]}"
    return f"piece:{triangle}"


def _semantic_classes(
    room: Room, views: Sequence[View], pixels: PixelStore, unit: np.ndarray, count: int
) -> list[str]:
    """The name of the semantic class of each unit, "" where it is unknown."""
    if not any(view.semantics for view in views):
        return [""] * count
    triangles = (np.asarray(pixels.triangle[first:last]) for first, last in itertools.pairwise(pixels.ranges))
    images = (view.semantic_ids() for view in views)
    label = fuse_masks(images, triangles, len(room.triangles))
    names = _class_names(next(view.semantics for view in views if view.semantics))
    ids, place = np.unique(label[label >= 0], return_inverse=True)
    label[label >= 0] = place
    classes = []
    for row in _areas(room, unit, count, label, len(ids)):
        total, best = row.sum(), int(row.argmax()) if len(row) else 0
        number = int(ids[best]) if total > 0.0 and row[best] >= MAJORITY * total else -1
        classes.append(names.get(str(number), ""))
    return classes


def _class_names(mask: Path) -> dict[str, str]:
    """The names of classes by id in the file beside a mask; none without the file."""
    path = mask.parent / CLASS_NAMES
    return read_document(path, dict[str, str], "Correct or delete it.") if path.is_file() else {}


def _names(
    room: Room, source: str, unit: np.ndarray, keys: Sequence[str], classes: Sequence[str]
) -> list[str]:
    """A name of each unit: of its material, object or class, by its place in the room, or by its key."""
    count = len(keys)
    materials = [""] * count
    if source != "objects" and room.scan is None:
        materials = _materials_of(room, unit, count)
    whole = _same_surfaces(room, unit, count, room.triangle_object, room.objects)
    slots = _same_surfaces(room, unit, count, room.triangle_material, room.materials)
    mostly = _objects_of(room, unit, count) if len(room.objects) > 1 else [""] * count
    places = _places(room, unit, count)
    pairs = (key.split(":", 1) for key in keys)
    ids = [_NAMES_OF_IDS.get(kind, "Surface").format(number) for kind, number in pairs]
    choices = zip(materials, whole, slots, classes, mostly, places, ids, strict=True)
    return [readable(next(filter(None, choice))) for choice in choices]


def _areas(room: Room, unit: np.ndarray, count: int, label: np.ndarray, labels: int) -> np.ndarray:
    """(count, labels) area that units and labels (T,) have in common."""
    known = (unit >= 0) & (label >= 0)
    pair = unit[known].astype(np.int64) * labels + label[known]
    return np.bincount(pair, room.areas[known], minlength=count * labels).reshape(count, labels)


def _same_surfaces(
    room: Room, unit: np.ndarray, count: int, label: np.ndarray, names: Sequence[str]
) -> list[str]:
    """The name of the label whose triangles are those of a unit, "" where none is."""
    if len(names) < 2:
        return [""] * count
    shared = _areas(room, unit, count, label, len(names))
    of_label = np.bincount(label[label >= 0], room.areas[label >= 0], minlength=len(names))
    of_unit = np.bincount(unit[unit >= 0], room.areas[unit >= 0], minlength=count)
    best = shared.argmax(axis=1)
    common = shared[np.arange(count), best]
    same = (common > 0.0) & (common >= SAME * of_unit) & (common >= SAME * of_label[best])
    return [names[index] if is_same else "" for index, is_same in zip(best, same, strict=True)]


def _materials_of(room: Room, unit: np.ndarray, count: int) -> list[str]:
    """The material in whose slots each unit lies, "" for units in several, and where nobody named it.

    A room of one material has no names by it.
    """
    if len(room.materials) < 2 or len(np.unique(room.triangle_material)) < 2:
        return [""] * count
    shared = _areas(room, unit, count, room.triangle_material, len(room.materials))
    of_unit = np.bincount(unit[unit >= 0], room.areas[unit >= 0], minlength=count)
    best = shared.argmax(axis=1)
    within = (of_unit > 0.0) & (shared.max(axis=1) >= SAME * of_unit)
    names = ["" if _UNNAMED.fullmatch(name) else name for name in room.materials]
    return [names[index] if is_within else "" for index, is_within in zip(best, within, strict=True)]


def _objects_of(room: Room, unit: np.ndarray, count: int) -> list[str]:
    """The object that holds most of each unit."""
    shared = _areas(room, unit, count, room.triangle_object, len(room.objects))
    return [room.objects[index] for index in shared.argmax(axis=1)]


def _places(room: Room, unit: np.ndarray, count: int) -> list[str]:
    """Floor, Ceiling, Wall or "", by height, direction and area of each unit."""
    known = unit >= 0
    area = np.maximum(np.bincount(unit[known], room.areas[known], minlength=count), 1e-12)
    corners = room.vertices[room.triangles[known]].astype(np.float64)
    steepness = np.abs(room.normals[known, 2])

    def mean(values: np.ndarray) -> np.ndarray:
        return np.bincount(unit[known], values * room.areas[known], minlength=count) / area

    low, high = room.bounds
    height = (mean(corners[:, :, 2].mean(axis=1)) - low[2]) / max(high[2] - low[2], 1e-9)
    flat, upright = mean(steepness > 0.9) > MAJORITY, mean(steepness < 0.3) > MAJORITY
    large = area > LARGE * room.areas.sum()
    names = np.full(count, "", object)
    names[upright & large] = "Wall"
    names[flat & large & (height < END)] = "Floor"
    names[flat & large & (height > 1.0 - END)] = "Ceiling"
    return list(names)
