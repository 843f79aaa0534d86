"""The one place that chooses Mitsuba's variant and torch's device.

Mitsuba and torch are imported inside the functions, because the path of LLVM must be known before.
"""

from __future__ import annotations

import os
import sys

from ..run.errors import FiptError
from .cuda import VISIBLE_VARIABLE, cuda_driver_version
from .llvm import LLVM_VARIABLE, Verdict, companions, find_llvm, package_key, remembered, try_variant
from .probe import preload

VARIANTS = {"llvm": "llvm_ad_rgb", "cuda": "cuda_ad_rgb"}


def set_variant(device: str = "auto") -> str:
    """Set Mitsuba's variant for this process; further calls change nothing.

    Args:
        device: ``"cuda"``, ``"llvm"`` (CPU), or ``"auto"``: the variant that is set already, or else CUDA if
            it works, or else LLVM.

    Returns:
        The variant's name, ``"cuda_ad_rgb"`` or ``"llvm_ad_rgb"``.

    Raises:
        FiptError: ``llvm-missing``, ``cuda-missing``, ``setting-invalid``.
    """
    if device not in ("auto", *VARIANTS):
        raise FiptError("setting-invalid.set-variant", device=device)
    current = _current_variant()
    if current is not None and (device == "auto" or current == VARIANTS[device]):
        return current
    if device == "auto":
        device = "cuda" if cuda_verdict().works else "llvm"
    elif device == "cuda" and not (verdict := cuda_verdict()).works:
        raise FiptError("cuda-missing.set-variant", reason=verdict.reason)
    if device == "llvm":
        library = find_llvm()
        if "mitsuba" in sys.modules and os.environ.get(LLVM_VARIABLE) != str(library):
            raise RuntimeError("Mitsuba was imported before set_variant, so that Dr.Jit uses another LLVM")
        os.environ[LLVM_VARIABLE] = str(library)
        preload(companions(library))
    import mitsuba

    mitsuba.set_variant(VARIANTS[device])
    return VARIANTS[device]


def torch_device() -> str:
    """Torch's device for the current variant: ``"cuda"`` or ``"cpu"``."""
    import torch

    cuda = (_current_variant() or "").startswith("cuda") and torch.cuda.is_available()
    return "cuda" if cuda else "cpu"


def cuda_verdict() -> Verdict:
    """Whether Mitsuba's CUDA variant works here; if there is a driver, it is tried in a child process."""
    driver = cuda_driver_version()
    if driver is None:
        return Verdict(False, "this machine has no NVIDIA driver with a GPU")
    visible = os.environ.get(VISIBLE_VARIABLE, "")
    key = f"{package_key()}|cuda|{driver}|{visible}"
    return remembered(key, lambda: try_variant(VARIANTS["cuda"]))


def _current_variant() -> str | None:
    """The current variant; None if Mitsuba is not imported or has none."""
    mitsuba = sys.modules.get("mitsuba")
    return None if mitsuba is None else mitsuba.variant()
