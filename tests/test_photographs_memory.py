# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Memory of merging: 24 megapixels within 2 GB, shown on small photographs by the bytes of each pixel."""

from __future__ import annotations

import argparse
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from benchmarks.dng import Shot, mosaic_of, write_dng
from fipt_blender.core.photographs import command, frames, merge_step, merging
from fipt_blender.core.run.messages import Reporter

HEIGHT, WIDTH, EXPOSURES = 400, 600, 5
# 2 GB less the process itself (0.25 GB), over 24 million pixels. Half floats and flags of the exposures are
# 45 of these bytes, the result is 16. Measured: 68, with motion 69. One more copy of an exposure takes 6.
MOST_BYTES = 72.9


@pytest.mark.parametrize("shift", [0, 3])
def test_merging_five_large_photographs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shift: int) -> None:
    # The bands of rows and the grid of what has moved in the proportion of 24 megapixels.
    monkeypatch.setattr(frames, "LARGE_PIXELS", HEIGHT * WIDTH // 2)
    for module in (frames, merging):
        monkeypatch.setattr(module, "BAND_ROWS", 128 * HEIGHT // 4000)
    monkeypatch.setattr(merging, "GHOST_SIDE", merging.GHOST_SIDE * WIDTH // 6000)
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
    for index in range(EXPOSURES):
        moved = x + shift * index
        plane = 0.02 + 0.2 * (0.5 + 0.5 * np.sin(moved / 15.0) * np.cos(y / 10.0))
        light = np.repeat(plane[..., None] * 2.0 ** (index - 2), 3, -1)
        values = np.clip(mosaic_of(light) * 16000.0 + 256.0, 0, 16383).astype(np.uint16)
        shot = Shot(0.01 * 2.0 ** (index - 2), time=f"2026:05:01 12:00:0{index}")
        write_dng(tmp_path / "in" / f"{index}.dng", values, shot, 256, 16383)
    settings = ["working_width=0", f"align={'true' if shift else 'false'}"]
    capture = tmp_path / "out"

    def run(steps: str) -> None:
        options = argparse.Namespace(photographs=tmp_path / "in", run=capture, steps=steps, set=settings)
        command.run(options, Reporter())

    run("read")
    del y, x, moved, plane, light, values
    peaks = []
    merged = merge_step.merged_group

    def measured(*arguments: object) -> object:
        tracemalloc.start()
        try:
            return merged(*arguments)
        finally:
            peaks.append(tracemalloc.get_traced_memory()[1])
            tracemalloc.stop()

    monkeypatch.setattr(merge_step, "merged_group", measured)
    run("merge")
    assert peaks[0] / (HEIGHT * WIDTH) < MOST_BYTES
