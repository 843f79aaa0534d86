"""The GPUs of this machine according to NVIDIA's driver library. Standard library only."""

from __future__ import annotations

import ctypes
import sys
import uuid
from dataclasses import dataclass

# Environment variable that limits the GPUs visible to a process; its value is a `Gpu.uuid`.
VISIBLE_VARIABLE = "CUDA_VISIBLE_DEVICES"


@dataclass(frozen=True)
class Gpu:
    """One CUDA device.

    Attributes:
        name: the driver's name of it.
        uuid: stable identifier for `VISIBLE_VARIABLE`: "GPU-...".
        memory_gb: its total memory in GB (1e9 bytes).
        capability: compute capability, e.g. (8, 6).
    """

    name: str
    uuid: str
    memory_gb: float
    capability: tuple[int, int]


def cuda_driver_version() -> int | None:
    """The NVIDIA driver's CUDA version, e.g. 12040; None if there is no driver with a GPU."""
    driver = _driver()
    version = ctypes.c_int(0)
    if driver is None or _count(driver) == 0:
        return None
    return version.value if driver.cuDriverGetVersion(ctypes.byref(version)) == 0 else None


def cuda_devices() -> list[Gpu]:
    """The CUDA devices visible to this process, in the driver's order."""
    driver = _driver()
    if driver is None:
        return []
    return [gpu for index in range(_count(driver)) if (gpu := _describe(driver, index)) is not None]


def _driver() -> ctypes.CDLL | None:
    try:
        driver = ctypes.CDLL("nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1")
    except OSError:
        return None
    return driver if driver.cuInit(0) == 0 else None


def _count(driver: ctypes.CDLL) -> int:
    count = ctypes.c_int(0)
    return count.value if driver.cuDeviceGetCount(ctypes.byref(count)) == 0 else 0


def _describe(driver: ctypes.CDLL, index: int) -> Gpu | None:
    device, name, identifier = ctypes.c_int(0), ctypes.create_string_buffer(256), (ctypes.c_ubyte * 16)()
    memory, major, minor = ctypes.c_size_t(0), ctypes.c_int(0), ctypes.c_int(0)
    failed = (
        driver.cuDeviceGet(ctypes.byref(device), index)
        or driver.cuDeviceGetName(name, len(name), device)
        or driver.cuDeviceGetUuid(identifier, device)
        or driver.cuDeviceTotalMem_v2(ctypes.byref(memory), device)
        or driver.cuDeviceGetAttribute(ctypes.byref(major), 75, device)  # CUdevice_attribute: major
        or driver.cuDeviceGetAttribute(ctypes.byref(minor), 76, device)  # minor
    )
    if failed:
        return None
    return Gpu(
        name.value.decode("utf-8", "replace"),
        f"GPU-{uuid.UUID(bytes=bytes(identifier))}",
        round(memory.value / 1e9, 1),
        (major.value, minor.value),
    )
