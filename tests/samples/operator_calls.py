"""Operators called as scripts call them."""

from __future__ import annotations

import pytest


def refused(operator, **arguments) -> str:
    with pytest.raises(RuntimeError) as error:
        operator(**arguments)
    return str(error.value)
