# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The shapes of the run folder's documents and array files, which both processes check before they use them.

Documents are described with `documents`, array files as `arrays.read_arrays` takes them. Standard library
only. docs/architecture.md describes what the values mean.
"""

from __future__ import annotations

from .documents import Choice, Entries, Fields, FileName, Items, Maybe, Number, Numbers, head

MOST_SIDE = 65_536  # pixels along an edge of an image
SCALES = (1e-6, 1e6)  # meters per unit of a capture: from micrometers to a thousand kilometers
# Meters from the origin, of cameras and vertices. Coordinates from the Earth's center have up to 6.4e6, those
# of maps up to 1e7; squares of much larger ones are beyond single precision.
FARTHEST = 1e8
FARTHEST_UNITS = FARTHEST / SCALES[0]  # the same in a capture's own units
UP_AXES = ("x", "y", "z", "-x", "-y", "-z")
UP_SOURCES = ("option", "format", "planes", "cameras")  # what tells which axis of a capture is up
_NOT_NEGATIVE = Number(low=0.0)


def _head(name: str) -> dict[str, Choice]:
    return {key: Choice(value) for key, value in head(name).items()}


RUN = Fields({"format": str}, {"version": Number(), "product_version": str, "settings": dict})

_VIEW = Fields(
    {
        **dict.fromkeys(("name", "split", "image"), str),
        **dict.fromkeys(("width", "height"), Number(1, MOST_SIDE, whole=True)),
        **dict.fromkeys(("fx", "fy", "cx", "cy"), Number()),
        "camera_to_world": Numbers(4, 4, most=FARTHEST),
        **dict.fromkeys(("parts", "semantics"), Maybe(str)),
    },
    {
        "mask": Maybe(str),
        "preview": Maybe(str),
        "encoded": bool,
        "exposure": Maybe(Number(low=1e-12, high=1e12)),
    },
)
CAPTURE = Fields(
    {
        "source": str,
        "world_from_source": Numbers(4, 4, most=FARTHEST_UNITS),
        "mesh": Maybe(str),
        "views": Items(_VIEW),
    },
    {"up": Fields({"axis": Choice(*UP_AXES), "source": Choice(*UP_SOURCES), "angle": _NOT_NEGATIVE})},
)
ROOM = Fields(
    {"objects": Items(str), "materials": Items(str)},
    {"object_ids": Items(str), "matrices": Items(Numbers(4, 4)), "parts": str, "completed": bool},
)
MATRICES = Entries(Numbers(4, 4))

STEPS = Fields(
    {
        "version": Number(whole=True),
        "steps": Entries(
            Fields(
                {"key": str, "finished": bool},
                {
                    "seconds": _NOT_NEGATIVE,
                    "warnings": Items(Fields(dict.fromkeys(("type", "code", "text", "remedy"), str))),
                },
            )
        ),
    }
)
STAGES = Fields(
    {
        "keys": Entries(str),
        "stages": Entries(
            Fields(optional=dict.fromkeys(("seconds", "rays", "mrays_per_second"), _NOT_NEGATIVE))
        ),
        "warnings": Entries(Items(Fields(dict.fromkeys(("code", "text", "remedy"), str)))),
    },
    {"dropped": Items(str)},
)

VERSION = Fields({**_head("version"), "name": str, "time": _NOT_NEGATIVE})

_EXIF_NUMBER = Maybe(Number(low=1e-12, high=1e12))
PREPARE = Fields(
    {
        **_head("prepare"),
        "source": str,
        "settings": dict,
        "photographs": Items(
            Fields(
                {
                    "path": str,
                    "kind": Choice("raw", "ldr", "linear"),
                    **dict.fromkeys(("width", "height"), Number(1, MOST_SIDE, whole=True)),
                },
                {
                    "orientation": Number(1, 8, whole=True),
                    **dict.fromkeys(("make", "model", "lens"), str),
                    **dict.fromkeys(("shutter", "aperture", "iso", "exposure"), _EXIF_NUMBER),
                    **dict.fromkeys(("focal_length", "focal_35mm"), _EXIF_NUMBER),
                    "corrected": Maybe(bool),
                    "time": Maybe(Number()),
                },
            )
        ),
        "groups": Items(Fields({"name": FileName(), "photographs": Items(str, least=1)}, {"used": bool})),
    }
)

EMITTERS = Fields(
    {
        "fixtures": Items(
            Fields(
                {
                    "name": str,
                    "triangles": Items(Number(low=0, whole=True)),
                    **dict.fromkeys(("radiance", "back_radiance"), Numbers(3)),
                },
                {
                    **dict.fromkeys(("base_color", "centroid", "power"), Numbers(3)),
                    "area": _NOT_NEGATIVE,
                    "probability": _NOT_NEGATIVE,
                },
            )
        ),
        "environment": Maybe(
            Fields({"image": Choice("environment.exr")}, {"observed_share": Number(0.0, 1.0)})
        ),
    },
    {"missing": Items(Fields({"position": Numbers(3), "radius": _NOT_NEGATIVE, "radiance": Numbers(3)}))},
)
_SHARE = Number(0.0, 1.0)
PARTS = Fields(
    {
        **_head("parts"),
        "source": str,
        "parts": Items(
            Fields(
                {
                    **dict.fromkeys(("id", "triangles", "pixels"), Number(low=0, whole=True)),
                    **dict.fromkeys(("key", "name"), str),
                    "single": bool,
                    "class": Maybe(str),
                    "area": _NOT_NEGATIVE,
                    **dict.fromkeys(("base_color", "confidence"), Maybe(Numbers(3))),
                    **dict.fromkeys(("roughness", "metallic"), Maybe(_SHARE)),
                }
            )
        ),
    }
)
DOUBTS = Fields(
    {
        **_head("doubts"),
        "doubts": Items(
            Fields(
                {
                    **dict.fromkeys(("name", "text", "view"), str),
                    "question": Choice("metal", "gloss", "lamp"),
                    "point": Numbers(3),
                    "pixels": Number(low=0, whole=True),
                    **dict.fromkeys(("share", "roughness", "metallic"), _SHARE),
                    **dict.fromkeys(("roughness_error", "metallic_error"), _SHARE),
                    "box": Numbers(4),
                    "picture": FileName(),
                }
            )
        ),
    }
)
STATISTICS = Fields(
    optional={
        "stages": Items(Fields(optional={"name": str, "seconds": Maybe(Number()), "rays": Maybe(Number())})),
        **dict.fromkeys(("peak_memory_gb", "radiance_scale"), Number()),
        "hints": Items(
            Fields(
                {
                    "name": str,
                    "triangles": Number(low=0, whole=True),
                    **dict.fromkeys(("roughness", "metallic"), Maybe(_SHARE)),
                    "emits": Maybe(bool),
                    "left_alone": bool,
                }
            )
        ),
    }
)

ATLAS = Fields(
    {
        "mode": Choice("uv", "color_attribute"),
        "images": Items(
            Fields(
                {"name": FileName(), **dict.fromkeys(("width", "height"), Number(1, MOST_SIDE, whole=True))}
            )
        ),
    },
    {"apart": bool},
)
TEXTURES = Fields(
    {
        "images": Items(
            Fields(dict.fromkeys(("name", "base_color", "roughness", "metallic", "confidence"), str))
        )
    },
    {
        "uniform": Items(
            Fields({"part": str, "base_color": Numbers(3), "roughness": _SHARE, "metallic": _SHARE})
        )
    },
)
MAPS = Fields(
    {"views": Items(Fields(dict.fromkeys(("view", "base_color", "roughness", "metallic", "emission"), str)))}
)
RENDERS = Fields({"renders": Items(Fields(dict.fromkeys(("kind", "view", "image"), str)))})
CHECK = Fields(
    optional={
        "exposure": Number(),
        "views": Items(
            Fields(
                dict.fromkeys(("view", "split", "render", "error"), str), {"spp": Number(), "denoised": bool}
            )
        ),
    }
)
SURVEY = Fields(
    {
        "views": Items(
            Fields(
                {
                    **dict.fromkeys(("name", "warning"), str),
                    "image_missing": bool,
                    **dict.fromkeys(("room_share", "clipped_share"), Number()),
                },
                {"misfit": Maybe(_NOT_NEGATIVE)},
            )
        ),
        "parts": Fields({"auto": str, "counts": Entries(Number(low=0, whole=True))}),
        "missing": Items(Fields({"low": Numbers(3), "high": Numbers(3)})),
    }
)

ALIGN = Fields(
    {
        "candidates": Items(
            Fields({"similarity": Numbers(4, 4), "error": _NOT_NEGATIVE, "inliers": Number(0.0, 1.0)})
        ),
        "text": str,
        "poses": Entries(Numbers(4, 4)),
    }
)

# Array files: the kind of an array's numbers ("f" float, "i" whole, "b" bool), and its sizes: a number, or a
# letter for any size, which is the same for all arrays of a file that have this letter.
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
    "disagreement": ("f", ("T",)),
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
    "detail_median": ("f", ("U", 3)),
    "detail_width": ("f", ()),
    "detail_keys": ("i", ("N",)),
    "detail_sums": ("f", ("N", 9)),
}
PARTS_ARRAYS: dict[str, Layout] = {"triangle_part": ("i", ("T",)), "single": ("b", ("U",))}
RESOLUTION_ARRAYS: dict[str, Layout] = {"density": ("f", ("T",))}
LEFT_ALONE_ARRAYS: dict[str, Layout] = {"left_alone": ("b", ("T",))}
