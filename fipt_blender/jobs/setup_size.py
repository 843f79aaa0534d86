"""What Set Up Engine would download, for the panel, which must not ask the GPU's driver.

While drawing, the answer comes from a cache, which a timer fills soon after.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy

from .. import machine
from .window import redraw

if TYPE_CHECKING:
    from ..bridge.torch_build import Size

_known: dict[str, str] = {}  # build by the device of the preferences


def size() -> Size:
    """The size of the download; asks the driver."""
    from ..bridge.torch_build import SIZES, choose_torch_build
    from ..core.device.cuda import cuda_devices, cuda_driver_version

    device = machine.device_setting()
    _known[device] = choose_torch_build(device, cuda_driver_version(), cuda_devices())
    return SIZES[_known[device]]


def known_size() -> Size | None:
    """The size of the download; None before the timer has asked the driver."""
    from ..bridge.torch_build import SIZES

    build = _known.get(machine.device_setting())
    if build is not None:
        return SIZES[build]
    if not bpy.app.background and not bpy.app.timers.is_registered(_ask):
        bpy.app.timers.register(_ask, first_interval=0.0)
    return None


def _ask() -> None:
    size()
    redraw()
