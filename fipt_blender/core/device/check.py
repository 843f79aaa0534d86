# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Engine command `check`: what this machine and environment offer, and what to mend."""

from __future__ import annotations

import argparse
import importlib.metadata
import os
import platform
import sys
from pathlib import Path

from ..job.errors import FiptError
from ..job.messages import Reporter
from ..job.runfolder import PRODUCT_VERSION
from .llvm import find_llvm
from .variant import cuda_device_name, cuda_verdict

PACKAGES = (
    *("mitsuba", "drjit", "torch", "numpy", "OpenEXR"),
    *("pycolmap", "pyoidn", "pillow", "jinja2", "psutil"),
)
LITTLE_MEMORY_GB = 4.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """`check` takes no arguments."""


def run(arguments: argparse.Namespace, reporter: Reporter) -> None:
    """Report the engine's interpreter, packages and devices; what is missing becomes warnings.

    ``data`` of the closing message: ``product_version, python, interpreter, platform, packages`` (name to
    version or null), ``llvm`` (path or null), ``cuda`` (device name or null), ``device`` (what "auto"
    takes, or null), ``oidn``, ``cores``, ``memory_gb``, ``memory_free_gb``, ``ready``.
    """
    packages = package_versions()
    for name, version in packages.items():
        if version is None:
            reporter.warning(
                "package-missing", f"The package {name} is missing.", "Create the engine's environment again."
            )
    python = Path(sys.executable)
    llvm: str | None = None
    cuda: str | None = None
    if packages["mitsuba"] and packages["drjit"]:
        try:
            llvm = str(find_llvm(python))
        except FiptError as error:
            reporter.warning(error.code, error.text, error.remedy)
        if (gpu := cuda_device_name()) is not None:
            try:
                verdict = cuda_verdict(python)
            except FiptError as error:
                reporter.warning(error.code, error.text, error.remedy)
            else:
                cuda = gpu if verdict.works else None
                if not verdict.works:
                    reporter.warning(
                        "cuda-missing",
                        f"{gpu} can't be used: {verdict.reason}.",
                        "Update NVIDIA's driver; the CPU is used meanwhile.",
                    )
    oidn = oidn_works()
    if not oidn:
        reporter.warning(
            "oidn-missing",
            "Open Image Denoise does not work here.",
            "Create the engine's environment again, or switch the setting 'denoise' off.",
        )
    total, free = memory_gb()
    if free is not None and free < LITTLE_MEMORY_GB:
        reporter.warning(
            "memory-low",
            f"Only {free:.1f} GB of memory are free.",
            "Close other programs, or use fewer views.",
        )
    device = "cuda" if cuda else "llvm" if llvm else None
    reporter.done(
        files=[],
        data={
            "product_version": PRODUCT_VERSION,
            "python": platform.python_version(),
            "interpreter": sys.executable,
            "platform": platform.platform(),
            "packages": packages,
            "llvm": llvm,
            "cuda": cuda,
            "device": device,
            "oidn": oidn,
            "cores": usable_cores(),
            "memory_gb": total,
            "memory_free_gb": free,
            "ready": device is not None and all(packages.values()),
        },
    )


def package_versions() -> dict[str, str | None]:
    """Version of each package that the engine needs, None where it is missing."""
    versions: dict[str, str | None] = {}
    for name in PACKAGES:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            versions[name] = None
    return versions


def usable_cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def memory_gb() -> tuple[float | None, float | None]:
    """Total and free memory in GB (1e9 bytes); None where psutil is missing."""
    try:
        import psutil
    except ImportError:
        return None, None
    memory = psutil.virtual_memory()
    return round(memory.total / 1e9, 2), round(memory.available / 1e9, 2)


def oidn_works() -> bool:
    """Whether an Open Image Denoise device can be made."""
    try:
        import pyoidn

        with pyoidn.Device() as device:
            device.commit()
            return device.get_error() is None
    except (ImportError, OSError, RuntimeError):
        return False
