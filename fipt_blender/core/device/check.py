"""Engine command `check`: packages, devices and memory of this machine, and what is missing."""

from __future__ import annotations

import argparse
import importlib.metadata
import os
import platform
import sys
from collections.abc import Iterable, Sequence

from ..run.errors import FiptError
from ..run.messages import Reporter
from ..run.runfolder import PRODUCT_VERSION
from .cuda import VISIBLE_VARIABLE, Gpu, cuda_devices
from .llvm import find_llvm
from .variant import cuda_verdict

PACKAGES = (
    *("mitsuba", "drjit", "torch", "numpy", "OpenEXR", "OpenImageIO"),
    *("pycolmap", "pyoidn", "pillow", "jinja2", "psutil", "scipy"),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments: the choices of the preferences."""
    parser.add_argument("--device", choices=("auto", "cuda", "llvm"), default="auto")
    parser.add_argument("--gpu", default="", metavar="UUID", help="the GPU to use (default: the first)")


def run(arguments: argparse.Namespace, reporter: Reporter) -> None:
    """Report the engine's interpreter, packages and devices; warn of what is missing.

    ``data`` of the message ``done``: ``product_version, python, interpreter, platform, packages`` (version or
    null by name), ``llvm`` (path or null), ``cuda`` (name of the GPU that works, or null), ``gpus`` (name,
    uuid and memory_gb of each), ``device`` (which one the setting chooses, or null), ``oidn``, ``cores``,
    ``memory_gb``, ``memory_free_gb``, ``ready``.
    """
    packages = package_versions(PACKAGES)
    missing = [name for name, version in packages.items() if version is None]
    for name in missing:
        reporter.warning("package-missing.run", name=name)
    gpus = cuda_devices()  # all of them; afterwards only the chosen one is visible to this process
    if arguments.gpu:
        os.environ[VISIBLE_VARIABLE] = arguments.gpu
    llvm: str | None = None
    cuda: str | None = None
    if packages["mitsuba"] and packages["drjit"]:
        if arguments.device != "llvm":
            cuda = find_cuda(gpus, arguments, reporter)
        llvm = _find_llvm(cuda is not None, reporter)
    oidn = oidn_works()
    if not oidn:
        reporter.warning("oidn-missing")
    total, free = memory_gb()
    if free is not None and free < 4.0:
        reporter.warning("memory-low", free=free)
    device = "cuda" if cuda else "llvm" if llvm and arguments.device != "cuda" else None
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
            "gpus": [{"name": gpu.name, "uuid": gpu.uuid, "memory_gb": gpu.memory_gb} for gpu in gpus],
            "device": device,
            "oidn": oidn,
            "cores": usable_cores(),
            "memory_gb": total,
            "memory_free_gb": free,
            "ready": device is not None and not missing,
        },
    )


def find_cuda(gpus: Sequence[Gpu], arguments: argparse.Namespace, reporter: Reporter) -> str | None:
    """Name of the GPU that the engine can use, or None; warns if there is one that it can't use."""
    chosen = [gpu for gpu in gpus if arguments.gpu in ("", gpu.uuid)]
    if gpus and not chosen:
        reporter.warning("gpu-missing")
    elif not gpus and arguments.device == "cuda":
        reporter.warning("cuda-missing.find-cuda-2")
    if not chosen:
        return None
    name = chosen[0].name
    try:
        verdict = cuda_verdict()
    except FiptError as error:
        reporter.warn(error)
        return None
    if not verdict.works:
        reporter.warning("cuda-missing.find-cuda", name=name, reason=verdict.reason)
        return None
    if not torch_has_cuda():
        reporter.warning("torch-cpu", name=name)
    return name


def _find_llvm(has_gpu: bool, reporter: Reporter) -> str | None:
    """Path of an LLVM that works, or None; warns, unless a GPU is used and LLVM is simply missing."""
    try:
        return str(find_llvm())
    except FiptError as error:
        if not has_gpu or error.code != "llvm-missing":
            reporter.warn(error)
        return None


def torch_has_cuda() -> bool:
    """Whether the installed PyTorch computes on a GPU."""
    try:
        import torch

        return bool(torch.cuda.is_available())
    except (ImportError, OSError, RuntimeError):
        return False


def package_versions(names: Iterable[str]) -> dict[str, str | None]:
    """Version of each package, None if it is missing."""
    versions: dict[str, str | None] = {}
    for name in names:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            versions[name] = None
    return versions


def usable_cores() -> int:
    """Number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def memory_gb() -> tuple[float | None, float | None]:
    """Total and free memory in GB (1e9 bytes); None if psutil is missing."""
    try:
        import psutil
    except ImportError:
        return None, None
    memory = psutil.virtual_memory()
    return round(memory.total / 1e9, 2), round(memory.available / 1e9, 2)


def oidn_works() -> bool:
    """Whether a device of Open Image Denoise can be created."""
    try:
        import pyoidn

        with pyoidn.Device() as device:
            device.commit()
            return device.get_error() is None
    except (ImportError, OSError, RuntimeError):
        return False
