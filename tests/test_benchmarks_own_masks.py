# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""benchmarks/own_masks.py: masks as of a network that sees one photograph at a time."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.own_masks import Faults, main, own_regions
from fipt_blender.core.capture.formats.registry import read_rig
from fipt_blender.core.capture.images import read_ids, write_exr
from fipt_blender.core.capture.options import CaptureOptions
from samples.capture_files import level_pose, write_fipt_synthetic

PARTS = np.zeros((60, 90), np.int64)
PARTS[5:55, 5:40] = 9  # two pieces of one part, of which one is larger
PARTS[5:30, 60:85] = 9
PARTS[30:55, 40:85] = 4
NONE = Faults(0.0, 0.0, 0.0, 0.0, 0.0)


def test_pieces_become_regions_by_size(rng: np.random.Generator) -> None:
    regions = own_regions(PARTS, NONE, rng)
    assert np.array_equal(regions > 0, PARTS > 0)
    assert [np.unique(PARTS[regions == number]).tolist() for number in (1, 2, 3)] == [[9], [4], [9]]
    sizes = np.bincount(regions.reshape(-1))[1:]
    assert len(sizes) == 3 and (np.diff(sizes) < 0).all()


def test_faults_are_as_frequent_as_asked(rng: np.random.Generator) -> None:
    blocks = np.arange(1, 401).reshape(20, 20).repeat(6, axis=0).repeat(6, axis=1)
    count = own_regions(blocks, NONE, rng).max()
    missed = own_regions(blocks, Faults(0.0, 0.0, 0.2, 0.0, 0.0), rng)
    cut = own_regions(blocks, Faults(0.3, 0.0, 0.0, 0.0, 0.0), rng)
    joined = own_regions(blocks, Faults(0.0, 0.1, 0.0, 0.0, 0.0), rng)
    assert count == 400
    # Three standard deviations of the binomial distribution.
    assert abs(missed.max() - 320) < 3 * np.sqrt(400 * 0.2 * 0.8)
    assert abs(cut.max() - 520) < 3 * np.sqrt(400 * 0.3 * 0.7)
    assert 360 <= len(np.unique(joined)) < 365


def test_borders_are_off_by_the_deviation(rng: np.random.Generator) -> None:
    halves = np.where(np.arange(400) < 200, 1, 2)[None].repeat(400, axis=0)
    first = own_regions(halves, Faults(0.0, 0.0, 0.0, 2.0, 0.0), rng) == own_regions(halves, NONE, rng)[0, 0]
    misses = first.sum(axis=1) - 200
    assert abs(misses.mean()) < 0.5 and 1.4 < misses.std() < 2.6


def test_only_masks_of_training_views_change(tmp_path: Path, rng: np.random.Generator) -> None:
    source, target = tmp_path / "source", tmp_path / "target"
    poses = [level_pose(rng, np.array([0.0, 1.0, 0.0])) for _ in range(3)]
    write_fipt_synthetic(source, {"train": poses[:2], "val": poses[2:]})
    views = read_rig(source, "auto", CaptureOptions()).views
    ids = np.ones((views[0].height, views[0].width))
    ids[:, ids.shape[1] // 2 :] = 5
    for split, name in (("train", "000_0001"), ("train", "001_0001"), ("val", "000_0001")):
        write_exr(source / split / "IndexMA" / f"{name}.exr", ids)
    assert main([str(source), "--output", str(target), "--cut", "0", "--joined", "0", "--missed", "0"]) == 0
    made = read_rig(target, "auto", CaptureOptions()).views
    assert [view.name for view in made] == [view.name for view in views]
    for view in made:
        assert view.parts is not None and view.image.resolve().is_relative_to(source.resolve())
        own = read_ids(view.parts)
        assert np.array_equal(own, ids) == (view.split != "train")


def test_the_largest_region_is_joined_to_its_largest_neighbour() -> None:
    """A wall, the ceiling and a small thing on the wall."""
    parts = np.ones((20, 20), int)
    parts[:6], parts[10:14, 10:14] = 2, 3
    regions = own_regions(parts, Faults(0.0, 0.0, 0.0, 0.0, 1.0), np.random.default_rng(0))
    assert regions[0, 0] == regions[19, 0] != regions[12, 12] and regions.max() == 2
