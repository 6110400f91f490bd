"""TOML files that stand beside the loops of a study."""

import tomllib
from functools import cache
from importlib import resources
from typing import Any


@cache
def packaged_studies() -> tuple[str, ...]:
    """The names of the studies that have such files."""
    folders = resources.files("jaxstage.studies").iterdir()
    return tuple(f.name.replace("_", "-") for f in folders if (f / "published.toml").is_file())


@cache
def packaged_toml(study: str, file: str) -> dict[str, Any]:
    """The content of a file of a study, e.g. ``published.toml`` of ``fuzzy-cmac``."""
    folder = resources.files("jaxstage.studies") / study.replace("-", "_")
    return tomllib.loads((folder / file).read_text(encoding="utf-8"))
