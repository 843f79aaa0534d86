"""What is wrong, and what to do about it: errors and warnings, by the keys of problems.toml.

Standard library only: both processes import it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Problem:
    """What is said of a problem.

    Attributes:
        code: short kebab-case identifier that scripts can match, e.g. ``"image-missing"``.
        text: what is wrong, naming the file or value.
        remedy: what the user can do about it.
        fix: how an import is corrected (`CaptureOptions.correct`), where one correction is the remedy.
    """

    code: str
    text: str
    remedy: str = ""
    fix: str = ""


@cache
def problem_texts() -> dict[str, dict[str, str]]:
    """Text and remedy of each problem, with places for its values, by its key.

    A key is a code, or a code, a dot and a name where a code has several texts.
    """
    import tomllib  # enabling the add-on does not need it

    return tomllib.loads(Path(__file__).with_name("problems.toml").read_text(encoding="utf-8"))


def problem(key: str, /, **values: object) -> Problem:
    """The problem with a key, and these values in its texts."""
    texts = problem_texts()[key]
    text, remedy = (texts.get(name, "").format_map(values) for name in ("text", "remedy"))
    return Problem(key.partition(".")[0], text, remedy.strip())


class FiptError(Exception):
    """The one exception that reaches the user: a problem that ends what was begun.

    Args:
        key: of problems.toml.
        values: for its texts.
    """

    def __init__(self, key: str, /, **values: object) -> None:
        self._say(problem(key, **values))

    @classmethod
    def of(cls, code: str, text: str, remedy: str, fix: str = "") -> FiptError:
        """The error whose texts come from elsewhere, such as another process."""
        error = cls.__new__(cls)
        error._say(Problem(code, text, remedy, fix))
        return error

    def _say(self, said: Problem) -> None:
        super().__init__(f"{said.text} {said.remedy}")
        self.code, self.text, self.remedy, self.fix = said.code, said.text, said.remedy, said.fix

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle what is said; an exception by default keeps only its message."""
        return FiptError.of, (self.code, self.text, self.remedy)


def as_message(kind: str, said: Problem | FiptError) -> dict[str, Any]:
    """The message of type "warning" or "error" that says a problem."""
    fix = {"fix": said.fix} if said.fix else {}
    return {"type": kind, "code": said.code, "text": said.text, "remedy": said.remedy, **fix}


def warning(key: str, /, **values: object) -> dict[str, Any]:
    """The message that warns of a problem."""
    return as_message("warning", problem(key, **values))
