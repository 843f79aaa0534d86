# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What versions of a run differ in, as figures and for people. Standard library only."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from .runfolder import RunFolder
from .shapes import DOUBTS, EMITTERS, PARTS, QUALITY, STATISTICS
from .versions import Version, list_versions, optional_document, version_folder


@dataclass(frozen=True)
class Figures:
    """What two versions are compared by; None where it is not known.

    Attributes:
        seconds: that its stages took.
        lamps: number of fixtures.
        power: watts of all fixtures, the mean of the channels.
        environment: whether light comes from outside.
        parts: base colour (mean of the channels), roughness and metallic of each part, by its name.
        doubts: number of questions.
        held_back: dB with which photographs that were held back are re-rendered.
    """

    seconds: float | None
    lamps: int | None
    power: float | None
    environment: bool | None
    parts: Mapping[str, tuple[float, float, float]]
    doubts: int | None
    held_back: float | None


def figures(run: RunFolder, version: str) -> Figures:
    """The figures of a version.

    Raises:
        FiptError: ``version-missing``.
    """
    folder = version_folder(run, version)
    statistics = optional_document(folder.statistics_json, STATISTICS)
    seconds = [stage.get("seconds") or 0.0 for stage in statistics.get("stages", [])]
    emitters = optional_document(folder.emitters_json, EMITTERS)
    power = [sum(lamp["power"]) / 3.0 for lamp in emitters.get("fixtures", []) if "power" in lamp]
    doubts = optional_document(folder.doubts_json, DOUBTS)
    parts = {
        part["name"]: (sum(part["base_color"]) / 3.0, part["roughness"], part["metallic"])
        for part in optional_document(folder.parts_json, PARTS).get("parts", [])
        if part.get("base_color") and None not in (part.get("roughness"), part.get("metallic"))
    }
    return Figures(
        seconds=round(sum(seconds), 1) if seconds else None,
        lamps=len(emitters["fixtures"]) if emitters else None,
        power=sum(power) if emitters else None,
        environment=bool(emitters["environment"]) if emitters else None,
        parts=parts,
        doubts=len(doubts["doubts"]) if doubts else None,
        held_back=optional_document(folder.quality_json, QUALITY).get("held_back_db"),
    )


def comparison(run: RunFolder, first: str, second: str, parts: int) -> list[tuple[str, str, str]]:
    """What two versions differ in, for people: a name, and the values of both.

    Args:
        run: the run folder.
        first, second: ids of versions.
        parts: so many of those whose material differs most, with base colour, roughness and metallic; their
            names are in quotes.

    Raises:
        FiptError: ``version-missing``.
    """
    listed = {version.id: version for version in list_versions(run)}
    one, other = figures(run, first), figures(run, second)

    def row(name: str, show: Callable[[Version, Figures], str]) -> tuple[str, str, str]:
        return name, show(listed[first], one), show(listed[second], other)

    rows = [
        row("Version", lambda version, _: version.title),
        row("Preset", lambda version, _: version.preset.capitalize()),
        row("Settings", lambda version, _: ", ".join(version.changes) or "-"),
        row("Hints", lambda version, _: ", ".join(version.hints) or "-"),
        row("Time", lambda _, found: _number(found.seconds, "{:.0f} s")),
        row("Held back", lambda _, found: _number(found.held_back, "{:.1f} dB")),
        row("Lamps", lambda _, found: _number(found.lamps, "{}")),
        row("Power", lambda _, found: _number(found.power, "{:.4g} W")),
        row("Environment", lambda _, found: {None: "-", True: "yes", False: "no"}[found.environment]),
        row("Parts", lambda _, found: str(len(found.parts))),
        row("Questions", lambda _, found: _number(found.doubts, "{}")),
    ]
    for name in changed_parts(one, other)[:parts]:

        def values(_: Version, found: Figures, name: str = name) -> str:
            return " ".join(f"{value:.2f}" for value in found.parts[name])

        rows.append(row(f"'{name}'", values))
    return rows


def _number(value: float | None, text: str) -> str:
    return "-" if value is None else text.format(value)


def changed_parts(first: Figures, second: Figures) -> list[str]:
    """Names of the parts that both have, those whose material differs most first."""
    distance = {
        name: max(abs(a - b) for a, b in zip(values, second.parts[name], strict=True))
        for name, values in first.parts.items()
        if name in second.parts
    }
    return sorted((name for name in distance if distance[name] > 0.0), key=lambda name: -distance[name])
