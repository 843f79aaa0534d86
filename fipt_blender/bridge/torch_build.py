# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Which of PyTorch's builds fits this machine: the CPU's, or a CUDA's that the driver can run.

Standard library only.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass

from ..core.device.cuda import Gpu

# PyTorch's project keeps its builds here, one folder each; the general package index has one build alone.
TORCH_INDEX = "https://download.pytorch.org/whl"
# CUDA builds of the pinned version: name, CUDA version that the driver must have, compute capabilities.
_CUDA_BUILDS = (
    ("cu130", 13000, (7, 5), (12, 1)),
    ("cu126", 12000, (5, 0), (9, 0)),
)


@dataclass(frozen=True)
class Size:
    """About what an environment with a build needs: to download, and on the disk meanwhile (GB)."""

    download_gb: float
    disk_gb: float


SIZES = {
    "": Size(3.0, 9.0) if sys.platform == "linux" else Size(0.5, 2.5),
    "cpu": Size(0.5, 2.5),
    "cu126": Size(3.2, 10.0),
    "cu130": Size(3.0, 9.0),
}


def choose_torch_build(device: str, driver: int | None, gpus: Sequence[Gpu]) -> str:
    """The build to install, a key of `SIZES`; "" where the package index's own is the right one.

    Args:
        device: the preference: "auto", "cuda" or "llvm".
        driver: the NVIDIA driver's CUDA version, e.g. 12040; None without a GPU.
        gpus: the GPUs; all of them should be able to run the build.
    """
    build = "cpu"
    if device != "llvm" and driver is not None and gpus:
        lowest, highest = min(gpu.capability for gpu in gpus), max(gpu.capability for gpu in gpus)
        fitting = [each for each in _CUDA_BUILDS if driver >= each[1]]
        whole = [each for each in fitting if each[2] <= lowest and highest <= each[3]]
        best = (whole or fitting)[:1]
        build = best[0][0] if best else "cpu"
    own = {"linux": "cu130", "win32": "cpu", "darwin": "cpu"}.get(sys.platform)
    return "" if build == own else build


def torch_index(build: str) -> str:
    """Where a build lies; "" for the package index's own."""
    return f"{TORCH_INDEX}/{build}" if build else ""


def torch_requirement(requirements: Sequence[str], build: str) -> str:
    """PyTorch's pin with the build in its version, e.g. "torch==2.13.0+cpu"; "" where there is none."""
    pin = next((each for each in requirements if each.startswith("torch==")), "")
    name, semicolon, marker = pin.partition(";")
    return f"{name.strip()}+{build}{semicolon}{marker}" if pin and build else ""
