# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How operators report a FiptError, and warnings of the work that they have done."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, TypeVar

import bpy

from ..core.run.errors import FiptError

if TYPE_CHECKING:
    from ..bridge.process import Message

Self = TypeVar("Self")


def reports_errors(
    execute: Callable[[Self, bpy.types.Context], set[str]],
) -> Callable[[Self, bpy.types.Context], set[str]]:
    """Decorate `execute`: a FiptError is reported, with its remedy, and cancels the operator."""

    @functools.wraps(execute)
    def reporting(self: Self, context: bpy.types.Context) -> set[str]:
        try:
            return execute(self, context)
        except FiptError as error:
            self.report({"ERROR"}, str(error))  # type: ignore[attr-defined]
            return {"CANCELLED"}

    return reporting


def report_warnings(operator: object, warnings: Iterable[Message]) -> None:
    """Report each warning with its remedy."""
    for warning in warnings:
        operator.report({"WARNING"}, f"{warning['text']} {warning['remedy']}")  # type: ignore[attr-defined]
