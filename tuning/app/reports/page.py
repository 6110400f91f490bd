"""What a report says, whatever it is about, and how it becomes one HTML file."""

import base64
import json
import re
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import jinja2
from markupsafe import Markup, escape

from jaxstage import __version__
from tuning.app.result_table import ResultTable


class Picture(NamedTuple):
    """A PNG file, and one sentence on how to read it."""

    file: Path
    text: str

    def data(self) -> str:
        """The picture as text that a page can hold."""
        return base64.b64encode(self.file.read_bytes()).decode()


class Page(NamedTuple):
    """A report. good: whether the verdict is a good one, None where it is neither. verdict: its
    lines. facts: name -> value, of what stands next to it. tables: above the pictures; details:
    below them. files: name -> text to take away. settings: name -> value of all that it was
    computed with."""

    title: str
    subtitle: str
    good: bool | None
    verdict: tuple[str, ...]
    facts: Mapping[str, str]
    tables: tuple[ResultTable, ...]
    pictures: tuple[Picture, ...]
    files: Mapping[str, str]
    settings: Mapping[str, str]
    details: tuple[ResultTable, ...] = ()
    notes: tuple[str, ...] = ()


def html(page: Page) -> str:
    """The page as one HTML document: nothing in it refers to anything outside."""
    template = resources.files("tuning.app.reports").joinpath("report.html").read_text("utf-8")
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["code"] = _code
    return environment.from_string(template).render(page=page, version=__version__)


def _code(text: str) -> Markup:
    """Text with what stands in backticks as code."""
    return Markup(re.sub("`([^`]+)`", r"<code>\1</code>", str(escape(text))))


def read_json(file: Path) -> Any:
    """What a JSON file holds."""
    return json.loads(file.read_text(encoding="utf-8"))


def pictures(folder: Path, texts: Mapping[str, str]) -> tuple[Picture, ...]:
    """The pictures of a folder that are known by name, in the order of their texts."""
    files = ((folder / f"{name}.png", text) for name, text in texts.items())
    return tuple(Picture(file, text) for file, text in files if file.is_file())
