# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Tiny models with random weights that make id images of any picture."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import torch
import transformers

SIDE = 64  # of the square that they take
_PROMPTS = {"hidden_size": 32, "image_size": SIDE, "patch_size": 16, "mask_input_channels": 8}
_DECODER = {"hidden_size": 32, "mlp_dim": 32, "num_attention_heads": 2, "iou_head_hidden_dim": 32}
_VISION_2 = {
    "backbone_config": {
        "model_type": "sam2_hiera_det_model",
        "hidden_size": 8,
        "image_size": [SIDE, SIDE],
        "blocks_per_stage": [1, 1, 2, 1],
        "embed_dim_per_stage": [8, 16, 32, 64],
        "num_attention_heads_per_stage": [1, 1, 1, 1],
        "window_size_per_stage": [8, 4, 2, 2],
        "global_attention_blocks": [3],
        "window_positional_embedding_background_size": [2, 2],
    },
    "backbone_channel_list": [64, 32, 16, 8],
    "backbone_feature_sizes": [[16, 16], [8, 8], [4, 4]],
    "fpn_hidden_size": 32,
}
_MEMORY = {
    **dict.fromkeys(("memory_attention_hidden_size", "memory_encoder_hidden_size"), 32),
    **dict.fromkeys(("memory_attention_feed_forward_hidden_size", "mask_downsampler_embed_dim"), 32),
    **dict.fromkeys(("memory_fuser_embed_dim", "memory_fuser_intermediate_dim"), 32),
    **dict.fromkeys(("memory_attention_num_layers", "memory_fuser_num_layers"), 1),
    "memory_encoder_output_channels": 16,
    "image_size": SIDE,
}


def make_sam() -> torch.nn.Module:
    """The first model."""
    torch.manual_seed(0)
    vision = {
        "hidden_size": 32,
        "output_channels": 32,
        "num_hidden_layers": 2,
        "num_attention_heads": 2,
        "image_size": SIDE,
        "patch_size": 16,
        "window_size": 2,
        "global_attn_indexes": [1],
        "num_pos_feats": 16,
        "mlp_dim": 32,
    }
    config = transformers.SamConfig(
        vision_config=vision, prompt_encoder_config=_PROMPTS, mask_decoder_config=_DECODER
    )
    return transformers.SamModel(config)


def make_sam2() -> torch.nn.Module:
    """SAM 2 of images."""
    torch.manual_seed(0)
    config = transformers.Sam2Config(
        vision_config=_VISION_2, prompt_encoder_config=_PROMPTS, mask_decoder_config=_DECODER
    )
    return transformers.Sam2Model(config)


def make_sam2_video() -> torch.nn.Module:
    """SAM 2 of videos, as its models are published."""
    torch.manual_seed(0)
    config = transformers.Sam2VideoConfig(
        vision_config=_VISION_2, prompt_encoder_config=_PROMPTS, mask_decoder_config=_DECODER, **_MEMORY
    )
    return transformers.Sam2VideoModel(config)


def write_sam(folder: Path, network: torch.nn.Module) -> Path:
    """Save a model that is sure of some of its masks, which are stable and depend on the point."""
    generator = torch.Generator().manual_seed(3)
    with torch.no_grad():
        for name, parameter in network.named_parameters():
            if parameter.ndim > 1 and "vision_encoder" not in name:
                parameter.normal_(0.0, 2.0 / parameter[0].numel() ** 0.5, generator=generator)
            if "output_hypernetworks" in name and "proj_out" in name:
                parameter.mul_(20.0)
            if "iou_prediction_head.proj_out" in name:
                parameter.mul_(0.3).add_(2.0 if parameter.ndim == 1 else 0.0)
    network.save_pretrained(folder)
    return folder


def make_eomt() -> torch.nn.Module:
    """A model for five semantic classes."""
    torch.manual_seed(0)
    config = transformers.EomtConfig(
        hidden_size=32,
        num_hidden_layers=2,
        num_attention_heads=2,
        image_size=SIDE,
        patch_size=16,
        num_queries=20,
        num_blocks=1,
        num_labels=5,
    )
    return transformers.EomtForUniversalSegmentation(config)


def write_segmenter(folder: Path, network: torch.nn.Module) -> Path:
    """Save a model of semantic classes whose queries differ enough to tell the parts of an image apart."""
    with torch.no_grad():
        for name, parameter in network.named_parameters():
            if "class_predictor" in name or "quer" in name:
                parameter.normal_(0.0, 3.0)
            elif "mask" in name and parameter.ndim > 1:
                parameter.mul_(4.0)
    network.config.id2label = dict(enumerate(("wall", "floor", "lamp", "bed", "rug")))
    network.save_pretrained(folder)
    size = {"shortest_edge": SIDE, "longest_edge": 1333}
    processor = {"size": size, "image_mean": [0.5, 0.4, 0.3], "image_std": [0.2, 0.3, 0.4]}
    (folder / "preprocessor_config.json").write_text(json.dumps(processor), encoding="utf-8")
    return folder


def write_without_weight(folder: Path, model: Path, part_of_name: str) -> Path:
    """A copy of a model without the first weight whose name has a part."""
    from safetensors.torch import load_file, save_file

    shutil.copytree(model, folder)
    weights = load_file(model / "model.safetensors")
    gone = next(name for name in sorted(weights) if part_of_name in name)
    save_file({k: v for k, v in weights.items() if k != gone}, folder / "model.safetensors")
    return folder
