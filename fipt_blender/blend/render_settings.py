"""The scene's render settings: we set them once, and never again against the artist's will.

A custom property of the scene holds what each setting was and what we made of it. A setting with another
value than ours is the artist's since then: only what she starts herself changes it, and Revert keeps it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

import bpy

from .marks import KEPT_RENDER, remove_marks

# Below which Cycles' estimate of a pixel's noise must fall. One that is coarser ends too many pixels before a
# bright path was found: 0.1 with 8 to 32 samples leaves the example room 0.7 % of white too dark.
NOISE_THRESHOLD = 0.02
# Samples of a pixel, at least and at most. The denoiser leaves 0.4 to 0.6 % of white in the example room, 3 %
# around a bulb.
LEAST_SAMPLES, MOST_SAMPLES = 8, 8
MOST_UNDENOISED = 256  # in a Blender without its denoiser, where the noise threshold ends a pixel
# There, most of a sample's indirect light, in white of the picture: what is above are fireflies.
CLAMPED_UNDENOISED = 8.0
MOST_SECONDS = 120.0  # of sampling, after which Cycles denoises what it has
LONGER_SIDE = 1920  # pixels

# How light is computed, wherever we render: nothing is clamped or left out.
LIGHT_PATHS = {
    "sample_clamp_direct": 0.0,
    "sample_clamp_indirect": 0.0,
    "blur_glossy": 0.0,
    "light_sampling_threshold": 0.0,
    "caustics_reflective": True,
    "caustics_refractive": True,
    # With Blender's 12 bounces a bright living room lacks 0.4 % of its light. More cost little, since Russian
    # roulette ends most paths earlier.
    "max_bounces": 32,
    "diffuse_bounces": 32,
    "glossy_bounces": 32,
}
_DENOISER = {
    "denoiser": "OPENIMAGEDENOISE",
    "denoising_input_passes": "RGB_ALBEDO_NORMAL",
    "denoising_prefilter": "ACCURATE",
}


def can_denoise() -> bool:
    """Whether this Blender was built with Open Image Denoise; some builds offer it but lack it."""
    try:
        import _cycles
    except ImportError:
        return False
    return bool(getattr(_cycles, "with_openimagedenoise", False))


def picture_settings(scene: bpy.types.Scene, exposure: float | None = None) -> dict[str, Any]:
    """The settings of pictures by their paths: Cycles until the noise is low, denoised, shown as photographs.

    Args:
        scene: whose they are.
        exposure: stops; None leaves the scene's.
    """
    film = scene.cycles.film_exposure if hasattr(scene, "cycles") else 1.0
    white = 2.0 ** -(scene.view_settings.exposure if exposure is None else exposure)
    cycles = {
        **LIGHT_PATHS,
        "use_adaptive_sampling": True,
        "adaptive_threshold": NOISE_THRESHOLD,
        "adaptive_min_samples": LEAST_SAMPLES,
        "samples": MOST_SAMPLES if can_denoise() else MOST_UNDENOISED,
        "time_limit": MOST_SECONDS,
        "use_denoising": can_denoise(),
        **(_DENOISER if can_denoise() else {"sample_clamp_indirect": CLAMPED_UNDENOISED * white / film}),
    }
    view: dict[str, Any] = {"view_transform": "Standard", "look": "None", "gamma": 1.0}
    if exposure is not None:
        view["exposure"] = exposure
    return {
        "render.engine": "CYCLES",
        **{f"cycles.{name}": value for name, value in cycles.items()},
        **{f"view_settings.{name}": value for name, value in view.items()},
    }


def set_up(scene: bpy.types.Scene, exposure: float | None = None, again: bool = False) -> list[str]:
    """Set what pictures of a room need, see `set_once`; the first time the size, too: `LONGER_SIDE`."""
    render = scene.render
    if not is_set(scene):
        render.resolution_x, render.resolution_y = fitted(
            (render.resolution_x, render.resolution_y), LONGER_SIDE
        )
        render.resolution_percentage = 100
    return set_once(scene, picture_settings(scene, exposure), again)


def fitted(size: tuple[int, int], longer_side: int) -> tuple[int, int]:
    """Width and height of the same proportions whose longer side has this many pixels."""
    scale = longer_side / max(size)
    return max(1, round(size[0] * scale)), max(1, round(size[1] * scale))


def set_once(scene: bpy.types.Scene, values: Mapping[str, Any], again: bool = False) -> list[str]:
    """Set settings that still are what they were or what we made them.

    Args:
        scene: the scene.
        values: by path, such as "render.engine"; values that this Blender lacks are skipped, too.
        again: also those that the artist has changed since: she asks for it.

    Returns:
        Paths of the settings that have the wanted value now.
    """
    kept = _kept(scene)
    done = []
    for path, value in values.items():
        owner, name = _owner(scene, path)
        if not hasattr(owner, name):
            continue
        present = getattr(owner, name)
        chosen, ours = kept.get(path, (present, present))
        if present != ours:
            if not again:
                continue
            chosen = present
        try:
            setattr(owner, name, value)
        except TypeError:  # an engine, format or device of another version, or whose add-on is disabled
            continue
        kept[path] = [chosen, getattr(owner, name)]
        done.append(path)
    scene[KEPT_RENDER] = json.dumps(kept)
    return done


def is_set(scene: bpy.types.Scene) -> bool:
    """Whether we have set the scene's settings."""
    return KEPT_RENDER in scene


def changed_by_artist(scene: bpy.types.Scene) -> list[str]:
    """Paths of the settings that have another value than we gave them."""
    return [path for path, (_, ours) in _kept(scene).items() if _value(scene, path) != ours]


def follow_exposure(scene: bpy.types.Scene, stops: float) -> None:
    """Show the room as bright as a photograph: phones expose each for itself.

    Args:
        scene: what the artist has added to its exposure stays; nothing happens while it shows a map.
        stops: the photograph's exposure after that of the median one, which a free view has.
    """
    settings = scene.fipt.capture
    change = stops - settings.shown_exposure
    if not change or scene.fipt.materials.kept_view or not is_set(scene):
        return
    settings.shown_exposure, name = stops, "view_settings.exposure"
    exposure = scene.view_settings.exposure + change
    if name in changed_by_artist(scene):
        scene.view_settings.exposure = exposure
    else:
        set_once(scene, {name: exposure})


def restore(scene: bpy.types.Scene) -> None:
    """Restore the settings that are still ours."""
    kept = _kept(scene)
    remove_marks(scene, KEPT_RENDER)
    for path, (chosen, ours) in kept.items():
        if _value(scene, path) == ours:
            owner, name = _owner(scene, path)
            with suppress(TypeError):  # an add-on that was removed since
                setattr(owner, name, chosen)


def _kept(scene: bpy.types.Scene) -> dict[str, list[Any]]:
    """What each setting was and what we made of it, by path."""
    kept: dict[str, list[Any]] = json.loads(scene.get(KEPT_RENDER, "{}"))
    return kept


def _owner(scene: bpy.types.Scene, path: str) -> tuple[object, str]:
    """The part of a scene that has a setting, and the setting's name there."""
    part, name = path.split(".")
    return getattr(scene, part, None), name


def _value(scene: bpy.types.Scene, path: str) -> Any:
    owner, name = _owner(scene, path)
    return getattr(owner, name, None)
