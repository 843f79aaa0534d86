# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Results of an estimation in open formats: fields, parts, fixtures and the environment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..capture.images import write_exr
from ..light.emitters import Fixture
from ..light.environment import Environment
from ..material.fields import RoomFields
from ..run.messages import Reporter
from ..run.runfolder import RunFolder, write_json


@dataclass(frozen=True)
class RoomLight:
    """What lights the room; radiance in units of the capture's median.

    Attributes:
        fixtures: lamps on the mesh.
        environment: light from outside the mesh, if any.
        missing: lamps that the mesh lacks (:class:`.checks.view_check.ViewCheck`).
    """

    fixtures: Sequence[Fixture]
    environment: Environment | None
    missing: Sequence[Mapping[str, Any]] = ()


def write_results(
    folder: RunFolder, fields: RoomFields, light: RoomLight, scale: float, reporter: Reporter
) -> None:
    """Write the results folder except for the statistics.

    Args:
        scale: the capture's median radiance, in the photographs' units.
        reporter: gets the warning ``no-emitter`` if nothing lights the room.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    fields.save(folder)
    environment, described_environment = light.environment, None
    if environment is not None and environment.image.any():
        write_exr(folder.environment_exr, environment.image * scale)
        described_environment = {
            "image": folder.environment_exr.name,
            "observed_share": environment.observed_share,
        }
    described = [
        _describe(fixture, f"Fixture.{number:03d}", scale)
        for number, fixture in enumerate(light.fixtures, start=1)
    ]
    if not described and environment is None:
        reporter.warning(
            "no-emitter",
            "No surface was found to emit light, and no view looks outside.",
            "Check that the photographs show the lamps and that the lamps are not over-exposed.",
        )
    missing = [
        {
            "position": list(lamp["position"]),
            "radius": lamp["radius"],
            "radiance": [scale * value for value in lamp["radiance"]],
            "inferred": lamp.get("inferred", False),
        }
        for lamp in [*light.missing, *(environment.lamps if environment is not None else ())]
    ]
    emitters = {"fixtures": described, "environment": described_environment, "missing": missing}
    write_json(folder.emitters_json, emitters)


def _describe(fixture: Fixture, name: str, scale: float) -> dict[str, Any]:
    """A fixture's entry in emitters.json, in the photographs' units; power: pi A L of both sides (watts)."""
    front, back = fixture.radiance * scale, fixture.back_radiance * scale
    return {
        "name": name,
        "triangles": fixture.triangles.tolist(),
        "radiance": front.tolist(),
        "back_radiance": back.tolist(),
        "area": fixture.area,
        "centroid": fixture.centroid.tolist(),
        "power": (np.pi * fixture.area * (front + back)).tolist(),
        "probability": round(fixture.probability, 3),
    }
