"""Parts: which triangles have the same material, for the regularisation of roughness and metallic.

They come from the mesh's objects or material slots, or from id images, which are fused onto the triangles by
majority so that all views agree (paper, supplementary "Semantic segmentation acquisition"). Chosen
automatically, masks only divide the slots or objects of a modelled mesh further (:mod:`.modelled_parts`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.ndimage import maximum_filter, minimum_filter

from ..capture.views import View
from ..pixels.grouped import numbered, strongest, summed_by_key
from ..surface.adjacency import weld
from ..surface.room import Room
from .components import mesh_components
from .modelled_parts import corners_within, divided_surfaces, mesh_surfaces
from .segments import scan_segments
from .smooth_parts import Votes, smooth_labels
from .spreading import NO_PART, spread_labels

# Sources that are id images, one for each photograph.
IMAGE_SOURCES = ("masks", "semantics")
_IDS = 1 << 32  # larger than any id
# Weight of pixels at borders of masks: the borders of a scan or of slots may be about a pixel away from them.
BORDER_VOTE = 0.1


@dataclass(frozen=True)
class Parts:
    """The part of each triangle.

    Attributes:
        triangle_part: (T,) int32 from 0, NO_PART without one.
        kind: ``part`` (one material each), ``semantic`` (classes, each of several materials) or ``none``.
        ids: (P,) int64 id of each part in the masks, if parts come from masks; else empty. Parts share an id
            where the mesh divides the region of a mask; those that no mask shows have NO_PART.
    """

    triangle_part: np.ndarray
    kind: str
    ids: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))


def choose_parts(room: Room, views: Sequence[View], triangles: Sequence[np.ndarray]) -> Parts:
    """Parts from the source that room.json names; ``auto`` takes the finest available one.

    Args:
        triangles: for each view the (H * W,) triangle that each pixel sees, negative where none.
    """
    return source_parts(room, choose_source(room, views), views, triangles)


def source_parts(room: Room, source: str, views: Sequence[View], triangles: Sequence[np.ndarray]) -> Parts:
    """As :func:`choose_parts`, parts from one source of :func:`label_parts`."""
    # A generator: all images together may not fit into memory.
    images = (view.part_ids() if source == "masks" else view.semantic_ids() for view in views)
    return label_parts(room, source, images, triangles)


def surface_labels(room: Room, parts: Parts) -> np.ndarray:
    """(T,) int32 part of each triangle; where parts are unknown, label and connected piece."""
    if parts.kind == "part":
        return parts.triangle_part
    return numbered([parts.triangle_part, room_pieces(room)]).astype(np.int32)


def usable_sources(room: Room, views: Sequence[View]) -> list[str]:
    """The sources that distinguish any surfaces, in the order in which ``auto`` prefers them."""
    usable = {
        "masks": any(view.parts for view in views),
        "semantics": any(view.semantics for view in views),
        "materials": len(np.unique(room.triangle_material)) > 1,
        "objects": len(np.unique(room.triangle_object[~room.closing])) > 1,
    }
    return [source for source, is_usable in usable.items() if is_usable]


def choose_source(room: Room, views: Sequence[View]) -> str:
    """The source that room.json names, with ``auto`` resolved; semantics or none where masks are missing."""
    usable = usable_sources(room, views)
    source = room.parts
    if source == "auto":
        return automatic_source(room, usable)
    if source == "masks" and "masks" not in usable:
        source = "semantics"
    return "none" if source == "semantics" and "semantics" not in usable else source


def automatic_source(room: Room, usable: Sequence[str]) -> str:
    """The source that ``auto`` selects among :func:`usable_sources`.

    Loose pieces are never chosen, because scans contain many fragments that are not parts. For a scan, only
    masks are chosen: its materials are pages of a texture, and its objects tiles, or panes that were added.
    """
    return next((name for name in usable if name in IMAGE_SOURCES or room.scan is None), "none")


def mesh_borders(room: Room, source: str) -> np.ndarray | None:
    """(T,) int64 slot or object of each triangle, which the source `masks` divides further; None if the mesh
    has none, or if the user chose `masks` as the only source.
    """
    return mesh_surfaces(room) if source == "masks" and room.parts == "auto" else None


def label_parts(
    room: Room, source: str, images: Iterable[np.ndarray | None], triangles: Iterable[np.ndarray]
) -> Parts:
    """Parts from one source.

    Args:
        source: masks, semantics, materials, objects, loose or none. Masks divide the slots of a
            modelled mesh if room.parts is ``auto``, and count alone if it is ``masks``.
        images: for masks and semantics the id image of each view, or None; not used for other sources.
        triangles: for each view the triangle that each pixel of its id image sees, negative where none.
    """
    if source == "objects":
        # Triangles that close a hole belong to the object around it.
        known = np.where(room.closing, NO_PART, room.triangle_object)
        spread = spread_labels(known, weld(room.vertices)[room.triangles]) if room.closing.any() else known
        return Parts(spread.astype(np.int32), "part")
    if source == "materials":
        return Parts(_compact(room.triangle_material), "part")
    if source == "loose":
        return Parts(room_pieces(room), "part")
    own = mesh_borders(room, source)
    if own is not None:
        ids = divided_surfaces(room, own, count_votes(images, triangles, BORDER_VOTE))
        part = numbered([own, ids])
        return Parts(part.astype(np.int32), "part", ids[np.unique(part, return_index=True)[1]])
    if source in IMAGE_SOURCES:
        spread = _fused_labels(room, images, triangles)
        kind = "part" if source == "masks" else "semantic"
        return Parts(_compact(spread), kind, np.unique(spread[spread >= 0]))
    return Parts(np.full(len(room.triangles), NO_PART, np.int32), "none")


def _fused_labels(
    room: Room, images: Iterable[np.ndarray | None], triangles: Iterable[np.ndarray]
) -> np.ndarray:
    """(T,) int64 id of each triangle, negative without, by its pixels; on a scan also by those around it."""
    count = len(room.triangles)
    scan = room.scan
    if scan is None:
        fused = fuse_masks(images, triangles, count)
    else:
        votes = count_votes(images, triangles, BORDER_VOTE)
        fused = smooth_labels(votes, scan.mesh, scan.cross)
    return spread_labels(fused, weld(room.vertices)[room.triangles])


def room_pieces(room: Room) -> np.ndarray:
    """(T,) int32 connected piece of each triangle of a room; on a scan, segments take the place of pieces.

    Takes seconds for millions of triangles.
    """
    scan, exact = room.scan, room.exact
    if scan is not None:
        segments = scan_segments(scan.mesh, scan.cross, room.plane).astype(np.int32)
        if exact is None:
            return segments
    # A piece never extends over several objects.
    corners = corners_within(weld(room.vertices)[room.triangles], room.triangle_object)
    loose = mesh_components(corners).astype(np.int32)
    if scan is None or exact is None:
        return loose
    return numbered([np.where(exact, loose, segments), exact]).astype(np.int32)


def fuse_masks(masks: Iterable[np.ndarray | None], triangles: Iterable[np.ndarray], count: int) -> np.ndarray:
    """The id that most pixels of each triangle have.

    Args:
        masks, triangles: as of :func:`count_votes`.
        count: number of triangles.

    Returns:
        (count,) int64 ids, NO_PART where no labelled pixel saw the triangle. Ties go to the lower id.
    """
    votes = count_votes(masks, triangles)
    return strongest(votes.triangle, votes.label, votes.weight, count)


def count_votes(
    masks: Iterable[np.ndarray | None], triangles: Iterable[np.ndarray], border_vote: float = 1.0
) -> Votes:
    """How many pixels of each id see each triangle.

    Args:
        masks: (H, W) int ids of each view, or None; negative ids and 0 (nothing hit) do not count.
        triangles: for each view the (H * W,) triangle that each pixel sees, negative where none.
        border_vote: weight of pixels that are adjacent to another id.
    """

    def views() -> Iterator[tuple[np.ndarray, np.ndarray]]:
        for mask, triangle in zip(masks, triangles, strict=True):
            if mask is None:
                continue
            ids = mask.reshape(-1).astype(np.int64)
            valid = (ids > 0) & (triangle >= 0)
            weight = np.ones(int(valid.sum()))
            if border_vote < 1.0:
                weight[at_border(mask).reshape(-1)[valid]] = border_vote
            yield triangle[valid].astype(np.int64) * _IDS + ids[valid], weight

    key, votes = summed_by_key(views())
    return Votes(key // _IDS, key % _IDS, votes)


def at_border(mask: np.ndarray) -> np.ndarray:
    """(H, W) bool, pixels with another id among the eight beside them."""
    return np.asarray(maximum_filter(mask, 3) != minimum_filter(mask, 3))


def _compact(labels: np.ndarray) -> np.ndarray:
    """(T,) int32 labels numbered from 0 without gaps; negative ones become NO_PART."""
    compact = np.full(len(labels), NO_PART, np.int32)
    known = labels >= 0
    compact[known] = np.unique(labels[known], return_inverse=True)[1]
    return compact
