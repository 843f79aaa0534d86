"""Checks the photographs against each other: misaligned views are left out and exposures are corrected, with
warnings that name them.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from ..capture.views import View
from ..light.observations import median_footprint
from ..pixels.store import LEFT_OUT, PixelStore
from ..run.messages import Reporter
from ..run.stage_settings import CheckSettings
from ..surface.room import Room
from .consistency import ConsistencyTable
from .registration import FAR_OFF, misaligned_views

# Exposures that differ by less than this factor are not corrected: highlights cause differences of this size.
SAME_EXPOSURE = 1.06


@dataclass(frozen=True)
class ViewCheck:
    """What the check found and corrected.

    Attributes:
        left_out: name of each misaligned view, and its displacement in pixels, -1 if too large to measure.
        exposure: name of each view of another exposure, and the factor by which it was brighter.
    """

    left_out: dict[str, float] = field(default_factory=dict)
    exposure: dict[str, float] = field(default_factory=dict)

    def facts(self) -> dict[str, Any]:
        """For statistics.json."""
        return asdict(self)


def check_views(
    pixels: PixelStore,
    room: Room,
    part: np.ndarray,
    settings: CheckSettings,
    reporter: Reporter,
    far_off: Collection[int] = (),
) -> ViewCheck:
    """Leave misaligned views out of the pixels and bring the others to one exposure, as the settings allow.

    Args:
        pixels: changed in place: pixels of misaligned views become LEFT_OUT, radiance is divided by gains.
        part: (T,) int part of each triangle, negative without.
        far_off: indices of views whose poses are far off (:func:`.check_input`).
        reporter: gets the warnings ``view-misaligned`` and ``view-exposure``.

    Raises:
        FiptError: ``views-disagree`` where most would be left out.
    """
    check = ViewCheck()
    views = pixels.views
    if len(views) < 2:
        return check
    table = ConsistencyTable.of(pixels, room, median_footprint(pixels), part)
    gains = table.view_gains(far_off)[:, 0]
    if settings.reject_views and (fits := misaligned_views(table, gains, far_off, settings.force)):
        shifts = {i: -1.0 if fit is FAR_OFF else round(fit.shift, 1) for i, fit in fits.items()}
        check.left_out.update({views[i].name: shift for i, shift in shifts.items()})
        remarks = {
            i: "far off" if shift < 0.0 else f"about {shift:.0f} pixels off" for i, shift in shifts.items()
        }
        reporter.warning(
            "view-misaligned",
            number_of_fits=len(fits),
            number_of_views=len(views),
            describe=_describe(views, remarks),
        )
        for index in fits:
            pixels.triangle[pixels.rows(index)] = LEFT_OUT
            pixels.pure[pixels.rows(index)] = False
        gains = table.view_gains()[:, 0]
    unlike = np.flatnonzero(np.abs(np.log(gains)) > np.log(SAME_EXPOSURE))
    if settings.correct_exposure and len(unlike):
        check.exposure.update({views[i].name: round(float(gains[i]), 4) for i in unlike})
        remarks = {int(i): f"× {gains[i]:.2f}" for i in unlike}
        reporter.warning(
            "view-exposure",
            number_of_unlike=len(unlike),
            number_of_views=len(views),
            describe=_describe(views, remarks),
        )
        for index in unlike:
            pixels.radiance[pixels.rows(index)] /= np.float32(gains[index])
    return check


def _describe(views: Sequence[View], values: dict[int, str], most: int = 8) -> str:
    """Names of views, each with a remark, for a message; long lists are shortened."""
    listed = [f"{views[index].name} ({text})" for index, text in list(values.items())[:most]]
    if len(values) > most:
        listed.append(f"and {len(values) - most} more")
    return ", ".join(listed)
