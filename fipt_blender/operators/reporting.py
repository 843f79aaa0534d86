# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How operators report a FiptError, and warnings of the work that they have done."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeVar

import bpy

from ..core.run.errors import FiptError

Self = TypeVar("Self")
Messages = list[dict[str, Any]]  # see `bridge.process.Message`


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


def report_messages(operator: Any, messages: Iterable[Mapping[str, Any]]) -> None:
    """Report warnings with their remedies, and notes."""
    for message in messages:
        if message["type"] == "warning":
            operator.report({"WARNING"}, f"{message['text']} {message['remedy']}".strip())
        else:
            operator.report({"INFO"}, message["text"])
