# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the steps of `prepare` have found out (stage/STEP.json), as the report and the panel read it.

Standard library only: Blender's side imports it.
"""

from __future__ import annotations

from typing import Any

from ..core.run.documents import Fields, Items, Maybe, Number, Numbers, read_json
from .preparation import PreparationFolder

_SHARE = Maybe(Number(0.0, 1.0))
_SIZE = Maybe(Number(low=0.0))
_EVERY_STEP = {
    "seconds": Number(low=0.0),
    "messages": Items(Fields(dict.fromkeys(("code", "text", "remedy"), str))),
}
# Of each step, what is read of its facts; all of it may be missing.
_FACTS: dict[str, dict[str, Any]] = {
    "read": {"skipped": Items(Fields({"path": str, "reason": str}))},
    "merge": {
        "images": Items(
            Fields({"name": str}, {"clipped_share": _SHARE, "moved_share": _SHARE, "shift_pixels": _SIZE})
        ),
        "response": Maybe(Fields({"curves": Numbers(None, None)}, {"uncertainty": _SIZE})),
    },
    "solve": {
        "registered": Items(Fields({"name": str}, {"points": _SIZE, "reprojection_error": _SIZE})),
        "left_out": Items(Fields({"name": str, "reason": str}, {"remedy": str})),
        "reprojection_error": _SIZE,
    },
    "vignetting": {
        "lenses": Items(
            Fields(
                {"lens": str, "applied": bool},
                {"corner": _SIZE, "corner_error": _SIZE, "source": str, "views": Number(low=0, whole=True)},
            )
        )
    },
    "scale": {"meters_per_unit": _SIZE},
}


def read_facts(folder: PreparationFolder, step: str) -> dict[str, Any]:
    """What a step has noted; empty if it has not run.

    Raises:
        FiptError: ``file-damaged``.
    """
    path = folder.facts(step)
    if not path.exists():
        return {}
    remedy = f"Repeat the step '{step}'."
    return read_json(path, Fields(optional={**_EVERY_STEP, **_FACTS[step]}), remedy)


def shutter_text(seconds: float | None) -> str:
    """A shutter time as cameras show it: "1/250 s", "0.5 s"; "?" if it is unknown."""
    if not seconds:
        return "?"
    # Cameras write shorter times as fractions.
    return f"{seconds:.3g} s" if seconds >= 0.4 else f"1/{1.0 / seconds:.0f} s"
