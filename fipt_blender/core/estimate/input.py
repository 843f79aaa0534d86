"""The input of an estimation: the views at the resolution of light, and the room of :mod:`.room_stages`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..capture.views import View, decoded, light_views, load_capture
from ..run.chain import Chain, Given, Stage
from ..run.errors import FiptError
from ..run.hints import hints_digest, light_changes, read_hints, references
from ..run.light_size import LightPlan, light_plan, refuse_full_disk
from ..run.messages import Reporter
from ..run.per_view import Workers
from ..run.runfolder import RunFolder
from ..run.settings import Settings
from .pipeline import pipeline, round_numbers
from .room_stages import PreparedRoom, room_chain, views_key

AVERAGING = 0.01  # share of an estimation's time that averaging the photographs takes, for progress
# The user is told of a mesh that is longer than what surrounds the cameras by this factor.
MUCH_WIDER = 1.5


@dataclass(frozen=True, eq=False)
class EstimationInput:
    """What an estimation starts from.

    Attributes:
        folder: the run's.
        settings: of the run.
        plan: at which resolution the views are, and the expected cost.
        prepared: the room.
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
    prepared: PreparedRoom
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
    """
    capture = load_capture(folder)
    photographs = spread_views(capture.train, settings.view_share)
    if not photographs:
        raise FiptError("views-none.prepare-input")
    plan = light_plan([(view.width, view.height) for view in photographs], settings)
    reporter.note(f"{plan.resolution}; {plan.cost}")
    reporter.plan([AVERAGING, 1.0 - AVERAGING], plan.seconds)
    if not settings.force:
        refuse_full_disk(folder.stage, plan.bytes, "choose a lower preset, or fewer light_pixels")
    chain = room_chain(folder, settings, capture, averaged(photographs, settings, reporter), reporter, True)
    prepared = chain.run(PreparedRoom)
    if prepared.holes is not None:
        reporter.note(prepared.holes.text)
    room = prepared.room
    inner, every = (float(np.ptp(bounds, axis=0).max()) for bounds in (room.bounds, room.mesh_bounds))
    if every > MUCH_WIDER * inner:
        reporter.warning("mesh-far", every=every, inner=inner)
    again = folder.hints_again_json.exists()
    hints, rerun = read_hints(folder.hints_json), read_hints(folder.hints_again_json)
    known, held_back, views = references(rerun if again else hints), capture.held_back, prepared.views
    far_off = {int(index): value for index, value in prepared.far_off.items()}
    values = {
        "room": Given(prepared.room, chain.key("room")),
        "views": Given(views, chain.key("views")),
        "far_off": Given(far_off, chain.key("far_off")),
        "held_back": Given(held_back, views_key(settings, held_back)),
        "hints": Given(hints, hints_digest(hints)),
        "hints_rerun": Given(rerun, hints_digest(rerun)),
        "references": Given(known, hints_digest(known)),
        **{name: Given(index, str(index)) for name, index in round_numbers(settings.rounds).items()},
    }
    encoded, light = any(view.encoded for view in views), light_changes(folder.hints_again_json)
    stages = pipeline(settings.rounds, encoded, again, light, bool(held_back))
    return EstimationInput(folder, settings, plan, prepared, stages, values)


def averaged(photographs: Sequence[View], settings: Settings, reporter: Reporter) -> list[View]:
    """The views at the resolution of light; their photographs are averaged now."""
    views = light_views(photographs, settings.light_pixels)
    if smaller := [view for view in views if view.full]:
        reporter.stage("light", "Averaging the photographs to the resolution of light")
        for done, _ in enumerate(decoded(View.radiance, smaller), 1):
            reporter.progress(done / len(smaller))
    return views


def spread_views(views: Sequence[View], share: float) -> list[View]:
    """A share of the views (0 to 1, one of any at least), spread evenly over their order."""
    count = min(max(1, round(share * len(views))), len(views))
    return [views[i * len(views) // count] for i in range(count)]
