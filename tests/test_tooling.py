"""dev.py and the files around the code: zip, release, pins; commands and files that pages name exist; results."""

from __future__ import annotations

import hashlib
import json
import os
import re
import sys
import tomllib
import zipfile
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest
import yaml

from benchmarks import results
from fipt_blender.bridge import pins, provision
from fipt_blender.bridge.places import environment_python
from samples.development import load_dev

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="module")
def dev() -> ModuleType:
    return load_dev()


def test_a_release_has_the_zip_of_the_extension_its_checksum_and_notes(dev: ModuleType, tmp_path: Path) -> None:
    version = dev.read_versions()["CHANGELOG.md"]
    with pytest.raises(dev.SetupError, match=version):
        dev.release(f"{version}", tmp_path)
    assert dev.release(f"v{version}", tmp_path) == 0
    checksum, name = (tmp_path / "SHA256SUMS").read_text(encoding="utf-8").split()
    assert checksum == hashlib.sha256((tmp_path / name).read_bytes()).hexdigest()
    notes = (tmp_path / "NOTES.md").read_text(encoding="utf-8")
    assert notes.startswith("### ") and "\n## " not in notes
    assert notes.strip() in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    with zipfile.ZipFile(tmp_path / name) as archive:
        names = archive.namelist()
        assert archive.testzip() is None
        manifest = tomllib.loads(archive.read("blender_manifest.toml").decode())
        written = json.loads(archive.read(pins.PINS_NAME))
    groups = pins.read_pins()
    assert written == {name: groups[name] for name in pins.ENGINE_GROUPS}
    assert (tmp_path / name).stat().st_size < 4.5e6, "the heavy packages live in the engine's environment"
    assert name == f"fipt_blender-{manifest['version']}.zip"
    assert {"__init__.py", "__main__.py", "LICENSE", "core/__main__.py", "cli/__init__.py"} <= set(names)
    assert names == sorted(names)
    foreign = ("tests", "examples", "benchmarks", "fipt_blender", "dist", "out")
    for each in names:
        assert "__pycache__" not in each and not each.endswith(".pyc") and not each.startswith(".")
        assert each.split("/")[0] not in foreign
    # The index offers Blender the same zip, byte by byte.
    index = tmp_path / "index"
    assert dev.index_extensions(index) == 0 and (index / "index.html").is_file()
    (entry,) = json.loads((index / "index.json").read_text(encoding="utf-8"))["data"]
    assert entry["id"] == "fipt_blender" and entry["version"] in name and entry["archive_hash"] == f"sha256:{checksum}"
    assert (index / entry["archive_url"]).read_bytes() == (tmp_path / name).read_bytes()


def test_build_refuses_versions_that_disagree(dev: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert re.fullmatch(r"\d+\.\d+\.\d+", dev.read_versions()["pyproject.toml"])
    versions = {"blender_manifest.toml": "0.1.0", "pyproject.toml": "0.2.0"}
    monkeypatch.setattr(dev, "read_versions", lambda: versions)
    with pytest.raises(dev.SetupError, match=r"0\.2\.0"):
        dev.build_extension(tmp_path)
    assert not list(tmp_path.iterdir())


def test_every_pin_is_exact() -> None:
    groups = pins.read_pins()
    assert set(groups) == {"blender", "dev", "cluster", "heif", "markers", *pins.ENGINE_GROUPS}
    for requirement in (pins.without_hashes(pin) for group in groups.values() for pin in group):
        assert re.match(r"[A-Za-z0-9-]+==[0-9][0-9a-z.]*( ?;|$)", requirement), requirement


def test_the_lock_has_every_pin_of_the_engine_and_hashes_of_all() -> None:
    """After a change of a pin: python3 dev.py lock."""
    groups = pins.read_pins()
    for line in (*groups["lock"], *groups["pip"], *groups["llvm"]):
        assert re.search(r" --hash=sha256:[0-9a-f]{64}( |$)", line), line
    names: dict[str, list[str]] = {}
    for line in groups["lock"]:
        names.setdefault(re.split("[=; ]", line)[0].lower(), []).append(re.search(r"==([^ ;]+)", line).group(1))
    for pin in groups["engine"]:
        name, _, version = pin.partition(";")[0].strip().partition("==")
        if name != "torch":
            assert version in names[name.lower()], f"{pin}: run python3 dev.py lock"
    assert not {"torch", "triton"} & set(names) and not any(name.startswith("nvidia") for name in names)
    assert not {"pip", "karellen-llvm-core"} & set(names), "set-up itself checks these"
    assert len(names) >= 20


def test_set_up_is_done_once_and_again_when_something_changed(dev: ModuleType, tmp_path: Path) -> None:
    groups = {"engine": ["torch==1"]}
    key = dev.setup_key(groups, tmp_path)
    assert key == dev.setup_key(groups, tmp_path)
    assert key != dev.setup_key({"engine": ["torch==2"]}, tmp_path)
    assert key != dev.setup_key(groups, tmp_path / "moved")
    stamp, python, library = tmp_path / "setup.json", environment_python(tmp_path), tmp_path / "libLLVM.so"
    assert not pins.is_set_up(tmp_path, key)
    python.parent.mkdir()
    for file in (python, library):
        file.touch()
    whole = {"key": key, "installed": True, "complete": True, "llvm": str(library)}
    for content in (json.dumps({**whole, "complete": False}), "{"):
        stamp.write_text(content)
        assert not pins.is_set_up(tmp_path, key)
    stamp.write_text(json.dumps(whole))
    assert pins.is_set_up(tmp_path, key) and not pins.is_set_up(tmp_path, "other")
    library.unlink()
    assert not pins.is_set_up(tmp_path, key)


def test_unsupported_python_is_named(
    dev: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(dev, "SUPPORTED_PYTHONS", ((2, 7),))
    monkeypatch.setattr(dev, "other_python", lambda: None)
    assert dev.main(["test"]) == 1
    assert "Python 2.7 is needed" in capsys.readouterr().err


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_exit_status_of_the_child_is_passed_on(dev: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dev, "VENV_PYTHON", Path(sys.executable))
    assert dev.call("-c", "raise SystemExit(7)") == 7
    assert dev.call("-c", "import os; os.kill(os.getpid(), 6)") == 134


def test_wheel_libraries_takes_shared_libraries_only(tmp_path: Path) -> None:
    wheel = tmp_path / "a.whl"
    with zipfile.ZipFile(wheel, "w") as archive:
        archive.writestr("x.data/data/lib/libLLVM.so.23.1", b"\x7fELF library")
        archive.writestr("x.data/data/lib/deep/libc++.so", b"INPUT(libc++.so.1)")
        archive.writestr("x.data/data/lib/libLTO.so.23.1", b"\x7fELF other")
        archive.writestr("x.data/data/lib/libLLVM.a", b"\x7fELF archive")
    written = provision.wheel_libraries(wheel, tmp_path / "llvm", ("libLLVM", "libc++"))
    assert written == [tmp_path / "llvm" / "libLLVM.so.23.1"]
    assert written[0].read_bytes() == b"\x7fELF library"


@pytest.mark.skipif(sys.platform == "win32", reason="symbolic links")
def test_copy_libraries_keeps_each_name_and_stays_inside_the_tree(tmp_path: Path) -> None:
    lib = tmp_path / "root" / "usr" / "lib"
    (lib / "llvm").mkdir(parents=True)
    (lib / "llvm" / "libLLVM.so.1").write_bytes(b"a")
    (lib / "libLLVM.so.19.1").symlink_to("/usr/lib/llvm/libLLVM.so.1")
    (lib / "libz3.so.4").symlink_to("libz3.so.4.8")
    (lib / "libz3.so.4.8").write_bytes(b"z")
    (lib / "libgone.so.1").symlink_to("/usr/lib/gone")
    provision.copy_libraries(tmp_path / "root", tmp_path / "out")
    contents = {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()}
    llvm = {"libLLVM.so.1": b"a", "libLLVM.so.19.1": b"a"}
    assert contents == {**llvm, "libz3.so.4": b"z", "libz3.so.4.8": b"z"}


WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
PAGES = [*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md"), *(ROOT / "tests").rglob("*.md")]
ENTRIES = sorted((ROOT / ".ci").iterdir())
TEXTS = [*PAGES, *WORKFLOWS, *(ROOT / ".github" / "ISSUE_TEMPLATE").iterdir(), *ENTRIES]
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
    assert ".ci/run" in commands and all(os.access(entry, os.X_OK) for entry in ENTRIES)
    for command in commands:
        program, *words = command.split()
        if program in ("python", "python3"):
            assert words[0] == "dev.py" and words[1] in load_dev().COMMANDS
            for pattern in words[2:]:
                assert pattern == '"$GITHUB_REF_NAME"' or list(ROOT.glob(pattern)), pattern
        else:
            assert ROOT / command in ENTRIES or command.startswith(PUBLISHING)


def test_every_command_of_dev_py_that_is_named_exists_and_is_described() -> None:
    dev = load_dev()
    for text in TEXTS:
        named = set(re.findall(r"python3? dev\.py ([a-z]+)", text.read_text(encoding="utf-8")))
        assert named <= set(dev.COMMANDS), text
    described = re.findall(r"^  ([a-z]+) ", dev.__doc__, flags=re.MULTILINE)
    assert sorted(described) == sorted(dev.COMMANDS)


def test_links_lead_to_files_and_headings() -> None:
    links = ((page, re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8"))) for page in PAGES)
    for page, target in ((page, target) for page, targets in links for target in targets):
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


@pytest.mark.parametrize("path", sorted(results.MEASUREMENTS.rglob("*.json")), ids=lambda path: path.stem)
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
