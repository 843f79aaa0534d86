# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Limits of values, and the layouts of array files as `arrays.read_arrays` takes them.

Standard library only. docs/run_folder.md describes what the values mean.
"""

from __future__ import annotations

MOST_SIDE = 65_536  # pixels along an edge of an image
SCALES = (1e-6, 1e6)  # meters per unit of a capture: from micrometers to a thousand kilometers
# Meters from the origin, of cameras and vertices. Coordinates from the Earth's center have up to 6.4e6, those
# of maps up to 1e7; squares of much larger ones are beyond single precision.
FARTHEST = 1e8
FARTHEST_UNITS = FARTHEST / SCALES[0]  # the same in a capture's own units
UP_AXES = ("x", "y", "z", "-x", "-y", "-z")
UP_SOURCES = ("option", "format", "planes", "cameras")  # what tells which axis of a capture is up

# Array files: the kind of an array's numbers ("f" float, "u" float or NaN for unknown, "i" whole, "b" bool),
# and its sizes: a number, or a letter for any size, which is the same for all arrays of a file that have this
# letter.
Layout = tuple[str, tuple[int | str, ...]]
ROOM_ARRAYS: dict[str, Layout] = {
    "vertices": ("f", ("V", 3)),
    "triangles": ("i", ("T", 3)),
    "corner_normals": ("f", ("T", 3, 3)),
    "triangle_object": ("i", ("T",)),
    "triangle_material": ("i", ("T",)),
    "triangle_polygon": ("i", ("T",)),
}
# In room.npz where the artist has drawn surfaces of a scan.
EXACT_ARRAYS: dict[str, Layout] = {**ROOM_ARRAYS, "triangle_exact": ("b", ("T",))}
GEOMETRY_ARRAYS: dict[str, Layout] = {
    "vertices": ("f", ("V", 3)),
    "corner_normals": ("f", ("T", 3, 3)),
    "plane": ("i", ("T",)),
    "noise": ("f", ()),
    "source": ("i", (32,)),
}
OUTLINES_ARRAYS: dict[str, Layout] = {
    "vertices": ("f", ("V", 3)),
    "cleaned": ("i", (32,)),
    "masks": ("i", (32,)),
}
CLOSING_ARRAYS: dict[str, Layout] = {
    "vertices": ("f", ("V", 3)),
    "triangles": ("i", ("T", 3)),
    "corner_normals": ("f", ("T", 3, 3)),
    "beside": ("i", ("T",)),
    "most_edges": ("i", ()),
    "count": ("i", (2,)),
    "area": ("f", (2,)),
    "source": ("i", (32,)),
}
PANES_ARRAYS: dict[str, Layout] = {
    "vertices": ("f", ("V", 3)),
    "triangles": ("i", ("T", 3)),
    "corner_normals": ("f", ("T", 3, 3)),
    "source": ("i", (32,)),
}
ATLAS_ARRAYS: dict[str, Layout] = {"corner_uv": ("f", ("T", 3, 2)), "triangle_image": ("i", ("T",))}
CORNER_FIELDS_ARRAYS: dict[str, Layout] = {
    "base_color": ("f", ("T", 3, 3)),
    "roughness": ("f", ("T", 3)),
    "metallic": ("f", ("T", 3)),
    "confidence": ("f", ("T", 3, 3)),
}
SURVEY_ARRAYS: dict[str, Layout] = {
    "seen": ("i", ("V", "B")),
    "areas": ("f", ("T",)),
    "disagreement": ("u", ("T",)),
}
FIELDS_ARRAYS: dict[str, Layout] = {
    "hash_levels": ("i", ()),
    "box_low": ("f", (3,)),
    "box_extent": ("f", ()),
    "seen_keys": ("i", ("C",)),
    "seen_points": ("f", ("C", 3)),
    "seen_part": ("i", ("C",)),
    "seen_errors": ("f", ("C", 3)),
}
DETAIL_ARRAYS: dict[str, Layout] = {
    "detail_median": ("u", ("U", 3)),
    "detail_width": ("f", ()),
    "detail_keys": ("i", ("N",)),
    "detail_sums": ("f", ("N", 9)),
}
PARTS_ARRAYS: dict[str, Layout] = {"triangle_part": ("i", ("T",)), "single": ("b", ("U",))}
FIXED_ARRAYS: dict[str, Layout] = {**PARTS_ARRAYS, "fixed": ("u", ("U", 2))}  # where hints fix values
RESOLUTION_ARRAYS: dict[str, Layout] = {"density": ("u", ("T",))}
LEFT_ALONE_ARRAYS: dict[str, Layout] = {"left_alone": ("b", ("T",))}
