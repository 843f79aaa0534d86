# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The progress of a job, from the expected times of its steps. Standard library only."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

_PRIOR_SECONDS = 30.0  # weight, against measured time, of the assumption that expected times are right


class JobProgress:
    """Fraction and remaining time of a job.

    Args:
        weights: expected time of each step in seconds, on a small machine.
        skipped: whether each step is left out.
    """

    def __init__(self, weights: Sequence[float], skipped: Sequence[bool]) -> None:
        self._weight_skipped = sum(weight for weight, skip in zip(weights, skipped, strict=True) if skip)
        self._weight_total = sum(weights) or 1.0
        self._weight_done = self._weight_skipped
        self._started = time.monotonic()
        self._memory_gb = 0.0

    def complete(self, weight: float) -> None:
        """Count a step with this weight as done."""
        self._weight_done += weight

    def note_memory(self, memory_gb: float) -> None:
        """Take an engine's peak memory in GB into account."""
        self._memory_gb = max(self._memory_gb, memory_gb)

    def message(self, weight: float, step_fraction: float, step_remaining: float | None) -> dict[str, Any]:
        """The message `progress` of the job.

        Args:
            weight: of the current step.
            step_fraction: share of the step that is done.
            step_remaining: remaining seconds of the step if known.
        """
        done = self._weight_done + weight * min(max(step_fraction, 0.0), 1.0)
        elapsed = time.monotonic() - self._started
        # Seconds per expected second on this machine; at first close to 1, as the first steps say little.
        pace = (elapsed + _PRIOR_SECONDS) / (done - self._weight_skipped + _PRIOR_SECONDS)
        after = self._weight_total - self._weight_done - weight
        current = weight * (1.0 - step_fraction) * pace if step_remaining is None else step_remaining
        return {
            "type": "progress",
            "fraction": round(done / self._weight_total, 4),
            "stage_fraction": round(step_fraction, 4),
            "remaining_seconds": round(current + after * pace, 1),
            "memory_gb": self._memory_gb,
        }
