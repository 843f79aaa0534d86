# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""IES profiles (ANSI/IES LM-63) on Blender lights: where a luminaire sends its light, at unchanged power.

The profile is stored in the .blend file as a text. Only Cycles renders it.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from ...core.run.errors import FiptError
from ..marks import PROFILE, remove_marks

MAX_BYTES = 1 << 20
_NODE = "FIPT IES Profile"
# By what Cycles multiplies candela, in the unit of a point light: 4 pi / 177.83 lm/W. Versions 4.3 and 4.5
# render 8 % more, 5.2 does not (measured).
_PER_CANDELA = 0.0706650768394 if bpy.app.version >= (5, 0) else 0.0766008
_REMEDY = "Choose an .ies file of the lamp's manufacturer."


@dataclass(frozen=True)
class Profile:
    """A luminaire's intensities.

    Attributes:
        text: the file's content.
        vertical: (V,) degrees from the direction in which the lamp points, ascending.
        horizontal: (H,) degrees around it, ascending.
        candela: (H,V) intensities.
    """

    text: str
    vertical: np.ndarray
    horizontal: np.ndarray
    candela: np.ndarray

    def mean(self) -> float:
        """Mean intensity over the sphere, candela; directions outside the table are dark."""
        theta = np.radians(self.vertical)
        rows = self._mean_around()
        # Exact for rows that are linear in cos(theta) between the angles.
        return float(np.sum(0.5 * (rows[1:] + rows[:-1]) * -np.diff(np.cos(theta))) / 2.0)

    def _mean_around(self) -> np.ndarray:
        if len(self.horizontal) == 1:
            rows: np.ndarray = self.candela[0]
            return rows
        step = np.diff(self.horizontal)
        between = 0.5 * (self.candela[1:] + self.candela[:-1])
        mean: np.ndarray = (between * step[:, None]).sum(axis=0) / step.sum()
        return mean


def read_profile(path: Path) -> Profile:
    """Read an .ies file with type C photometry.

    Raises:
        FiptError: ``ies-unreadable``.
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            raise FiptError("ies-unreadable", f"{path} is larger than 1 MB.", _REMEDY)
        text = path.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise FiptError("ies-unreadable", f"{path} can't be read ({error.strerror}).", _REMEDY) from error
    try:
        return _parse(text)
    except (ValueError, IndexError, OverflowError) as error:
        raise FiptError("ies-unreadable", f"{path} is no IES profile ({error}).", _REMEDY) from error


def set_profile(light: bpy.types.Object, profile: Profile) -> None:
    """Let a Blender light send its light as a luminaire does, along its -Z axis, at its present power.

    The light becomes a point, for which such tables are measured; `remove_profile` restores its shape.

    Args:
        light: an area, point or spot light; its nodes are replaced.
        profile: from `read_profile`.

    Raises:
        FiptError: ``ies-dark``.
    """
    mean = profile.mean()
    if mean <= 0.0:
        raise FiptError("ies-dark", "This profile has no light.", _REMEDY)
    if PROFILE not in light:
        size = getattr(light.data, "shadow_soft_size", 0.5 * getattr(light.data, "size", 0.1))
        light[PROFILE] = json.dumps({"type": light.data.type})
        light.data.type = "POINT"
        light.data.shadow_soft_size = min(size, 0.05)
    if hasattr(light.data, "use_nodes"):  # always on from Blender 5.0
        light.data.use_nodes = True
    nodes, links = light.data.node_tree.nodes, light.data.node_tree.links
    earlier = _remove_nodes(light)
    node = nodes.new("ShaderNodeTexIES")
    node.name, node.location = _NODE, (-240, 0)
    node.mode, node.ies = "INTERNAL", bpy.data.texts.new(f"{light.name}.ies")
    node.ies.write(profile.text)
    node.inputs["Strength"].default_value = 1.0 / (mean * _PER_CANDELA)
    links.new(node.outputs["Fac"], _emission(light).inputs["Strength"])
    _remove_unused(earlier)


def remove_profile(light: bpy.types.Object) -> None:
    """Let a light shine as before `set_profile`, if it was used."""
    if PROFILE not in light:
        return
    text = _remove_nodes(light)
    light.data.type = json.loads(light[PROFILE])["type"]
    remove_marks(light, PROFILE)
    if hasattr(light.data, "use_nodes"):
        light.data.use_nodes = False
    _remove_unused(text)


def _emission(light: bpy.types.Object) -> bpy.types.Node:
    nodes, links = light.data.node_tree.nodes, light.data.node_tree.links
    found = next((node for node in nodes if node.type == "EMISSION"), None)
    if found is None:
        found = nodes.new("ShaderNodeEmission")
        output = next((node for node in nodes if node.type == "OUTPUT_LIGHT"), None)
        output = output or nodes.new("ShaderNodeOutputLight")
        links.new(found.outputs["Emission"], output.inputs["Surface"])
    return found


def _remove_nodes(light: bpy.types.Object) -> bpy.types.Text | None:
    """Remove our node of a light; returns its text."""
    tree = light.data.node_tree
    node = None if tree is None else tree.nodes.get(_NODE)
    if node is None:
        return None
    text = node.ies
    tree.nodes.remove(node)
    return text


def _remove_unused(text: bpy.types.Text | None) -> None:
    if text is not None and text.users <= 1:  # a text always has one user
        bpy.data.texts.remove(text)


def _parse(text: str) -> Profile:
    """The table of an IES file.

    Raises:
        ValueError, IndexError: it is damaged, or its photometry is not of type C.
    """
    head, found, tail = text.partition("TILT=")
    if not head.lstrip().startswith("IES") or not found:
        raise ValueError("its first lines are missing")
    first, _, rest = tail.partition("\n")
    if first.strip().upper() not in ("NONE", "INCLUDE"):
        raise ValueError("its tilt is in another file")
    words = rest.replace(",", " ").split()
    if first.strip().upper() == "INCLUDE":
        words = words[2 + 2 * int(words[1]) :]
    numbers = np.array([float(word) for word in words[:13]])
    verticals, horizontals, photometry = int(numbers[3]), int(numbers[4]), int(numbers[5])
    count = verticals * horizontals
    if photometry != 1:
        raise ValueError("only photometry of type C is supported")
    if verticals < 2 or horizontals < 1 or count > 100_000:
        raise ValueError(f"it has {verticals} x {horizontals} angles")
    values = np.array([float(word) for word in words[13 : 13 + verticals + horizontals + count]])
    if len(values) != verticals + horizontals + count or not np.isfinite(values).all():
        raise ValueError("values are missing")
    vertical, horizontal = values[:verticals], values[verticals : verticals + horizontals]
    candela = values[verticals + horizontals :].reshape(horizontals, verticals)
    if (np.diff(vertical) <= 0.0).any() or (np.diff(horizontal) <= 0.0).any():
        raise ValueError("its angles do not ascend")
    factor = numbers[2] * numbers[10] * numbers[11]  # multiplier, ballast, ballast-lamp photometric factor
    return Profile(text, vertical, horizontal, np.maximum(candela, 0.0) * factor)
