"""The site's pages "Operators" and "Options", made from what operators and options declare."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

ROOT = Path(__file__).resolve().parents[2]


def on_files(files: Any, config: Any) -> Any:
    """MkDocs' hook: add the pages to the site's files."""
    from mkdocs.structure.files import File

    sys.path.insert(0, str(ROOT))
    files.append(File.generated(config, "operators.md", content=operators_page()))
    files.append(File.generated(config, "options.md", content=options_page()))
    return files


def options_page() -> str:
    """The page in Markdown: a table for each dataclass of options."""
    from fipt_blender.core.capture.options import CaptureOptions
    from fipt_blender.core.run.declared import declared
    from fipt_blender.core.run.settings import Settings
    from fipt_blender.jobs.options import MainJobOptions
    from fipt_blender.prepare.preparation import PrepareSettings

    chapters = (
        ("Reading a capture (*Import Settings*, `estimate`)", "{item.flag}", CaptureOptions),
        ("The whole job (`estimate`)", "{item.flag}", MainJobOptions),
        ("The method (*Estimate*, *Materials*, `estimate --set NAME=VALUE`)", "{item.name}", Settings),
        ("Photographs (*Photographs*, `prepare --set NAME=VALUE`)", "{item.name}", PrepareSettings),
    )
    lines, before = ["# Options"], declared(CaptureOptions)
    for title, name, kind in chapters:
        lines += ["", f"## {title}", "", "| option | in the panel | default | |", "|---|---|---|---|"]
        for item in declared(kind).values():
            if kind is not MainJobOptions or item.name not in before:
                choices = ", ".join(f"`{each}`" for each in item.option.identifiers)
                text = _sentence(item.option.text[:1].upper() + item.option.text[1:])
                shown = f"`{item.default}`" if item.default not in (None, "") else ""
                row = (f"`{name.format(item=item)}`", item.option.label, shown, f"{text} {choices}".strip())
                lines.append(f"| {' | '.join(row)} |")
    return "\n".join(lines) + "\n"


def operators_page() -> str:
    """The page in Markdown: a chapter for each section of the panel, an entry for each operator."""
    import fipt_blender
    from fipt_blender import operators

    fipt_blender.register()
    try:
        lines = ["# Operators", "", "All of them also work in background mode."]
        for module in operators.MODULES:
            lines += _chapter(module)
    finally:
        fipt_blender.unregister()
    return "\n".join(lines) + "\n"


def _chapter(module: ModuleType) -> Iterator[str]:
    from fipt_blender.properties import classes_of

    shown = [each for each in classes_of([module]) if _is_public(each)]
    if not shown:
        return
    yield from ("", f"## {module.__name__.rpartition('.')[2].replace('_', ' ').capitalize()}")
    for operator in shown:
        yield from ("", f"### {operator.bl_label}", "", f"`bpy.ops.{operator.bl_idname}`", "")
        yield _sentence(getattr(operator, "bl_description", "") or operator.__doc__)
        if "UNDO" in getattr(operator, "bl_options", ()):
            yield from ("", "Can be undone.")
        yield from _properties(operator.bl_idname)


def _is_public(shown: Any) -> bool:
    """Whether a class is an operator that users may call (some modules also register file handlers)."""
    import bpy

    return issubclass(shown, bpy.types.Operator) and "INTERNAL" not in getattr(shown, "bl_options", ())


def _properties(name: str) -> Iterator[str]:
    """A table of what an operator takes."""
    import bpy

    section, _, operator = name.partition(".")
    declared = getattr(getattr(bpy.ops, section), operator).get_rna_type().properties
    rows = [each for each in declared if each.identifier != "rna_type" and not each.is_hidden]
    if rows:
        yield from ("", "| property | type | default | |", "|---|---|---|---|")
    for each in rows:
        kind, default, text = each.type.lower(), _default(each), _sentence(each.description)
        yield f"| `{each.identifier}` | {kind} | `{default!r}` | {text} |"


def _default(value: Any) -> Any:
    if getattr(value, "is_array", False):
        return tuple(value.default_array)
    if getattr(value, "is_enum_flag", False):
        return set(value.default_flag)
    return getattr(value, "default", None)


def _sentence(text: str) -> str:
    """A tooltip as a sentence on one line; tooltips have no final full stop."""
    line = " ".join(text.split()).replace("|", "\\|")
    return f"{line}." if line and line[-1] not in ".?!" else line
