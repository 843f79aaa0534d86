"""Pages of HTML, taken apart."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path


class Page(HTMLParser):
    """All tags of a file with their attributes, its text, and whether its elements are closed in order."""

    def __init__(self, content: Path | bytes) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.open: list[str] = []
        self.in_order = True
        self.feed((content if isinstance(content, bytes) else content.read_bytes()).decode())
        self.close()

    def values(self, *names: str) -> list[str]:
        """The values of attributes of these names, in the order of the page."""
        return [values[name] or "" for _, values in self.tags for name in names if name in values]

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.open += [tag] if tag not in ("meta", "img") else []
        self.tags.append((tag, dict(attributes)))

    def handle_endtag(self, tag: str) -> None:
        self.in_order &= self.open[-1:] == [tag]
        del self.open[-1:]

    def handle_data(self, data: str) -> None:
        self.text += data
