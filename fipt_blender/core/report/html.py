"""HTML pages from templates that extend base.html of this folder, which holds their common style."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from ..run.runfolder import atomic_path

_HERE = Path(__file__).parent


def write_page(template: Path, context: Mapping[str, Any], page: Path) -> None:
    """Fill in a template and write the page, completely or not at all.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    environment = Environment(
        loader=FileSystemLoader([template.parent, _HERE]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["duration"] = format_duration
    text = environment.get_template(template.name).render(context)
    with atomic_path(page) as temporary:
        temporary.write_text(text, encoding="utf-8")


def format_duration(seconds: float) -> str:
    """A duration as text: "12.3 s", "4 min 5 s"."""
    if seconds < 60.0:
        return f"{seconds:.1f} s"
    rounded = int(seconds + 0.5)
    return f"{rounded // 60} min {rounded % 60} s"
