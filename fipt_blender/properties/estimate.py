"""State of the section Estimate: the preset, the settings that differ from it, and what is one part.

Only changed values are stored, so that all others follow the preset.
"""

from __future__ import annotations

import functools

import bpy

from ..core.capture.options import PART_SOURCES
from ..core.run.declared import declared
from ..core.run.settings import DEVICES, PRESET_TEXTS, Settings
from .declared import enum_items, property_of

_RUN_DEVICES = (("preferences", "As in Preferences", "Use the device selected in the preferences"), *DEVICES)
# What the panel offers of `Settings`: the fields that a property sets; the first one declares it.
CHOICES = {
    "rounds": ("rounds",),
    "diffuse_samples": ("diffuse_spp", "refine_diffuse_spp"),
    "specular_samples": ("specular_spp", "refine_specular_spp"),
    "light_samples": ("light_spp", "refine_light_spp"),
    **{
        name: (name,)
        for name in (
            *("training_steps", "light_pixels", "voxel_resolution", "roughness_levels", "denoise"),
            *("reject_views", "force", "correct_exposure", "seed"),
        )
    },
}


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


def _property(name: str, of: str) -> object:
    """A property with the preset's value until it is changed; `of` is the field that declares it."""
    item = declared(Settings)[of]

    def get(self: FIPT_EstimateSettings) -> float:
        changes = _changes(self)
        return item.kind(changes[name] if name in changes else getattr(_preset(self.preset), item.name))

    def set_(self: FIPT_EstimateSettings, value: float) -> None:
        import json

        self.changes = json.dumps({**_changes(self), name: value})

    return property_of(item, get=get, set=set_)


class FIPT_EstimateSettings(bpy.types.PropertyGroup):
    """The section Estimate."""

    preset: bpy.props.EnumProperty(
        name="Preset",
        description="Quality and duration of the estimation",
        items=enum_items(PRESET_TEXTS),
        default="medium",
    )
    device: bpy.props.EnumProperty(
        name="Compute On",
        description="Device on which the engine computes",
        items=enum_items(_RUN_DEVICES),
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
    __annotations__.update({name: _property(name, of) for name, (of, *_) in CHOICES.items()})

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
            for field in CHOICES[name]
        }


ENGINE_SOURCES = {"folder": "masks"}


class FIPT_PartsSettings(bpy.types.PropertyGroup):
    """The section Parts."""

    source: bpy.props.EnumProperty(
        name="Parts From",
        description="How surfaces of the same material are recognized. They share roughness and metallic",
        items=enum_items(PART_SOURCES),
        default="auto",
    )
    folder: bpy.props.StringProperty(
        name="Masks",
        description="Folder with an ID image (PNG or EXR) for each photograph, with the same name and size",
        subtype="DIR_PATH",
    )
    surveyed_folder: bpy.props.StringProperty(description="The mask folder at the last check")
    auto_source: bpy.props.StringProperty(description="The source that Automatic uses; empty before a check")
    counts: bpy.props.StringProperty(description="Number of parts from each source, as JSON")

    @property
    def engine_source(self) -> str:
        """The source as room.json names it, of `core.capture.options.PART_SOURCES`."""
        return ENGINE_SOURCES.get(self.source, self.source)
