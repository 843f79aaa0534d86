"""python3 dev.py results: write the tables of docs/results.md from the measurements in docs/measurements/.

A file there is one table: {"first": header of the first column, "columns": [[header, template], ...],
"common": what its rows have in common, "rows": [{"label", "figures": {name: value}, ...}]}. Each row, or
"common" for all of them, says where the figures come from (`PROVENANCE`); figures of others have a
"source" instead. A template names figures and their formats.

    python3 dev.py accuracy CAPTURE ... --json FILE
    python3 dev.py results --add TABLE LABEL FILE      # in place of the row with that label, or at the end
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import shlex
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "results.md"
MEASUREMENTS = ROOT / "docs" / "measurements"
PROVENANCE = ("commit", "machine", "capture", "seed", "command")
TABLE = re.compile(r"(<!-- table: ([a-z0-9-]+) -->\n).*?(<!-- end -->)", re.DOTALL)


def provenance(capture: str, seed: int, device: str, command: Sequence[str]) -> dict[str, Any]:
    """Where a measurement comes from.

    The commit ends with "+" where files differ from it, and is empty without git; the tests refuse such rows.
    """

    def git(*words: str) -> str:
        ended = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=False)
        return ended.stdout.strip() if ended.returncode == 0 else ""

    changed = "+" if git("status", "--porcelain", "--untracked-files=no") else ""
    return {
        "commit": git("rev-parse", "--short=10", "HEAD") + changed,
        "machine": f"{os.cpu_count()} cores, {platform.machine()}, {device}",
        "capture": capture,
        "seed": seed,
        "command": shlex.join(command),
    }


def figures_of(result: dict[str, Any]) -> dict[str, Any]:
    """Figures of held-back views in what `accuracy --json` writes, the strict protocol's with a prefix."""
    held_back = result["held_back"]
    found = {name: value for name, value in held_back.items() if isinstance(value, int | float)}
    for group in ("strict", "edge", "inside"):
        found |= {f"{group}_{name}": value for name, value in held_back[group].items()}
    found |= {name: result.get(name) for name in ("seconds", "peak_memory_gb")}
    return {name: value for name, value in found.items() if value is not None}


def read_table(path: Path) -> dict[str, Any]:
    """A table's file; its rows have what is common to them."""
    table = json.loads(path.read_text(encoding="utf-8"))
    table["rows"] = [{**table.get("common", {}), **row} for row in table["rows"]]
    return table


def stored_table(name: str) -> dict[str, Any]:
    """The table of a name; of a folder with a file for each commit, the newest."""
    files = list((MEASUREMENTS / name).glob("*.json")) or [MEASUREMENTS / f"{name}.json"]
    return max((read_table(path) for path in files), key=lambda table: table.get("date", ""))


def add(path: Path, label: str, result: dict[str, Any]) -> None:
    """Put a measurement into a table's file, in place of the row with its label or at the end."""
    table = json.loads(path.read_text(encoding="utf-8"))
    row = {"label": label, **result["measured"], "figures": figures_of(result)}
    labels = [each["label"] for each in table["rows"]]
    at = labels.index(label) if label in labels else len(labels)
    table["rows"][at : at + 1] = [row]
    path.write_text(written(table), encoding="utf-8", newline="\n")


def written(table: dict[str, Any]) -> str:
    """A table's file as text, a line for each row and column."""
    parts = []
    for name, value in table.items():
        if isinstance(value, list):
            lines = ",\n  ".join(json.dumps(each, ensure_ascii=False) for each in value)
            parts.append(f" {json.dumps(name)}: [\n  {lines}\n ]")
        else:
            parts.append(f" {json.dumps(name)}: {json.dumps(value, ensure_ascii=False)}")
    return "{\n" + ",\n".join(parts) + "\n}\n"


def cell(template: str, figures: dict[str, Any]) -> str:
    """A template with its figures, empty where one was not measured. The format "sci": 1.1e-4, or 0."""
    names = re.findall(r"\{(\w+)", template)
    if any(figures.get(name) is None for name in names):
        return ""

    def shown(found: re.Match[str]) -> str:
        value, form = figures[found[1]], found[2]
        if isinstance(value, str):
            return value
        if form == "sci":
            return f"{value:.1e}".replace("e-0", "e-") if value else "0"
        return f"{value:{form}}".replace("-", "−")

    return re.sub(r"\{(\w+):?([^}]*)\}", shown, template)


def markdown(table: dict[str, Any]) -> str:
    """A table in Markdown."""
    headers = [table.get("first", ""), *(header for header, _ in table["columns"])]
    rows = [
        [row["label"], *(cell(template, row["figures"]) for _, template in table["columns"])]
        for row in table["rows"]
    ]
    lines = [f"|{'|'.join(f' {text} ' if text else ' ' for text in row)}|\n" for row in (headers, *rows)]
    return "".join([lines[0], f"|{'---|' * len(headers)}\n", *lines[1:]])


def with_tables(text: str) -> str:
    """A page whose tables, between their markers, are those of the measurements."""

    def made(found: re.Match[str]) -> str:
        return found[1] + markdown(stored_table(found[2])) + found[3]

    return TABLE.sub(made, text)


def main(argv: Sequence[str]) -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="dev.py results", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "--add", nargs=3, metavar=("TABLE", "LABEL", "FILE"), help="put in what accuracy --json wrote"
    )
    arguments = parser.parse_args(list(argv))
    if arguments.add:
        name, label, file = arguments.add
        add(MEASUREMENTS / f"{name}.json", label, json.loads(Path(file).read_text(encoding="utf-8")))
    PAGE.write_text(with_tables(PAGE.read_text(encoding="utf-8")), encoding="utf-8", newline="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
