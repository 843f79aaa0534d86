# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The files around the code: workflows run commands and pages name files that exist, results are measured."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from samples.development import load_dev

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks import results

ROOT = Path(__file__).resolve().parent.parent
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
PAGES = [*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md"), *(ROOT / "tests").rglob("*.md")]
TEXTS = [*PAGES, *WORKFLOWS, *(ROOT / ".github" / "ISSUE_TEMPLATE").iterdir(), ROOT / ".ci" / "run"]
TEXTS += [ROOT / ".pre-commit-config.yaml"]
# A workflow may use nothing of the service but this, after the project's own commands.
PUBLISHING = "gh release create"


def steps(workflow: Path) -> Iterator[str]:
    document = yaml.safe_load(workflow.read_text(encoding="utf-8"))
    for job in document["jobs"].values():
        assert job["timeout-minutes"] <= 60
        yield from (step["run"] for step in job["steps"] if "run" in step)


@pytest.mark.parametrize("workflow", WORKFLOWS, ids=lambda path: path.stem)
def test_workflows_run_the_projects_own_commands(workflow: Path) -> None:
    commands = list(steps(workflow))
    assert ".ci/run" in commands and os.access(ROOT / ".ci" / "run", os.X_OK)
    for command in commands:
        program, *words = command.split()
        if program in ("python", "python3"):
            assert words[0] == "dev.py" and words[1] in load_dev().COMMANDS
            for pattern in words[2:]:
                assert pattern == '"$GITHUB_REF_NAME"' or list(ROOT.glob(pattern)), pattern
        else:
            assert command == ".ci/run" or command.startswith(PUBLISHING)


def test_every_command_of_dev_py_that_is_named_exists_and_is_described() -> None:
    dev = load_dev()
    for text in TEXTS:
        named = set(re.findall(r"python3? dev\.py ([a-z]+)", text.read_text(encoding="utf-8")))
        assert named <= set(dev.COMMANDS), text
    described = re.findall(r"^  ([a-z]+) ", dev.__doc__, flags=re.MULTILINE)
    assert sorted(described) == sorted(dev.COMMANDS)


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.name)
def test_links_lead_to_files_and_headings(page: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        if target.startswith(("http://", "https://")):
            continue
        name, _, place = target.partition("#")
        file = (page.parent / name).resolve() if name else page
        assert file.exists(), (page, target)
        if place and file.suffix == ".md":
            text = file.read_text(encoding="utf-8")
            headings = re.findall(r"^#+ (.*)$", text, flags=re.MULTILINE)
            slugs = {re.sub(r"[\s-]+", "-", re.sub(r"[^\w\s-]", "", each.lower())) for each in headings}
            assert place in slugs or f'<a id="{place}">' in text, (page, target)


def test_documents_are_as_short_as_a_reader_has_patience_for() -> None:
    limits = {"results": 25_000, "decisions": 15_000, "method": 35_000, "architecture": 20_480}
    for name, most in limits.items():
        assert (ROOT / "docs" / f"{name}.md").stat().st_size <= most, name


def test_issue_templates_and_citation_can_be_read() -> None:
    for path in (ROOT / ".github" / "ISSUE_TEMPLATE").glob("[!c]*.yml"):
        form = yaml.safe_load(path.read_text(encoding="utf-8"))
        assert form["name"] and form["description"] and form["body"]
        assert "check" in str(form["body"]), "every report contains what Check has found"
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["version"] == load_dev().read_versions()["CHANGELOG.md"]
    assert len(citation["references"][0]["authors"]) == 10


def test_results_are_what_the_command_writes_from_measurements_and_no_figure_is_typed() -> None:
    text = results.PAGE.read_text(encoding="utf-8")
    assert results.with_tables(text) == text, "run python3 dev.py results"
    text = re.sub(r"```.*?```", "", results.TABLE.sub("", text), flags=re.DOTALL)
    assert not re.findall(r"\d[\d.,]* ?(?:dB|s|min|GB|%)(?![\w-])", text)


@pytest.mark.parametrize("path", sorted(results.MEASUREMENTS.glob("*.json")), ids=lambda path: path.stem)
def test_every_measurement_says_where_it_comes_from(path: Path) -> None:
    table = results.read_table(path)
    for row in table["rows"]:
        assert row["label"] and row["figures"]
        if not row.get("source"):  # a figure of somebody else names its source instead
            assert all(row.get(name) not in (None, "") for name in results.PROVENANCE), row["label"]
            assert re.fullmatch(r"[0-9a-f]{7,40}", row["commit"]), row["label"]


def test_a_new_measurement_takes_the_place_of_the_old_one(tmp_path: Path) -> None:
    path = tmp_path / "rooms.json"
    columns = [["kd", "{kd_psnr:.2f}"], ["edge / inside", "{edge_kd_psnr:.1f} / {inside_kd_psnr:.1f}"]]
    columns += [["log L2", "{emission_log_l2:sci}"]]
    old = [{"label": name, "figures": {"kd_psnr": -1.0}} for name in ("a", "b")]
    path.write_text(results.written({"columns": columns, "common": {"seed": 0}, "rows": old}))
    measured = {"held_back": {"kd_psnr": 30.125, "emission_log_l2": 1.1e-4, "confidence": []}}
    measured["held_back"] |= {"strict": {}, "edge": {"kd_psnr": 20.0}, "inside": {"kd_psnr": 33.0}}
    for label in ("a", "c"):
        results.add(path, label, {**measured, "measured": {"commit": "0123456", "seed": 3}})
    table = results.read_table(path)
    assert [(row["label"], row["seed"]) for row in table["rows"]] == [("a", 3), ("b", 0), ("c", 3)]
    lines = results.markdown(table).splitlines()
    assert lines[2:4] == ["| a | 30.12 | 20.0 / 33.0 | 1.1e-4 |", "| b | −1.00 | | |"]
