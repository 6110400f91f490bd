"""Calling the command line in this process, which has already started JAX."""

import importlib
import json
import sys
import warnings
from typing import NamedTuple

import pytest

from jaxstage.metrics import contour, following, together, tracking
from tuning.app import main as cli

LOOPS = importlib.import_module("jaxstage.studies.fuzzy_cmac.loops")
FEW = together(tracking, contour, following)


class Answer(NamedTuple):
    """What a command did."""

    status: int
    out: str
    err: str

    @property
    def json(self):
        return strict_json(self.out)


def strict_json(text):
    """One object; refuses NaN and Infinity."""

    def refuse(word):
        raise AssertionError(f"{word} is no JSON")

    return json.loads(text, parse_constant=refuse)


def few_figures(monkeypatch):
    """Loops of the biaxial table report little, so that they compile in a third of the time."""
    monkeypatch.setitem(vars(LOOPS), "standard", lambda surface: FEW)


def caller(monkeypatch, capsys):
    """call(*words) -> `Answer` of the command line."""

    def call(*words):
        monkeypatch.setattr(sys, "argv", ["jaxstage", *map(str, words)])
        monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)  # as it was, afterwards
        try:
            status = cli.call()
        except SystemExit as stopped:  # completion in the shell ends so
            status = stopped.code or 0
        captured = capsys.readouterr()
        return Answer(status, captured.out, captured.err)

    return call


@pytest.fixture
def command(monkeypatch, capsys, tmp_path):
    """The command line in an empty folder."""
    monkeypatch.setattr("jaxstage.system.runtime.configure", lambda *_, **__: None)
    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)

    return caller(monkeypatch, capsys)
