# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""State of the section Estimate: the preset, and what the artist changed of it.

Only changed values are kept, so that all others follow the preset.
"""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Any, NamedTuple

import bpy

if TYPE_CHECKING:
    from ..core.job.settings import Settings

PRESETS = (
    ("draft", "Draft", "A first look, with noise and soft textures: a few minutes for 40 small photographs"),
    ("medium", "Medium", "Good materials and lights: about three times a draft. A GPU is much faster"),
    ("high", "High", "Many more samples and training steps: an hour on a GPU, a night without one"),
)
DEVICES = (
    ("preferences", "As in Preferences", "Where the preferences say that the engine computes"),
    ("auto", "Automatic", "The graphics card where a usable one is found, else the processor"),
    ("cuda", "GPU (CUDA)", "An NVIDIA graphics card"),
    ("llvm", "CPU", "The processor; slower, but works everywhere"),
)


class Choice(NamedTuple):
    """A setting that the panel offers: the fields of `Settings` that it stands for, and its words."""

    fields: tuple[str, ...]
    name: str
    description: str
    least: int = 1
    most: int = 1_000_000
    switch: bool = False  # on or off, no number


CHOICES = {
    "rounds": Choice(
        ("rounds",), "Rounds", "How often light and materials are refined; 0 keeps the first guess", 0, 20
    ),
    "diffuse_samples": Choice(
        ("diffuse_spp", "refine_diffuse_spp"),
        "Diffuse Samples",
        "Rays a pixel for the light that falls on it: fewer are faster, and noisier",
    ),
    "specular_samples": Choice(
        ("specular_spp", "refine_specular_spp"),
        "Specular Samples",
        "Rays a pixel and roughness level for reflections: fewer are faster, and noisier",
    ),
    "light_samples": Choice(
        ("light_spp", "refine_light_spp"),
        "Light Samples",
        "Rays a pixel aimed at lamps: against noise in shadows",
    ),
    "training_steps": Choice(
        ("training_steps",), "Training Steps", "Steps of the first training: more give sharper textures"
    ),
    "later_training_steps": Choice(
        ("later_training_steps",), "Later Steps", "Training steps of each later round"
    ),
    "voxel_resolution": Choice(
        ("voxel_resolution",),
        "Light Resolution",
        "Cells along the room's longest side in which light is remembered: more for large rooms",
        8,
        1024,
    ),
    "roughness_levels": Choice(
        ("roughness_levels",), "Roughness Levels", "Roughnesses at which reflections are computed", 3, 32
    ),
    "denoise": Choice(
        ("denoise",), "Denoise", "Smooth the computed light, so that fewer samples do", switch=True
    ),
    "seed": Choice(("seed",), "Seed", "Start of all random numbers: the same seed gives the same result", 0),
}  # fmt: skip


@functools.cache
def _preset(name: str) -> Settings:
    from ..core.job.settings import make_settings

    return make_settings(name)


def _changes(settings: FIPT_EstimateSettings) -> dict[str, Any]:
    import json

    try:
        changes = json.loads(settings.changes or "{}")
    except ValueError:
        return {}
    return changes if isinstance(changes, dict) else {}


def _property(name: str, choice: Choice) -> Any:
    """A property that shows the preset's value until it is changed."""

    def get(self: FIPT_EstimateSettings) -> Any:
        changes = _changes(self)
        return changes[name] if name in changes else getattr(_preset(self.preset), choice.fields[0])

    def set_(self: FIPT_EstimateSettings, value: Any) -> None:
        import json

        self.changes = json.dumps({**_changes(self), name: value})

    words = {"name": choice.name, "description": choice.description, "get": get, "set": set_}
    if choice.switch:
        return bpy.props.BoolProperty(**words)
    return bpy.props.IntProperty(**words, min=choice.least, max=choice.most)


class FIPT_EstimateSettings(bpy.types.PropertyGroup):
    """The section Estimate."""

    preset: bpy.props.EnumProperty(
        name="Preset", description="Quality against time", items=PRESETS, default="medium"
    )
    device: bpy.props.EnumProperty(
        name="Compute On", description="Where the engine computes", items=DEVICES, default="preferences"
    )
    changes: bpy.props.StringProperty(
        name="Changed Settings", description="What was changed of the preset, as JSON", options={"HIDDEN"}
    )
    __annotations__.update({name: _property(name, choice) for name, choice in CHOICES.items()})

    def is_changed(self, name: str) -> bool:
        """Whether one of CHOICES differs from the preset by the artist's wish."""
        return name in _changes(self)

    def reset(self, *names: str) -> None:
        """Let some of CHOICES follow the preset again; all of them where none is named."""
        import json

        changes = (
            {} if not names else {key: value for key, value in _changes(self).items() if key not in names}
        )
        self.changes = json.dumps(changes) if changes else ""

    def values(self) -> dict[str, Any]:
        """The changed fields of `Settings`, for `make_settings`; the device is left to the caller."""
        return {
            field: value
            for name, value in _changes(self).items()
            if name in CHOICES
            for field in CHOICES[name].fields
        }


CLASSES = (FIPT_EstimateSettings,)
