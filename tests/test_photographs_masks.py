# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Masks by models: semantic classes, and the step of `prepare`, on tiny models with random weights."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch

from fipt_blender.core.capture.images import read_ids, write_exr, write_ids
from fipt_blender.core.photographs.masks_model import open_masks_model
from fipt_blender.core.photographs.preparation import (
    Group,
    Photograph,
    Preparation,
    PreparationFolder,
    PrepareSettings,
    write_preparation,
)
from fipt_blender.core.photographs.segmentation import window_starts
from fipt_blender.core.photographs.steps import run_steps
from fipt_blender.core.photographs.tonemap import display_picture
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.messages import Reporter
from samples.refusals import error_of

transformers = pytest.importorskip("transformers")
from samples import mask_models  # noqa: E402


def backbone() -> object:
    stages = {"depths": [1] * 4, "num_heads": [1] * 4, "out_features": [f"stage{i}" for i in (1, 2, 3, 4)]}
    return transformers.SwinConfig(image_size=64, patch_size=4, embed_dim=8, window_size=4, **stages)


def mask2former() -> torch.nn.Module:
    sizes = ("feature_size", "mask_feature_size", "hidden_dim", "encoder_feedforward_dim", "dim_feedforward")
    config = transformers.Mask2FormerConfig(
        backbone_config=backbone(),
        **dict.fromkeys(sizes, 32),
        encoder_layers=1,
        decoder_layers=2,
        num_attention_heads=2,
        num_queries=20,
        num_labels=5,
    )
    return transformers.Mask2FormerForUniversalSegmentation(config)


def oneformer() -> torch.nn.Module:
    sizes = ("hidden_dim", "mask_dim", "conv_dim", "encoder_feedforward_dim", "dim_feedforward")
    config = transformers.OneFormerConfig(
        backbone_config=backbone(),
        **dict.fromkeys(sizes, 32),
        encoder_layers=1,
        decoder_layers=2,
        num_attention_heads=2,
        num_queries=20,
        num_labels=5,
        text_encoder_width=64,
        text_encoder_num_layers=1,
        text_encoder_vocab_size=600,
        query_dec_layers=1,
        is_training=True,  # as in published models
    )
    return transformers.OneFormerForUniversalSegmentation(config)


def write_tokenizer(folder: Path) -> None:
    """A tokenizer of single letters."""
    letters = [chr(number) for number in range(33, 127)]
    words = [*letters, *(f"{letter}</w>" for letter in letters), "<|startoftext|>", "<|endoftext|>"]
    vocabulary = {word: number for number, word in enumerate(words)}
    (folder / "vocab.json").write_text(json.dumps(vocabulary), encoding="utf-8")
    (folder / "merges.txt").write_text("#version: 0.2\n", encoding="utf-8")


@pytest.fixture(
    scope="module",
    params=[mask2former, oneformer, mask_models.make_eomt],
    ids=["mask2former", "oneformer", "eomt"],
)
def model(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    torch.manual_seed(0)
    folder = mask_models.write_segmenter(tmp_path_factory.mktemp("model"), request.param())
    if request.param is oneformer:
        write_tokenizer(folder)
    return folder


def picture(width: int, height: int) -> np.ndarray:
    coarse = np.random.default_rng(4).integers(0, 256, (height // 16, width // 16, 3), np.uint8)
    return coarse.repeat(16, axis=0).repeat(16, axis=1)


@pytest.mark.parametrize(("width", "height"), [(96, 64), (64, 160)])
def test_classes_are_those_of_the_models_own_definition(model: Path, width: int, height: int) -> None:
    """Per pixel, the class with the highest sum over queries of P(class) P(pixel in mask)."""
    segmenter = open_masks_model(model)
    image = picture(width, height)
    ids = segmenter(image)
    assert ids.shape == (height, width) and ids.dtype == np.int32
    assert segmenter.classes == {0: "wall", 1: "floor", 2: "lamp", 3: "bed", 4: "rug"}
    kind = json.loads((model / "config.json").read_text(encoding="utf-8"))["architectures"][0]
    # With its training flag, OneFormer drops activations and wants texts, whatever eval() says.
    changes = {"is_training": False} if "OneFormer" in kind else {}
    network = getattr(transformers, kind).from_pretrained(model, **changes).eval()
    more = {}
    if "OneFormer" in kind:
        tokenizer = transformers.CLIPTokenizer.from_pretrained(model)
        tokens = tokenizer(["the task is semantic"], padding="max_length", max_length=77, return_tensors="pt")
        more["task_inputs"] = tokens["input_ids"] * tokens["attention_mask"]
    values = (torch.from_numpy(image) / 255.0 - torch.tensor([0.5, 0.4, 0.3])) / torch.tensor([0.2, 0.3, 0.4])
    pixels = values.permute(2, 0, 1)[None]
    square = "Eomt" in kind
    starts = window_starts(max(width, height), 64) if square else [0]
    total, count = torch.zeros(5, height, width), torch.zeros(height, width)
    for start in starts:
        rows = slice(start, start + 64) if square and height > width else slice(None)
        columns = slice(start, start + 64) if square and width >= height else slice(None)
        with torch.no_grad():
            output = network(pixel_values=pixels[..., rows, columns], **more)
        scores = torch.einsum(
            "qc,qhw->chw",
            output.class_queries_logits[0].softmax(-1)[:, :-1],
            output.masks_queries_logits[0].sigmoid(),
        )
        part = total[:, rows, columns]
        part += torch.nn.functional.interpolate(scores[None], size=part.shape[1:], mode="bilinear")[0]
        count[rows, columns] += 1.0
    expected = (total / count).argmax(dim=0).numpy()
    assert len(np.unique(expected)) > 1, "the picture must have several classes"
    assert (ids == expected).mean() > 0.999


def test_larger_photographs_are_scaled_to_the_models_size(model: Path) -> None:
    segmenter = open_masks_model(model)
    small = picture(96, 64)
    large = small.repeat(4, axis=0).repeat(4, axis=1)
    agreement = (segmenter(large)[2::4, 2::4] == segmenter(small)).mean()
    assert agreement > 0.9


def merged_capture(
    root: Path, names: list[str], width: int, height: int
) -> tuple[PreparationFolder, tuple[Photograph, ...], tuple[Group, ...]]:
    """A capture with a merged image of each name."""
    folder = PreparationFolder(root)
    for name in names:
        write_exr(folder.images / f"{name}.exr", (picture(width, height) / 255.0).astype(np.float32) ** 2.2)
    photographs = tuple(Photograph(f"{name}.jpg", "ldr", width, height) for name in names)
    return folder, photographs, tuple(Group(name, (f"{name}.jpg",)) for name in names)


def test_the_step_writes_masks_where_the_reader_finds_them(model: Path, tmp_path: Path) -> None:
    names = ["a b", "c"]
    folder, photographs, groups = merged_capture(tmp_path / "capture", names, 96, 64)
    own = folder.root / "semantics" / "mine.png"
    own.parent.mkdir(parents=True)
    own.write_bytes(b"a mask of the user")

    def run(masks: str, used: int) -> dict:
        settings = PrepareSettings(masks=masks)
        write_preparation(folder, Preparation(tmp_path, photographs[:used], groups[:used], settings))
        run_steps(folder, ["masks"], Reporter())
        return json.loads(folder.facts("masks").read_text(encoding="utf-8"))

    facts = run(str(model), 2)
    written = [read_ids(folder.root / "semantics" / f"{name}.png") for name in names]
    assert all(ids.shape == (64, 96) and set(np.unique(ids)) <= set(range(5)) for ids in written)
    assert sum(item["share"] for item in facts["classes"]) == pytest.approx(1.0, abs=1e-3)
    assert facts["classes"][0]["share"] == max(item["share"] for item in facts["classes"])
    run(str(model), 1)
    assert {path.name for path in own.parent.iterdir()} == {"a b.png", "classes.json", "mine.png"}
    names = json.loads((own.parent / "classes.json").read_text(encoding="utf-8"))
    assert names == {"0": "wall", "1": "floor", "2": "lamp", "3": "bed", "4": "rug"}
    assert run("", 1)["model"] is None
    assert {path.name for path in own.parent.iterdir()} == {"mine.png"}


def test_another_kind_of_model_replaces_the_masks_but_not_those_of_the_user(
    model: Path, tmp_path: Path
) -> None:
    folder, photographs, groups = merged_capture(tmp_path / "capture", ["a b", "c"], 64, 48)
    sam = mask_models.write_sam(tmp_path / "sam", mask_models.make_sam())
    own = np.full((48, 64), 9, np.int32)
    write_ids(folder.root / "parts" / "c.png", own)

    def run(masks: Path) -> set[str]:
        settings = PrepareSettings(masks=str(masks))
        write_preparation(folder, Preparation(tmp_path, photographs, groups, settings))
        run_steps(folder, ["masks"], Reporter())
        assert np.array_equal(read_ids(folder.root / "parts" / "c.png"), own)
        kinds = [folder.root / kind for kind in ("parts", "semantics")]
        return {path.relative_to(folder.root).as_posix() for kind in kinds for path in kind.glob("*")}

    assert run(sam) == {"parts/a b.png", "parts/c.png"}
    found = read_ids(folder.root / "parts" / "a b.png")
    assert found.shape == (48, 64) and len(np.unique(found)) > 2
    assert run(model) == {f"semantics/{name}" for name in ("a b.png", "c.png", "classes.json")} | {
        "parts/c.png"
    }
    assert run(sam) == {"parts/a b.png", "parts/c.png"}


def test_unusable_models_are_refused(model: Path, tmp_path: Path) -> None:
    def refused(change: dict[str, object] | None, words: str, remove: str = "") -> None:
        folder = tmp_path / words.replace(" ", "-")
        shutil.copytree(model, folder)
        if change is not None:
            config = json.loads((folder / "config.json").read_text(encoding="utf-8"))
            (folder / "config.json").write_text(json.dumps({**config, **change}), encoding="utf-8")
        if remove:
            (folder / remove).unlink()
        caught = error_of(open_masks_model, folder)
        assert caught.code == "model-unusable" and words in caught.text, caught.text

    refused({"model_type": "bert"}, "of the type 'bert'")
    refused({"num_queries": 7}, "can't be used")
    refused(None, "no safetensors", remove="model.safetensors")
    refused(None, "config.json", remove="config.json")
    with pytest.raises(FiptError):
        open_masks_model(tmp_path / "nowhere")


@pytest.mark.parametrize(
    "name", ["evil.bin", "../x.safetensors", "/x.safetensors", "a\\x.safetensors", "C:x.safetensors", ""]
)
def test_weights_outside_the_folder_or_of_another_kind_are_refused(
    model: Path, tmp_path: Path, name: str
) -> None:
    folder = tmp_path / "model"
    shutil.copytree(model, folder)
    index = folder / "model.safetensors.index.json"
    index.write_text(json.dumps({"weight_map": {"a": "model.safetensors", "b": name}}), encoding="utf-8")
    caught = error_of(open_masks_model, folder)
    assert caught.code == "model-unusable" and index.name in caught.text


def test_weights_that_are_missing_are_told(model: Path, tmp_path: Path) -> None:
    """transformers alone would fill them with random numbers."""
    broken = mask_models.write_without_weight(tmp_path / "model", model, "class_")
    caught = error_of(open_masks_model, broken)
    assert caught.code == "model-unusable" and "missing" in caught.text


@pytest.mark.parametrize(
    ("longer", "side", "starts"), [(64, 64, [0]), (96, 64, [0, 32]), (160, 64, [0, 48, 96])]
)
def test_windows_cover_an_image(longer: int, side: int, starts: list[int]) -> None:
    assert window_starts(longer, side) == starts
    assert starts[-1] + side == longer


def test_a_picture_for_display_does_not_depend_on_the_exposure() -> None:
    radiance = np.random.default_rng(0).uniform(0.0, 1.0, (40, 50, 3)).astype(np.float32)
    radiance[0, 0] = 1000.0
    shown = display_picture(radiance)
    assert np.array_equal(shown, display_picture(8.0 * radiance)) and shown[0, 0].min() == 255
    assert abs(float(shown.mean()) - 175.0) < 15.0
    assert not display_picture(np.zeros((3, 3, 3), np.float32)).any()
