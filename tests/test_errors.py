"""The texts of errors and warnings: each that the code names exists, gets its values, and is used."""

import ast
import copy
import string
from collections.abc import Iterator
from pathlib import Path

import fipt_blender
from fipt_blender.core.run.errors import FiptError, problem, problem_texts

PACKAGE = Path(fipt_blender.__file__).parent
CALLS = {"FiptError", "problem", "warning"}


def named_problems() -> Iterator[tuple[str, str, set[str]]]:
    """Place, key and names of values of each call that names a problem."""
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Call) or len(node.args) != 1:
                continue
            called = node.func.id if isinstance(node.func, ast.Name) else getattr(node.func, "attr", "")
            key = node.args[0]
            if called in CALLS and isinstance(key, ast.Constant):
                names = {item.arg or "**" for item in node.keywords}
                yield f"{path.relative_to(PACKAGE)}:{node.lineno}", str(key.value), names


def test_each_problem_gets_its_values() -> None:
    texts, wrong, used = problem_texts(), [], set()
    for place, key, names in named_problems():
        used.add(key)
        parts = [string.Formatter().parse(text) for text in texts.get(key, {}).values()]
        wanted = {name for each in parts for _, name, _, _ in each if name is not None}
        if key not in texts or names != wanted:
            wrong.append(f"{place}: {key} has {sorted(names)}, its texts {sorted(wanted)}")
    assert not wrong, "\n".join(wrong)
    assert len(used) > 300
    assert set(texts) == used, sorted(set(texts) - used)


def test_texts_are_sentences() -> None:
    for key, texts in problem_texts().items():
        assert set(texts) <= {"text", "remedy"}, key
        for text in texts.values():
            assert text.strip() == text, key
            assert text.endswith((".", "}", "?", ":")), (key, text)


def test_an_error_crosses_processes() -> None:
    error = FiptError("image-format", path="a.xyz", formats="EXR")
    again = copy.copy(error)  # by what it is pickled as
    assert (again.code, again.text, again.remedy) == (error.code, error.text, error.remedy)
    assert "a.xyz" in error.text
    assert error.code == problem("image-format", path="", formats="").code
    other = FiptError.of("code", "It failed.", "Mend it.")
    assert str(copy.copy(other)) == "It failed. Mend it."
