# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What versions of a run differ in, as figures and for people. Standard library only."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from .documents import optional_document
from .result_contents import Doubts, Emitters, PartList, QualityFigures, Statistics
from .runfolder import RunFolder
from .versions import Version, list_versions, version_folder


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
    statistics = optional_document(folder.statistics_json, Statistics) or Statistics()
    seconds = [stage.seconds or 0.0 for stage in statistics.stages]
    emitters = optional_document(folder.emitters_json, Emitters)
    doubts = optional_document(folder.doubts_json, Doubts)
    listed = optional_document(folder.parts_json, PartList)
    quality = optional_document(folder.quality_json, QualityFigures)
    parts = {
        part.name: (sum(part.base_color) / 3.0, part.roughness, part.metallic)
        for part in (listed.parts if listed else ())
        if part.base_color and part.roughness is not None and part.metallic is not None
    }
    return Figures(
        seconds=round(sum(seconds), 1) if seconds else None,
        lamps=len(emitters.fixtures) if emitters else None,
        power=sum(sum(lamp.power or ()) / 3.0 for lamp in emitters.fixtures) if emitters else None,
        environment=emitters.environment is not None if emitters else None,
        parts=parts,
        doubts=len(doubts.doubts) if doubts else None,
        held_back=quality.held_back_db if quality else None,
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
        row("Time", lambda _, of: _number(of.seconds, "{:.0f} s")),
        row("Held back", lambda _, of: _number(of.held_back, "{:.1f} dB")),
        row("Lamps", lambda _, of: _number(of.lamps, "{}")),
        row("Power", lambda _, of: _number(of.power, "{:.4g} W")),
        row("Environment", lambda _, of: {None: "-", True: "yes", False: "no"}[of.environment]),
        row("Parts", lambda _, of: str(len(of.parts))),
        row("Questions", lambda _, of: _number(of.doubts, "{}")),
    ]
    for name in changed_parts(one, other)[:parts]:

        def values(_: Version, of: Figures, name: str = name) -> str:
            return " ".join(f"{value:.2f}" for value in of.parts[name])

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
