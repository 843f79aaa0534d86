# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Keeps the settings of fixtures when results are applied again."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import bpy

from ..marks import BACK, BASE, FIXTURE, fixture_lights, fixtures_of
from .convert import fixture_to_lights
from .light_state import SETTINGS, Setting, adopt, list_lights, refresh


@dataclass(frozen=True)
class FixtureState:
    """A fixture's settings and base radiances by key, and whether Blender lights stand for it."""

    settings: dict[str, Setting]
    converted: bool


def states_of(scene: bpy.types.Scene) -> dict[str, FixtureState]:
    """The states of all fixtures of a scene, by name."""
    states = {}
    for item in fixtures_of(scene):
        adopt(item)
        settings = {key: _plain(item[key]) for key in (*SETTINGS, BASE, BACK) if key in item}
        states[item[FIXTURE]] = FixtureState(settings, bool(fixture_lights(item)))
    return states


def keep_states(
    scene: bpy.types.Scene, items: Iterable[bpy.types.Object], states: Mapping[str, FixtureState]
) -> None:
    """Give new fixtures the settings of earlier ones with the same name and radiance; update all lights."""
    for item in items:
        state = states.get(item[FIXTURE])
        if state is None or any(state.settings.get(key) != _plain(item[key]) for key in (BASE, BACK)):
            continue
        for key in SETTINGS:
            if key in state.settings:
                item[key] = state.settings[key]
        if state.converted:
            fixture_to_lights(scene, item)
    refresh(scene)
    list_lights(scene)


def _plain(value: Setting) -> Setting:
    """A custom property's value, arrays as lists."""
    return value if isinstance(value, bool | int | float | str) else list(value)
