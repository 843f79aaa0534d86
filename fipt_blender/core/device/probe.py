# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A small real workload for one Mitsuba variant, run as a script in a child process.

A wrong LLVM does not raise: it aborts the process. So this file is run by path in a child, and only its
output and exit status are looked at. Standard library only at import.
"""

from __future__ import annotations

import ctypes
import json
import sys
from collections.abc import Sequence

IMPORTED = "fipt-probe-imported"
PASSED = "fipt-probe-passed"


def preload(libraries: Sequence[str]) -> None:
    """Load shared libraries that depend on each other in any order.

    A library whose own dependencies are not there yet fails and is tried again; the loader then finds
    the loaded ones by their names, wherever they lie. Those that never load are left out: whoever needs
    them says so.
    """
    waiting = list(libraries)
    progress = True
    while waiting and progress:
        progress = False
        for library in list(waiting):
            try:
                ctypes.CDLL(library)
            except OSError:
                continue
            waiting.remove(library)
            progress = True


def run_workload(variant: str) -> None:
    """Trace paths through a small scene, run a loop, scatter; compare with known values.

    Raises:
        RuntimeError: where a value is wrong.
    """
    import drjit as dr
    import mitsuba as mi

    print(IMPORTED, flush=True)
    mi.set_variant(variant)

    # A closed white box whose inside emits 1: every path returns 1 / (1 - 0.5) (a furnace).
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 64, "rr_depth": 1000},
            "box": {
                "type": "cube",
                "flip_normals": True,
                "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.5}},
                "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 1.0}},
            },
            "sensor": {"type": "perspective", "film": {"type": "hdrfilm", "width": 16, "height": 16}},
        }
    )
    image = mi.render(scene, spp=16, seed=1)
    mean = dr.mean(image, axis=None).array[0]
    if not abs(mean - 2.0) < 0.1:
        raise RuntimeError(f"a furnace of radiance 2 rendered as {mean}")

    index = dr.arange(mi.UInt32, 1000)
    count, total = dr.while_loop((index, mi.UInt32(0)), lambda i, t: i > 0, lambda i, t: (i - 1, t + 2))
    if dr.sum(total)[0] != 999000 or dr.sum(count)[0] != 0:
        raise RuntimeError("a loop counted wrongly")
    bins = dr.zeros(mi.Float, 16)
    dr.scatter_add(bins, mi.Float(1.0), index % 16)
    if dr.sum(bins)[0] != 1000.0:
        raise RuntimeError("a scatter lost values")
    print(PASSED, flush=True)


if __name__ == "__main__":
    # argv: variant, JSON list of folders for sys.path, JSON list of libraries to load first
    sys.path[:] = [*sys.path, *(entry for entry in json.loads(sys.argv[2]) if entry not in sys.path)]
    preload(json.loads(sys.argv[3]))
    run_workload(sys.argv[1])
