# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Thumbnails of light states: each light is rendered once, alone; light adds up, so that states are sums.

Of a state that turns the environment, the thumbnail has it as it was turned when the lights were rendered.
"""

from __future__ import annotations

import hashlib
from functools import partial
from pathlib import Path

import bpy
import numpy as np

from ...core.run.errors import FiptError
from ...core.run.runfolder import RunFolder, atomic_path
from ..changed import changed
from ..lights import light_states
from ..marks import ANIMATED, lights_of, result_world
from ..render_settings import fitted
from .cycles import RenderOptions, render_pixels
from .image_files import save_exr, save_look
from .renders import Progress, output_size

LONGER_SIDE = 240  # pixels of thumbnails
_SAMPLES = 64  # of each light, denoised
_ENVIRONMENT, _REST = "environment of the room", "rest"  # keys beside those of lights, which have numbers


def lights_npz(run: RunFolder) -> Path:
    """The rendered lights: `names (N,)` keys, `base (N,3)` their rgb, `images (N,H,W,3) f32`."""
    return run.renders / "states" / "lights.npz"


def render_lights(
    scene: bpy.types.Scene, run: RunFolder, device: str, progress: Progress = lambda low, high: None
) -> None:
    """Render what the scene's camera sees by each light alone, and by what is in no state; small, denoised.

    Raises:
        FiptError: see `render_exr`; ``disk-full`` or ``run-unwritable``.
    """
    before = light_states.present(scene)
    lights = lights_of(scene)
    keys = [_REST, *(light_states.key_of(item) for item in lights)]
    if result_world(scene) is not None:
        keys.append(_ENVIRONMENT)
    width, height = fitted(output_size(scene), LONGER_SIDE)
    frame = {"resolution_x": width, "resolution_y": height, "resolution_percentage": 100}
    base, images = [], []
    moved = [item.animation_data for item in lights if ANIMATED in item and item.animation_data is not None]
    actions = [data.action for data in moved]
    try:
        for data in moved:
            data.action = None
        with changed(scene.render, frame):
            for index, key in enumerate(keys):
                progress(index / len(keys), (index + 1) / len(keys))
                state = light_states.estimated(scene, partial(_is_light, key), key == _ENVIRONMENT)
                if state["world"] is not None:
                    state["world"]["rotation"] = before["world"]["rotation"]
                light_states.recall(scene, state)
                base.append(state["lights"][key]["rgb"] if key in state["lights"] else [1.0] * 3)
                images.append(render_pixels(scene, RenderOptions(_SAMPLES, device=device)))
    finally:
        for data, action in zip(moved, actions, strict=True):
            data.action = action
        light_states.recall(scene, before)
    with atomic_path(lights_npz(run)) as temporary, open(temporary, "wb") as file:
        np.savez(file, names=np.array(keys), base=np.array(base), images=np.array(images, np.float32))


def _is_light(key: str, item: bpy.types.Object) -> bool:
    return light_states.key_of(item) == key


def state_image(
    state: light_states.LightState, lights: dict[str, tuple[np.ndarray, np.ndarray]]
) -> np.ndarray:
    """What a state's lights show together, (H, W, 3) f32.

    Args:
        state: the state.
        lights: rgb (3,) and render (H, W, 3) of each light by its key, see `lights_npz`.
    """
    rest = lights[_REST][1]
    shining = {key: entry["rgb"] for key, entry in state["lights"].items()}
    if state["world"] is not None and state["world"]["on"]:
        shining[_ENVIRONMENT] = [state["world"]["factor"]] * 3
    total = rest.copy()
    for key, rgb in shining.items():
        if key in lights:
            base, image = lights[key]
            share = np.divide(rgb, base, out=np.zeros(3), where=base > 0.0)
            total += (share * (image - rest)).astype(np.float32)
    return np.maximum(total, 0.0)


def picture_of_state(run: RunFolder, data: str) -> Path:
    """The thumbnail of a state, by its content."""
    digest = hashlib.sha256(data.encode()).hexdigest()[:16]
    return run.renders / "states" / f"{digest}.png"


def draw_states(scene: bpy.types.Scene, run: RunFolder) -> list[Path]:
    """Write the thumbnails of the scene's states from the rendered lights; returns those that exist then.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    path = lights_npz(run)
    if not path.is_file():
        return []
    with np.load(path, allow_pickle=False) as stored:
        pairs = zip(stored["base"], stored["images"], strict=True)
        lights = dict(zip(stored["names"].tolist(), pairs, strict=True))
    made, temporary = [], path.with_name("state.exr")
    for entry in scene.fipt.lights.states:
        picture = picture_of_state(run, entry.data)
        try:
            save_exr(temporary, state_image(light_states.read(entry.data), lights))
        except FiptError as error:
            if error.code != "state-damaged":
                raise
            continue
        save_look(temporary, picture, scene)
        entry.picture = str(picture)
        made.append(picture)
    temporary.unlink(missing_ok=True)
    return made
