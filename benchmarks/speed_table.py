# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The result of benchmarks/speed.py as text: times by stage, errors of shadings, accuracy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks import accuracy

_NAMES = ("reference", "shipped")


def format_result(result: Mapping[str, Any]) -> str:
    """All tables."""
    parts = [format_stages(result), format_errors(result)]
    parts += [
        f"accuracy, {name}\n{accuracy.format_table(_with_costs(result, name))}"
        for name in _NAMES
        if "accuracy" in result[name]
    ]
    parts.append(
        f"ratio {_number(result['ratio'], '.2f')} (processor time {_number(result['cpu_ratio'], '.2f')})"
    )
    return "\n\n".join(part for part in parts if part)


def _with_costs(result: Mapping[str, Any], name: str) -> dict[str, Any]:
    record = result[name]
    costs = {key: record[key] for key in ("seconds", "peak_memory_gb")}
    return {**record["accuracy"], **costs, "version": result["machine"]["product"]}


def format_stages(result: Mapping[str, Any]) -> str:
    """One line per stage with both configurations: seconds, processor seconds, rays, memory."""
    columns = ("s", "median", "cpu s", "Mrays", "Mrays/s", "GB")
    head = "".join(f"{column:>9s}" for column in columns)
    lines = [f"{'':14s}" + "".join(f"{name:>{9 * len(columns)}s}" for name in _NAMES) + f"{'ratio':>9s}"]
    lines.append(f"{'':14s}" + head * 2)
    stages = {name: {stage["name"]: stage for stage in result[name]["stages"]} for name in _NAMES}
    names = list(dict.fromkeys(stage for name in _NAMES for stage in stages[name]))
    names.sort(key=lambda stage: stage == "other")
    for stage in names:
        both = [stages[name].get(stage, {}) for name in _NAMES]
        lines.append(f"{stage:14s}" + "".join(_cells(each) for each in both) + _ratio(both))
    both = [result[name] for name in _NAMES]
    lines.append(f"{'all':14s}" + "".join(_cells(each) for each in both) + _ratio(both))
    return "\n".join(lines)


def _cells(stage: Mapping[str, Any]) -> str:
    rays = stage.get("rays")
    values = [stage.get(key) for key in ("seconds", "median_seconds", "cpu_seconds")]
    values += [rays / 1e6 if rays else None, stage.get("mrays_per_second"), stage.get("peak_memory_gb")]
    return "".join(
        f"{_number(value, digits):>9s}"
        for value, digits in zip(values, (".1f", ".1f", ".1f", ".1f", ".2f", ".2f"), strict=True)
    )


def _ratio(both: Sequence[Mapping[str, Any]]) -> str:
    first, second = (each.get("seconds") for each in both)
    return f"{first / second:9.2f}" if first is not None and second else f"{'-':>9s}"


def format_errors(result: Mapping[str, Any]) -> str:
    """Relative errors of the shadings after stage 1 and each stage 3; empty without ground truth."""
    levels = result.get("shading_levels", ())
    titles = ["L_d", *(f"{term} {level:g}" for term in ("L_s0", "L_s1") for level in levels)]
    lines = []
    for name in _NAMES:
        for stage in result[name]["stages"]:
            error = stage.get("shading_error")
            if error:
                values = [error["L_d"], *error["L_s0"], *error["L_s1"]]
                cells = "".join(f"{value:11.4f}" for value in values)
                lines.append(f"{name + ' ' + stage['name']:26s}{cells}")
    if not lines:
        return ""
    head = f"{'relative RMSE, γ = 1/2.2':26s}" + "".join(f"{title:>11s}" for title in titles)
    return "\n".join([head, *lines, f"{result['shading_pixels']} pixels, at roughness σ by interpolation"])


def _number(value: float | None, digits: str) -> str:
    return "-" if value is None else f"{value:{digits}}"
