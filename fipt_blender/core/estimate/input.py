# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The input of an estimation: the views at the resolution of light, and the room as photographs complete it.

Each step keeps its files in the run folder and does nothing where they fit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from ..capture.views import Capture, View, decoded, light_views, load_capture
from ..checks.consensus import check_input
from ..completion.panes import close_holes
from ..parts.linked_masks import link_masks
from ..parts.outlines import outline_parts
from ..run.chain import Chain, Given, Stage
from ..run.errors import FiptError
from ..run.hints import hints_digest, light_changes, read_hints, references
from ..run.light_size import LightPlan, light_plan, refuse_full_disk
from ..run.made import content_digest, file_stamp
from ..run.messages import Reporter
from ..run.method import digest
from ..run.per_view import Workers
from ..run.run_files import AddedSurfaces, read_closing
from ..run.runfolder import RunFolder
from ..run.settings import Settings
from ..run.stage_settings import RoomSettings, ViewSettings, chosen
from ..surface.room import Room, load_room
from ..surface.stored import prepare_geometry
from .pipeline import pipeline, round_numbers

# Shares of an estimation's time that averaging the photographs and completing a scan take, for progress.
PREPARATION = (0.01, 0.05)
# The user is told of a mesh that is longer than what surrounds the cameras by this factor.
MUCH_WIDER = 1.5


@dataclass(frozen=True, eq=False)
class EstimationInput:
    """What an estimation starts from.

    Attributes:
        folder: the run's.
        settings: of the run.
        plan: at which resolution the views are, and the expected cost.
        holes: of a scan; None for an exact mesh.
        stages: of the estimation.
        values: that they start from, by name: `room`, with what closes holes of a scan, and the outlines that
            masks show; `views` that are used, at the resolution of light, with part masks whose ids all of
            them share; `held_back`, views at full size that no stage but the judgement uses; `far_off`, views
            whose poses are far off, and their correlation with the others; `hints`; `hints_rerun`, which the
            hinted stages honour instead; `references`, those of either that tell of the light.
    """

    folder: RunFolder
    settings: Settings
    plan: LightPlan
    holes: AddedSurfaces | None
    stages: Sequence[Stage]
    values: Mapping[str, Given]

    def chain(self, reporter: Reporter, workers: Workers | None = None) -> Chain:
        """The stages on the run folder."""
        return Chain(self.stages, self.values, self.settings, self.folder.stage, reporter, workers)


def prepare_input(folder: RunFolder, settings: Settings, reporter: Reporter) -> EstimationInput:
    """Prepare the input; takes minutes for a scan. Mitsuba's variant must be set.

    Args:
        folder: holds capture.json and room.npz.
        reporter: gets the plan, stages and progress.

    Raises:
        FiptError: ``views-none``, ``disk-space`` unless forced, where the capture or the room can't be read,
            and those of `check_input`.
    """
    capture = load_capture(folder)
    photographs = spread_views(capture.train, settings.view_share)
    if not photographs:
        raise FiptError("views-none.prepare-input")
    plan = light_plan([(view.width, view.height) for view in photographs], settings)
    reporter.note(f"{plan.resolution}; {plan.cost}")
    reporter.plan([*PREPARATION, 1.0 - sum(PREPARATION)], plan.seconds)
    if not settings.force:
        refuse_full_disk(folder.stage, plan.bytes, "choose a lower preset, or fewer light_pixels")
    views, room, far_off, holes = completed_room(folder, settings, capture, reporter)
    # Outlines depend on the linked masks, not the reverse, so that a resumed run keeps both.
    views = link_masks(folder, room, views)
    if outline_parts(folder, views if settings.outlines else [], room):
        room = load_room(folder)
    inner, every = (float(np.ptp(bounds, axis=0).max()) for bounds in (room.bounds, room.mesh_bounds))
    if every > MUCH_WIDER * inner:
        reporter.warning("mesh-far", every=every, inner=inner)
    again = folder.hints_again_json.exists()
    hints, rerun = read_hints(folder.hints_json), read_hints(folder.hints_again_json)
    known, held_back = references(rerun if again else hints), capture.held_back
    key = input_key(folder, settings, views)
    values = {
        "room": Given(room, key),
        "views": Given(views, key),
        "far_off": Given(far_off, key),
        "held_back": Given(held_back, input_key(folder, settings, held_back)),
        "hints": Given(hints, hints_digest(hints)),
        "hints_rerun": Given(rerun, hints_digest(rerun)),
        "references": Given(known, hints_digest(known)),
        **{name: Given(index, str(index)) for name, index in round_numbers(settings.rounds).items()},
    }
    encoded, light = any(view.encoded for view in views), light_changes(folder.hints_again_json)
    stages = pipeline(settings.rounds, encoded, again, light, bool(held_back))
    return EstimationInput(folder, settings, plan, holes, stages, values)


def input_key(folder: RunFolder, settings: Settings, views: Sequence[View]) -> str:
    """A hash of what the room and the views are made from.

    Of photographs size and time of change are hashed: reading all of them takes too long.
    """
    content = content_digest(folder.capture_json, folder.room_npz, folder.room_json)
    states = [file_stamp(path) for view in views for path in view.files]
    read = [asdict(chosen(settings, RoomSettings)), asdict(chosen(settings, ViewSettings))]
    return digest(content, states, *read, settings.device)


def completed_room(
    folder: RunFolder, settings: Settings, capture: Capture, reporter: Reporter
) -> tuple[list[View], Room, dict[int, float], AddedSurfaces | None]:
    """The views at the resolution of light, the room with what its scan lacks, without outlines, views that
    are far off and the holes; the last two as of `EstimationInput`.

    Args:
        capture: the folder's; with training views.

    Raises:
        FiptError: where the room can't be read, and those of `check_input`.
    """
    prepare_geometry(folder, settings.clean_scan, settings.close_holes_edges)
    holes = read_closing(folder)
    views = light_views(spread_views(capture.train, settings.view_share), settings.light_pixels)
    if smaller := [view for view in views if view.full]:
        reporter.stage("light", "Averaging the photographs to the resolution of light")
        for done, _ in enumerate(decoded(View.radiance, smaller), 1):
            reporter.progress(done / len(smaller))
    room = load_room(folder, outlined=False)
    own_mesh = capture.mesh == folder.fused_ply  # made from the rig itself
    far_off = check_input(room, views, settings, own_mesh, capture.source)
    if folder.geometry_npz.exists():
        text = "Looking for what the scan lacks"  # takes minutes
        reporter.stage("scan", text if holes is None else f"{holes.text} {text}")
    if close_holes(folder, views, settings, room, reporter.progress):
        room = load_room(folder, outlined=False)
    return views, room, far_off, holes


def spread_views(views: Sequence[View], share: float) -> list[View]:
    """A share of the views (0 to 1, one of any at least), spread evenly over their order."""
    count = min(max(1, round(share * len(views))), len(views))
    return [views[i * len(views) // count] for i in range(count)]
