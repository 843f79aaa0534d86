# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""State of the section Estimate: the preset, and the settings that differ from it.

Only changed values are stored, so that all others follow the preset.
"""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, NamedTuple

import bpy

if TYPE_CHECKING:
    from ..core.run.settings import Settings

PRESETS = (
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
_RUN_DEVICES = (("preferences", "As in Preferences", "Use the device selected in the preferences"), *DEVICES)


class Choice(NamedTuple):
    """A setting in the panel: the fields of `Settings` that it sets, its label and its tooltip."""

    fields: tuple[str, ...]
    name: str
    description: str
    least: float = 1
    most: float = 1_000_000
    switch: bool = False  # a checkbox instead of a number
    fraction: bool = False  # a number with decimals


CHOICES = {
    "rounds": Choice(
        ("rounds",), "Rounds", "Number of refinements of light and materials; 0 for none", 0, 20
    ),
    "diffuse_samples": Choice(
        ("diffuse_spp", "refine_diffuse_spp"),
        "Diffuse Samples",
        "Rays per pixel for diffuse light: fewer rays are faster and noisier",
    ),
    "specular_samples": Choice(
        ("specular_spp", "refine_specular_spp"),
        "Glossy Samples",
        "Rays per pixel and roughness level for reflections: fewer rays are faster and noisier",
    ),
    "light_samples": Choice(
        ("light_spp", "refine_light_spp"),
        "Light Samples",
        "Rays per pixel toward lamps: more rays reduce noise in shadows",
    ),
    "training_steps": Choice(
        ("training_steps",), "Training Steps", "Steps of the training: more steps give sharper textures"
    ),
    "light_pixels": Choice(
        ("light_pixels",),
        "Light Pixels",
        "Millions of pixels of all photographs together at which light is solved. Larger photographs are"
        " averaged: more pixels are slower and show smaller surfaces and shadows",
        0.01,
        1000,
        fraction=True,
    ),
    "voxel_resolution": Choice(
        ("voxel_resolution",),
        "Light Resolution",
        "Cells of the radiance cache along the room's longest side: use more for large rooms",
        8,
        1024,
    ),
    "roughness_levels": Choice(
        ("roughness_levels",), "Gloss Levels", "Number of roughness levels of computed reflections", 3, 32
    ),
    "denoise": Choice(
        ("denoise",), "Denoise", "Denoise the computed light, so that fewer samples are needed", switch=True
    ),
    "reject_views": Choice(
        ("reject_views",),
        "Reject Views",
        "Leave out photographs that do not agree with their camera poses",
        switch=True,
    ),
    "force": Choice(
        ("force",),
        "Force",
        "Estimate although mesh, poses or photographs look useless",
        switch=True,
    ),
    "correct_exposure": Choice(
        ("correct_exposure",),
        "Correct Exposure",
        "Correct photographs whose exposure differs from that of the others",
        switch=True,
    ),
    "seed": Choice(("seed",), "Seed", "Seed of all random numbers: the same seed gives the same result", 0),
}  # fmt: skip


@functools.cache
def _preset(name: str) -> Settings:
    from ..core.run.settings import make_settings

    return make_settings(name)


def _changes(settings: FIPT_EstimateSettings) -> dict[str, float]:
    import json

    try:
        changes = json.loads(settings.changes or "{}")
    except ValueError:
        return {}
    return changes if isinstance(changes, dict) else {}


def _property(name: str, choice: Choice) -> object:
    """A property with the preset's value until it is changed."""

    kind = bool if choice.switch else float if choice.fraction else int

    def get(self: FIPT_EstimateSettings) -> float:
        changes = _changes(self)
        value = changes[name] if name in changes else getattr(_preset(self.preset), choice.fields[0])
        return kind(value)

    def set_(self: FIPT_EstimateSettings, value: float) -> None:
        import json

        self.changes = json.dumps({**_changes(self), name: value})

    options = {"name": choice.name, "description": choice.description, "get": get, "set": set_}
    if choice.switch:
        return bpy.props.BoolProperty(**options)
    if choice.fraction:
        return bpy.props.FloatProperty(**options, min=choice.least, max=choice.most, precision=2)
    return bpy.props.IntProperty(**options, min=int(choice.least), max=int(choice.most))


class FIPT_EstimateSettings(bpy.types.PropertyGroup):
    """The section Estimate."""

    preset: bpy.props.EnumProperty(
        name="Preset", description="Quality and duration of the estimation", items=PRESETS, default="medium"
    )
    device: bpy.props.EnumProperty(
        name="Compute On",
        description="Device on which the engine computes",
        items=_RUN_DEVICES,
        default="preferences",
    )
    apply_when_finished: bpy.props.BoolProperty(
        name="Apply at the End",
        description="Apply the results to the room at the end of an estimation that was started in a window",
        default=True,
    )
    changes: bpy.props.StringProperty(
        name="Changed Settings",
        description="Settings that differ from the preset, as JSON",
        options={"HIDDEN"},
    )
    __annotations__.update({name: _property(name, choice) for name, choice in CHOICES.items()})

    def is_changed(self, name: str) -> bool:
        """Whether the artist has set one of CHOICES."""
        return name in _changes(self)

    def reset(self, *names: str) -> None:
        """Let the named CHOICES follow the preset again; without a name, all of them."""
        import json

        changes = (
            {} if not names else {key: value for key, value in _changes(self).items() if key not in names}
        )
        self.changes = json.dumps(changes) if changes else ""

    def values(self) -> dict[str, float]:
        """The changed fields of `Settings`, for `make_settings`, without the device."""
        return {
            field: value
            for name, value in _changes(self).items()
            if name in CHOICES
            for field in CHOICES[name].fields
        }
