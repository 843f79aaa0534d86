"""The build of PyTorch for this machine: for the CPU, or for a version of CUDA that the driver supports.

Standard library only.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass

from ..core.device.cuda import Gpu

# Download site of the PyTorch project with a folder per build; the general package index has only one build.
TORCH_INDEX = "https://download.pytorch.org/whl"
# CUDA builds of the pinned version: name, least CUDA version of the driver, range of compute capabilities.
_CUDA_BUILDS = (("cu130", 13000, (7, 5), (12, 1)), ("cu126", 12000, (5, 0), (9, 0)))


@dataclass(frozen=True)
class Size:
    """Approximate needs of an environment with a build (GB): downloads, and disk space to install it."""

    download_gb: float
    disk_gb: float

    @property
    def torch_gb(self) -> float:
        """PyTorch itself, without the packages that it needs."""
        return 0.2 if self.download_gb < 1.0 else 0.9


LOCKED_GB = 0.3  # the engine's other packages, to download
SIZES = {
    "": Size(3.0, 9.0) if sys.platform == "linux" else Size(0.5, 2.5),
    "cpu": Size(0.5, 2.5),
    "cu126": Size(3.2, 10.0),
    "cu130": Size(3.0, 9.0),
}


def choose_torch_build(device: str, driver: int | None, gpus: Sequence[Gpu]) -> str:
    """The build to install, a key of `SIZES`; "" if that of the package index is the right one.

    Args:
        device: the preference: "auto", "cuda" or "llvm".
        driver: the NVIDIA driver's CUDA version, e.g. 12040; None without a GPU.
        gpus: the GPUs; preferably all of them can run the build.
    """
    name = "cpu"
    if device != "llvm" and driver is not None and gpus:
        lowest, highest = min(gpu.capability for gpu in gpus), max(gpu.capability for gpu in gpus)
        supported = [build for build in _CUDA_BUILDS if driver >= build[1]]
        for_all_gpus = [build for build in supported if build[2] <= lowest and highest <= build[3]]
        best = (for_all_gpus or supported)[:1]
        name = best[0][0] if best else "cpu"
    index_build = {"linux": "cu130", "win32": "cpu", "darwin": "cpu"}.get(sys.platform)
    return "" if name == index_build else name


def torch_index(build: str) -> str:
    """Address of a build; "" for that of the package index."""
    return f"{TORCH_INDEX}/{build}" if build else ""


def torch_requirement(requirements: Sequence[str], build: str) -> str:
    """PyTorch's pin with the build in its version, e.g. "torch==2.13.0+cpu"; "" without pin or build."""
    pin = next((requirement for requirement in requirements if requirement.startswith("torch==")), "")
    name, semicolon, marker = pin.partition(";")
    return f"{name.strip()}+{build}{semicolon}{marker}" if pin and build else ""
