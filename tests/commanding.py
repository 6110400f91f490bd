"""Calling the command line in this process, which has already started JAX."""

import json
import sys
from typing import NamedTuple

import pytest

from tuning import cli


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


@pytest.fixture
def command(monkeypatch, capsys, tmp_path):
    """The command line in an empty folder."""
    monkeypatch.setattr("jaxstage.runtime.configure", lambda *_, **__: None)
    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)

    def call(*words):
        monkeypatch.setattr(sys, "argv", ["jaxstage", *map(str, words)])
        with pytest.raises(SystemExit) as stopped:
            cli.main()
        captured = capsys.readouterr()
        return Answer(stopped.value.code or 0, captured.out, captured.err)

    return call
