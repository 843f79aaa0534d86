"""The room of an estimation as a list of stages (:mod:`..run.chain`), and the chain of them on a run folder.

A scan is cleaned, photographs and mesh are compared, and what the scan lacks is added; masks get ids that all
views share, and vertices move to the outlines of parts. An exact mesh stays as it is.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..capture.views import Capture, View
from ..checks.consensus import check_input
from ..completion.panes import Completion, find_lacking
from ..parts.linked_masks import link_masks, with_masks
from ..parts.outlines import outline_parts
from ..run.chain import Chain, Given, Stage, Tools
from ..run.made import content_digest, file_stamp
from ..run.messages import Reporter
from ..run.method import digest
from ..run.run_files import AddedSurfaces, Geometry, RoomMesh, ScanArrays, read_exported, scan_arrays
from ..run.runfolder import RunFolder
from ..run.settings import Settings
from ..run.stage_settings import CompletionSettings, Forced
from ..surface.cleaning import Holes, clean_room
from ..surface.room import Room, make_room

# Time of an estimation after the room was made, in that of the stages here, for progress.
AFTERWARDS = 16.0


@dataclass(frozen=True, eq=False)
class CompletedScan:
    """The outputs that `complete` needs."""

    scan: ScanArrays | None


@dataclass(frozen=True, eq=False)
class PreparedRoom:
    """The outputs with which an estimation begins.

    Attributes:
        room: with what was added to a scan, its vertices on the outlines of parts.
        views: with part masks whose ids all of them share.
        far_off: correlation with the others of views whose poses are far off, by their index.
        scan: for results/scan.npz; None for an exact mesh.
        holes: small ones of a scan; None without.
    """

    room: Room
    views: list[View]
    far_off: Mapping[str, float]
    scan: ScanArrays | None
    holes: Holes | None


def room_stages(whole: bool = True) -> Iterator[Stage]:
    """The stages in order.

    Args:
        whole: False: none after the search of what a scan lacks.
    """
    yield Stage("cleaning", clean_room, "Cleaning the mesh", 0.1)
    yield from _room("cleaned")
    yield Stage("relation", check_relation, "Comparing the photographs with the mesh", 0.2, "far_off")
    yield Stage("completion", complete_scan, "Looking for what the mesh lacks", 0.5)
    yield from _room("completed")
    if whole:
        yield Stage("linking", link_views, "Linking the masks of the views", 0.1, "linked")
        yield Stage("linked-views", linked_views, gives="views")
        yield Stage("outlines", outline_parts, "Following the outlines of parts", 0.1, "outlined")
        yield from _room("outlined")


def room_chain(
    run: RunFolder,
    settings: Settings,
    capture: Capture,
    views: Sequence[View],
    reporter: Reporter,
    whole: bool,
) -> Chain:
    """The stages on a run folder; what the room is made of is known by content.

    Args:
        capture: the folder's.
        views: training views that are used, at the resolution of light.
        whole: see `room_stages`.
    """
    own_mesh = capture.mesh == run.fused_ply  # made from the rig itself
    cameras = np.array([view.camera_to_world[:3, 3] for view in capture.views])
    given = {
        "mesh": Given(read_exported(run), content_digest(run.room_npz, run.room_json)),
        "views": Given(list(views), views_key(settings, views)),
        "cameras": Given(cameras, digest(cameras.tolist())),
        "own_mesh": Given(own_mesh, str(own_mesh)),
        "capture_format": Given(capture.source, capture.source),
    }
    afterwards = AFTERWARDS if whole else 0.0
    return Chain(list(room_stages(whole)), given, settings, run.scan, reporter, afterwards=afterwards)


def views_key(settings: Settings, views: Sequence[View]) -> str:
    """A hash of views and of the device on which they are used.

    Of their files, size and time of change are hashed: reading all of them takes too long.
    """
    files = ("image", "parts", "semantics", "mask")
    facts = [
        [
            *(view.name, view.width, view.height, view.intrinsics.tolist(), view.camera_to_world.tolist()),
            *(view.encoded, view.exposure, view.panorama, view.full),
            *(file_stamp(getattr(view, file)) for file in files),
        ]
        for view in views
    ]
    return digest(settings.device, facts)


def _room(name: str) -> Iterator[Stage]:
    """The room as it is now: the stages' outputs so far, together."""
    yield Stage(f"{name}-scan", scan_so_far, gives="scan")
    yield Stage(f"{name}-room", room_so_far, gives="room")


def scan_so_far(
    mesh: RoomMesh,
    cleaned: Geometry | None,
    closing: AddedSurfaces | None,
    panes: AddedSurfaces | None = None,
    plane: np.ndarray | None = None,
    outlined: np.ndarray | None = None,
) -> ScanArrays | None:
    """What the stages have made of a scan; None for an exact mesh."""
    if cleaned is None:
        return None
    if panes is not None and plane is not None:
        cleaned = Geometry(
            np.concatenate([cleaned.vertices, panes.vertices.astype(np.float32)]),
            np.concatenate([cleaned.corner_normals, panes.corner_normals.astype(np.float32)]),
            np.concatenate([cleaned.plane, plane]),
            cleaned.noise,
        )
    if outlined is not None:
        cleaned = replace(cleaned, vertices=outlined)
    return scan_arrays(mesh, closing, panes, cleaned)


def room_so_far(mesh: RoomMesh, scan: ScanArrays | None, cameras: np.ndarray | None = None) -> Room:
    """The room of a mesh and of what was made of it; `cameras`: (C, 3) positions, metres."""
    return make_room(mesh if scan is None else scan.whole(mesh), cameras)


def check_relation(
    room: Room, views: list[View], own_mesh: bool, capture_format: str, *, settings: Forced
) -> dict[str, float]:
    """`PreparedRoom.far_off`."""
    found = check_input(room, views, settings, own_mesh, capture_format)
    return {str(index): value for index, value in found.items()}


def complete_scan(
    mesh: RoomMesh, room: Room, views: list[View], *, settings: CompletionSettings, tools: Tools
) -> Completion:
    """What the scan lacks; see `find_lacking`."""
    return find_lacking(mesh, room, views, tools.folder / "linked", settings, tools.reporter.progress)


def link_views(
    room: Room, views: list[View], linked: Mapping[str, str] | None, *, tools: Tools
) -> dict[str, str]:
    """Files of linked masks by the views' names, relative to the folder of all stages.

    Args:
        linked: of `Completion`, if nothing was added after that.
    """
    if linked is not None:
        return {name: f"completion/linked/{file}" for name, file in linked.items()}
    files = link_masks(room, views, tools.folder / "linked")
    return {name: path.relative_to(tools.folder.parent).as_posix() for name, path in files.items()}


def linked_views(views: list[View], linked: Mapping[str, str], *, tools: Tools) -> list[View]:
    """The views with linked masks."""
    return with_masks(views, {name: Path(tools.folder.parent, file) for name, file in linked.items()})
