"""A small workload that tests one Mitsuba variant; this file is run as a script in a child process.

An unsuitable LLVM raises no exception but aborts the process. Therefore only the child's output and exit
status are evaluated. At import this file needs only the standard library.
"""

from __future__ import annotations

import ctypes
import json
import sys
from collections.abc import Sequence

IMPORTED = "fipt-probe-imported"
PASSED = "fipt-probe-passed"


def preload(libraries: Sequence[str]) -> None:
    """Load shared libraries that depend on one another, given in any order.

    A library whose dependencies are not loaded yet fails and is tried again; the loader finds loaded
    libraries by their names, in whichever folder they are. Libraries that can't be loaded at all are skipped:
    if they are needed, a later error names them.
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
    """Trace paths through a small scene, run a loop and a scatter, and compare with known values.

    Raises:
        RuntimeError: if a value is wrong.
    """
    import drjit as dr
    import mitsuba as mi

    print(IMPORTED, flush=True)
    mi.set_variant(variant)

    # A furnace test: inside a closed box of albedo 0.5 that emits 1, the radiance is 1 / (1 - 0.5).
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
        raise RuntimeError(f"the furnace test gives {mean} instead of 2")

    index = dr.arange(mi.UInt32, 1000)
    count, total = dr.while_loop((index, mi.UInt32(0)), lambda i, t: i > 0, lambda i, t: (i - 1, t + 2))
    if dr.sum(total)[0] != 999000 or dr.sum(count)[0] != 0:
        raise RuntimeError("the loop gives wrong results")
    bins = dr.zeros(mi.Float, 16)
    dr.scatter_add(bins, mi.Float(1.0), index % 16)
    if dr.sum(bins)[0] != 1000.0:
        raise RuntimeError("the scatter lost values")
    print(PASSED, flush=True)


if __name__ == "__main__":
    # argv: variant, JSON list of folders for sys.path, JSON list of libraries to load first
    sys.path[:] = [*sys.path, *(entry for entry in json.loads(sys.argv[2]) if entry not in sys.path)]
    preload(json.loads(sys.argv[3]))
    run_workload(sys.argv[1])
