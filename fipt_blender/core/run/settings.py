"""The settings of a run, what users and ablations vary, and the presets.

Further tuned constants are module constants beside the code that uses them; a change of those changes the
stage keys too (:mod:`.method`). A help text says where a default departs from the paper, or which code or
paper it follows where the two differ. Standard library only: both processes import it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from .declared import Option, converted
from .errors import FiptError
from .stage_settings import (
    CheckSettings,
    CompletionSettings,
    MaterialSettings,
    OutlineSettings,
    PhotometrySettings,
    RefinementSettings,
    RefitSettings,
    ResultSettings,
    ScanSettings,
    TextureSettings,
    TrainingSettings,
    ViewSettings,
)

Value = str | int | float | bool

# The settings of Apply Results; no stage of an estimation reads them.
TEXTURE_SETTINGS = ("texel_density", "texture_size", "atlas_images", "atlas_mode", "write_back", "clean_mesh")

PRESET_TEXTS = (  # identifier, label, tooltip
    (
        "draft",
        "Draft",
        "A quick preview with noise and soft textures: a few minutes, whatever the photographs' size",
    ),
    (
        "medium",
        "Medium",
        "Good materials and lights: takes about three times as long as Draft. A GPU is much faster",
    ),
    ("high", "High", "Many more samples and training steps: an hour on a GPU, a night without one"),
)
DEVICES = (
    ("auto", "Automatic", "Use the GPU if a usable one is found, otherwise the CPU"),
    ("cuda", "GPU (CUDA)", "Use an NVIDIA GPU"),
    ("llvm", "CPU", "Use the CPU: slower, but works on every machine"),
)


@dataclass(frozen=True)
class RunSettings:
    """What the stages are, and where they run."""

    preset: Annotated[str, Option("the preset that other settings start from", choices=PRESET_TEXTS)] = (
        "medium"
    )
    device: Annotated[str, Option("device on which the engine computes", "Compute On", choices=DEVICES)] = (
        "auto"
    )
    rounds: Annotated[
        int,
        Option(
            "number of refinements of light and materials; 0 for none (stages 3 and 2, repeated after"
            " stages 1 and 2)",
            zero=True,
            shown={"soft_max": 20},
        ),
    ] = 1


@dataclass(frozen=True)
class Settings(
    TextureSettings,
    ResultSettings,
    TrainingSettings,
    MaterialSettings,
    RefinementSettings,
    RefitSettings,
    PhotometrySettings,
    CheckSettings,
    OutlineSettings,
    CompletionSettings,
    ScanSettings,
    ViewSettings,
    RunSettings,
):
    """All settings of one run; JSON-serialisable. Runs with equal settings have equal results."""


PRESETS: dict[str, dict[str, Value]] = {
    "draft": {"light_pixels": 2.0, "training_steps": 250, "batch_size": 4096},
    "medium": {},
    "high": {
        "rounds": 2,
        "light_pixels": 8.0,
        "diffuse_spp": 64,
        "specular_spp": 16,
        "light_spp": 32,
        "refine_diffuse_spp": 128,
        "refine_specular_spp": 32,
        "refine_light_spp": 64,
        "training_steps": 4000,
        "learning_rate": 1e-3,
        "hash_learning_rate": 3e-3,
        "roughness_levels": 12,
    },
}


def make_settings(preset: str = "medium", changes: Mapping[str, Value] | None = None) -> Settings:
    """Settings of a preset with some values changed.

    Args:
        preset: a key of ``PRESETS``, unless the changes name another one.
        changes: field name to value; strings are converted to the field's type.
    """
    changes = dict(changes or {})
    preset = changes.pop("preset", preset)  # type: ignore[assignment]
    if not isinstance(preset, str) or preset not in PRESETS:
        raise FiptError("setting-unknown.make-settings", preset=preset, presets=", ".join(PRESETS))
    values: dict[str, Any] = {"preset": preset, **PRESETS[preset]}
    return Settings(**values | converted(Settings, changes))
