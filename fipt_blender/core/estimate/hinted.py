# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a run reports of the hints that it has honoured."""

from __future__ import annotations

import numpy as np

from ..material.groups import Units
from ..material.hints import SurfaceHints, values_of_hints
from ..run.result_contents import HintFigures
from ..run.run_files import LeftAlone
from ..run.runfolder import RunFolder
from ..run.store import write_arrays


def hint_facts(hints: SurfaceHints, units: Units) -> list[HintFigures]:
    """One entry per hint for the statistics: its surface, and the values that it has decided."""
    triangles = np.bincount(hints.triangle[hints.triangle >= 0], minlength=len(hints.names))
    unit = values_of_hints(hints, units.triangle)
    none = np.full((1, 2), np.nan)
    fixed = np.concatenate([none[:0] if units.fixed is None else units.fixed, none])
    fixed = fixed[np.where(unit < len(fixed) - 1, unit, -1)]
    return [
        HintFigures(
            name=name,
            triangles=int(triangles[row]),
            roughness=None if np.isnan(fixed[row, 0]) else round(float(fixed[row, 0]), 4),
            metallic=None if np.isnan(fixed[row, 1]) else round(float(fixed[row, 1]), 4),
            emits={0: None, 1: True, -1: False}[int(hints.emits[row])],
            left_alone=bool(hints.left_alone[row]),
        )
        for row, name in enumerate(hints.names)
    ]


def area_names(hints: SurfaceHints | None, units: Units) -> dict[int, str]:
    """The hints' names of the units that they have made."""
    if hints is None:
        return {}
    unit = values_of_hints(hints, units.triangle)
    return {int(unit[row]): name for row, name in enumerate(hints.names) if hints.own[row] and unit[row] >= 0}


def write_left_alone(folder: RunFolder, left_alone: np.ndarray | None) -> None:
    """Write into new results which triangles ((T,) bool) keep their own material; no file without any.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    if left_alone is not None:
        write_arrays(folder.left_alone_npz, LeftAlone(left_alone))
