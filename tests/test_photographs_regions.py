# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Regions of photographs by Segment Anything models, on tiny models with random weights."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from fipt_blender.core.photographs import regions
from fipt_blender.core.photographs.masks_model import open_masks_model
from samples.refusals import error_of

transformers = pytest.importorskip("transformers")
from samples import mask_models  # noqa: E402

MEAN, STD = np.array([0.485, 0.456, 0.406]), np.array([0.229, 0.224, 0.225])


@pytest.fixture(scope="module", params=["sam", "sam2", "sam2_video"])
def model(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    network = getattr(mask_models, f"make_{request.param}")()
    return mask_models.write_sam(tmp_path_factory.mktemp("model"), network)


def picture(width: int, height: int) -> np.ndarray:
    coarse = np.random.default_rng(4).integers(0, 256, (height // 16, width // 16, 3), np.uint8)
    return coarse.repeat(16, axis=0).repeat(16, axis=1)


def overlap(one: np.ndarray, other: np.ndarray) -> float:
    return (one & other).sum() / (one | other).sum()


def agreement(ids: np.ndarray, others: np.ndarray) -> float:
    """Share of the pixels in the same regions, whatever their numbers; rounding may move single pixels."""
    pairs, counts = np.unique(np.stack([ids, others]).reshape(2, -1), axis=1, return_counts=True)
    return sum(counts[pairs[0] == number].max() for number in np.unique(pairs[0])) / ids.size


@pytest.mark.parametrize(("width", "height"), [(64, 48), (48, 64)])
def test_regions_are_the_confident_stable_and_distinct_masks_of_a_grid(
    model: Path, width: int, height: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One point after the other, each mask by itself, in a photograph that SAM takes without scaling."""
    monkeypatch.setattr(regions, "GRIDS", (32,))
    image = picture(width, height)
    ids = open_masks_model(model)(image)
    assert ids.shape == (height, width) and ids.dtype == np.int32
    stretched = "Sam2" in (model / "config.json").read_text(encoding="utf-8")
    name = "Sam2Model" if stretched else "SamModel"
    network = getattr(transformers, name).from_pretrained(model).eval()
    values = torch.from_numpy(((image / 255.0 - MEAN) / STD).astype(np.float32)).permute(2, 0, 1)[None]
    inner = (64, 64) if stretched else (height, width)
    square = torch.zeros(1, 3, 64, 64)
    square[..., : inner[0], : inner[1]] = torch.nn.functional.interpolate(
        values, inner, mode="bilinear", antialias=True
    )
    with torch.no_grad():
        embeddings = network.get_image_embeddings(square)
    found = []
    rows, columns = (32, 32) if stretched else (height // 2, width // 2)
    for row in range(rows):
        points = [
            [[(column + 0.5) / columns * inner[1], (row + 0.5) / rows * inner[0]]]
            for column in range(columns)
        ]
        with torch.no_grad():
            output = network(
                image_embeddings=embeddings, input_points=torch.tensor([points]), multimask_output=True
            )
        for logits, sure in zip(output.pred_masks[0].flatten(0, 1), output.iou_scores.flatten(), strict=True):
            full = torch.nn.functional.interpolate(logits[None, None], (64, 64), mode="bilinear")
            full = full[..., : inner[0], : inner[1]]
            coarse = logits.numpy()[: inner[0] // 4, : inner[1] // 4]
            stable = (coarse > 1.0).sum() / max((coarse > -1.0).sum(), 1)
            if sure > 0.88 and stable >= 0.9 and 0.0 < (coarse > 0.0).mean() < 0.95:
                shown = torch.nn.functional.interpolate(full, (height, width), mode="bilinear")[0, 0].numpy()
                found.append((float(sure), coarse > 0.0, shown > 0.0))
    found.sort(key=lambda item: -item[0])
    kept: list[tuple[float, np.ndarray, np.ndarray]] = []
    for item in found:
        if all(overlap(item[1], other[1]) <= 0.7 for other in kept):
            kept.append(item)
    assert len(found) > len(kept) > 2, "the model must find several regions"
    kept.sort(key=lambda item: -item[1].sum())
    expected = np.zeros((height, width), int)
    for number, (_, _, shown) in enumerate(kept, start=1):
        expected[shown] = number
    assert agreement(ids, expected) > 0.97 and len(np.unique(ids)) == len(np.unique(expected))


def test_regions_do_not_depend_on_the_size_of_the_photograph(
    model: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(regions, "GRIDS", (32,))  # random weights are sure of everything
    finder = open_masks_model(model)
    small = picture(64, 48)
    large = finder(small.repeat(4, axis=0).repeat(4, axis=1))
    assert np.array_equal(finder(small), finder(small))
    assert agreement(large[2::4, 2::4], finder(small)) > 0.8


def test_incomplete_models_are_refused(model: Path, tmp_path: Path) -> None:
    broken = mask_models.write_without_weight(tmp_path / "model", model, "iou_prediction_head")
    caught = error_of(open_masks_model, broken)
    assert caught.code == "model-unusable" and "missing" in caught.text


class SureNetwork:
    """Answers each point with the quarter of the photograph in which it is."""

    side = longest = resolution = 64
    keeps_shape, at_once = True, 4

    def __init__(self, confidence: float) -> None:
        self.asked: list[list[float]] = []
        self._confidence = confidence

    def normalized(self, picture: np.ndarray, size: tuple[int, int]) -> torch.Tensor:
        return torch.zeros(1, 3, *size)

    def encode(self, pixels: torch.Tensor) -> tuple[int, int]:
        return pixels.shape[-2], pixels.shape[-1]

    def answer(
        self, image: tuple[int, int], points: torch.Tensor, least: float
    ) -> tuple[torch.Tensor, torch.Tensor]:
        self.asked += points.tolist()
        logits = torch.full((len(points), *image), -9.0)
        for mask, (x, y) in zip(logits, points.tolist(), strict=True):
            top, left = (0 if y < 32 else 32), (0 if x < 32 else 32)
            mask[top : top + 32, left : left + 32] = 9.0
        return logits, torch.full((len(points),), self._confidence)


@pytest.mark.parametrize(("confidence", "skips"), [(0.99, True), (0.9, False)])
def test_points_in_sure_regions_are_not_asked_for(
    confidence: float, skips: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(regions, "GRIDS", (2, 4))
    network = SureNetwork(confidence)
    ids = regions.RegionFinder(network)(np.zeros((64, 64, 3), np.uint8))
    assert len(network.asked) == (4 if skips else 20)
    assert len(np.unique(ids)) == 4 and (ids[:32, :32] == ids[0, 0]).all() and (ids > 0).all()


def test_small_things_on_large_sure_regions_are_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(regions, "GRIDS", (2, 16))
    monkeypatch.setattr(regions, "SURE_CELLS", 2.0)
    network = SureNetwork(0.99)
    regions.RegionFinder(network)(np.zeros((64, 64, 3), np.uint8))
    assert len(network.asked) == 4 + 256


def test_of_similar_masks_the_most_confident_is_kept() -> None:
    def stretch(start: int, end: int) -> np.ndarray:
        return (np.arange(40) >= start) & (np.arange(40) < end)

    # Of 20 pixels each; the IoU with the first one is 18 / 22, 16 / 24 and, of a mask similar to the second
    # only, 15 / 25.
    masks = torch.from_numpy(np.stack([stretch(start, start + 20) for start in (0, 2, 4, 5)]))
    assert regions.distinct_masks(masks[:3], torch.tensor([0.9, 0.95, 0.99])).tolist() == [2, 0]
    assert regions.distinct_masks(masks[:2], torch.tensor([0.9, 0.9])).tolist() == [0]
    kept = regions.distinct_masks(masks[[0, 1, 3]], torch.tensor([0.99, 0.95, 0.9]))
    assert kept.tolist() == [0, 2], "a mask that was left out leaves out no others"


def test_a_picture_and_its_frame_are_two_regions() -> None:
    frame = np.zeros((10, 10), bool)
    frame[1:9, 1:9] = True
    inside = np.zeros((10, 10), bool)
    inside[2:8, 2:8] = True
    masks = torch.from_numpy(np.stack([frame & ~inside, inside]).reshape(2, -1))
    assert sorted(regions.distinct_masks(masks, torch.tensor([0.9, 0.95])).tolist()) == [0, 1]


def test_small_masks_lie_over_large_ones_and_islands_are_dropped() -> None:
    shape = (20, 50)
    wall, board, hidden, lamp = (np.zeros(shape, bool) for _ in range(4))
    wall[:, :40] = True
    board[:, 10:20] = True  # divides the wall into two pieces of one region
    hidden[5:8, 10:13] = True
    lamp[5:8, 10:14] = True
    lamp[0, 49] = lamp[0, 0] = True  # islands of one pixel
    ids = regions.flattened([wall, board, hidden, lamp], shape, least=0.003)
    expected = np.zeros(shape, int)
    expected[wall] = 1
    expected[board] = 2
    expected[5:8, 10:14] = 3  # the hidden one takes no number
    expected[0, 0] = 0
    assert ids.dtype == np.int32 and np.array_equal(ids, expected)
    assert not regions.flattened([], shape).any()
