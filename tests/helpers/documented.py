"""Which keys of JSON objects the documentation explains."""

from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).parents[2]
JSON_KEYS = (ROOT / "docs" / "reference" / "json.md").read_text(encoding="utf-8")


def undocumented(keys: Iterable[str]) -> list[str]:
    """The keys that the page of JSON keys does not name."""
    return sorted(key for key in set(keys) if f"`{key}`" not in JSON_KEYS)
