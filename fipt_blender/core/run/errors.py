# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The one exception that reaches the user: what is wrong, and what to do about it.

Standard library only: both processes import it.
"""

from __future__ import annotations


class FiptError(Exception):
    """A failure with a stable code, a text on what is wrong and a text on what to do.

    Attributes:
        code: short kebab-case identifier that scripts can match, e.g. ``"image-missing"``.
        text: what is wrong, naming the file or value.
        remedy: what the user can do about it.
    """

    def __init__(self, code: str, text: str, remedy: str) -> None:
        super().__init__(f"{text} {remedy}")
        self.code = code
        self.text = text
        self.remedy = remedy

    def __reduce__(self) -> tuple[type[FiptError], tuple[str, str, str]]:
        """Pickle all three arguments; an exception by default keeps only its message."""
        return FiptError, (self.code, self.text, self.remedy)
