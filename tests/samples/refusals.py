"""Errors with which functions refuse."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from fipt_blender.core.run.errors import FiptError


def error_of(function: Callable[..., object], *arguments: object, **options: object) -> FiptError:
    """The error that a call ends with, which has a remedy."""
    with pytest.raises(FiptError) as caught:
        function(*arguments, **options)
    assert caught.value.remedy
    return caught.value
