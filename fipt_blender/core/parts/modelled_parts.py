"""Parts of a modelled mesh from its slots or objects, and from masks.

The mesh decides borders and names. Masks divide a slot further where the votes of all views agree: into whole
flat pieces first; inside a flat piece only where a region is too large for the error of a misplaced mask.
"""

from __future__ import annotations

import numpy as np

from ..pixels.grouped import numbered, pairs_of, strongest
from ..surface.adjacency import face_vectors, make_mesh
from ..surface.room import Room
from .components import graph_components, mesh_components
from .smooth_parts import Votes
from .spreading import NO_PART, spread_labels

# A flat piece has one part if one id has this share of its votes.
WHOLE = 0.9
# A piece, or a region inside one, gets an id that has this share of its votes.
AGREED = 0.7
# Least votes (pixels away from borders) of a piece, or of a region inside one, that gets an id of its own;
# least share of the votes of its piece that a region has.
LEAST_VOTES, LEAST_SHARE = 20.0, 0.05
# Angle (radians) between normals at which a flat piece ends.
FLAT = 0.1


def mesh_surfaces(room: Room) -> np.ndarray | None:
    """(T,) int64 from 0, the slot's material of each triangle or, without one, its object.

    None where the mesh distinguishes nothing, and of a scan, whose materials are pages of a texture.
    """
    if room.scan is not None:
        return None
    material = room.triangle_material.astype(np.int64)
    if len(np.unique(material)) < 2:
        material = np.full(len(material), -1)
    own = numbered([material, np.where(material < 0, room.triangle_object, -1)])
    return own if own.max(initial=0) > 0 else None


def divided_surfaces(room: Room, own: np.ndarray, votes: Votes) -> np.ndarray:
    """(T,) int64 id of each triangle; a part is the triangles of one id on one surface of the mesh.

    Args:
        own: (T,) int64 surfaces of `mesh_surfaces`.
        votes: of the pixels, those at borders of masks with little weight.

    Returns:
        ids, NO_PART on surfaces that no pixel votes about.
    """
    mesh, _ = make_mesh(room.vertices, room.triangles)
    normals, _ = face_vectors(mesh.vertices, mesh.triangles)
    one, other = mesh.dual_edges.T
    cosine = (normals[one] * normals[other]).sum(axis=1)
    same = own[one] == own[other]
    flat = graph_components(mesh.dual_edges[same & (cosine > np.cos(FLAT))], len(own))
    connected = mesh_components(corners_within(mesh.triangles, own))
    label = _inside(flat, mesh.triangles, votes)
    for piece, least in ((flat, LEAST_VOTES), (connected, LEAST_VOTES), (own, 0.0)):
        best, share, total = strongest_votes(piece, votes)
        known = (total >= least) & (share >= (AGREED if least else 0.0))
        label = np.where(label < 0, np.where(known, best, NO_PART)[piece], label)
    return label


def _inside(piece: np.ndarray, triangles: np.ndarray, votes: Votes) -> np.ndarray:
    """(T,) int64 ids inside the flat pieces (T,) that masks divide, NO_PART elsewhere."""
    every = np.arange(len(piece))
    _, whole, total = strongest_votes(piece, votes)
    own = strongest_votes(every, votes)[0]
    region = numbered([piece, own])
    best, share, voted = strongest_votes(region, votes)
    large = voted[region] >= np.maximum(LEAST_VOTES, LEAST_SHARE * total[piece])
    divided = (whole < WHOLE)[piece] & large & (share[region] >= AGREED) & (own == best[region]) & (own >= 0)
    regions = np.unique(np.stack([piece, own])[:, divided], axis=1)
    several = np.bincount(regions[0], minlength=len(total)) > 1
    label = np.where(divided & several[piece], own, NO_PART)
    return spread_labels(label, corners_within(triangles, piece))


def corners_within(triangles: np.ndarray, surface: np.ndarray) -> np.ndarray:
    """(T, 3) vertices, different ones for each surface (T,): only triangles of one surface are neighbours."""
    keys = triangles.astype(np.int64) + surface.astype(np.int64)[:, None] * (
        int(triangles.max(initial=0)) + 1
    )
    return np.unique(keys, return_inverse=True)[1].reshape(-1, 3)


def strongest_votes(piece: np.ndarray, votes: Votes) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(P,) id with most votes in each piece (T,), the lower of equals, its share of them, and their sum."""
    count = int(piece.max(initial=-1)) + 1
    of, label, place = pairs_of(piece[votes.triangle], votes.label)
    weight = np.bincount(place, votes.weight, minlength=len(of))
    total, most = np.bincount(of, weight, minlength=count), np.zeros(count)
    np.maximum.at(most, of, weight)
    return strongest(of, label, weight, count), most / np.maximum(total, 1e-30), total
