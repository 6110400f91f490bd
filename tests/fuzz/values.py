"""Values that people and machines write by mistake or on purpose."""

import random
from typing import Any

#: texts that stand where a number, name or list is wanted
TEXTS = (
    "", " ", "nan", "inf", "-inf", "1e999", "-0", "0", "1", "-1", "1e-300", "1e300", "0x10", "1_0",
    "1,2", "1,2,3,4,5", "1,,2", "3g", "1200mm/min", "true", "None", "[]", "{}", "[/s]", "[b]x[/b]",
    "../x", "/etc/passwd", "\x00", "é", "\ud7ff", "Ω", "a" * 3000, "9" * 400, "1" + "0" * 400,
    "-" * 50, "(" * 200, "x=1", "--json", "=", ".", "..", "*", "$HOME", "%s", "'", '"', "\\",
)  # fmt: skip
#: what stands in a TOML value; written by `toml`
VALUES: tuple[Any, ...] = (
    0, 1, -1, 2**31, 2**63 - 1, 10**30, 10**400, 0.0, -0.0, 1e308, float("nan"), float("inf"),
    float("-inf"), True, False, "", "x", "current_drive", "[/s]", [], [1], [1.0, 2.0], ["x"],
    [[1]], [{}], {}, {"a": 1}, ["x", 1], [True], "9" * 400, "a" * 3000,
)  # fmt: skip


def toml(value: Any) -> str:
    """A value as TOML."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        plain = value.replace("\\", "\\\\").replace('"', '\\"')
        return '"' + "".join(c if c.isprintable() else f"\\u{ord(c):04x}" for c in plain) + '"'
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{k} = {toml(v)}" for k, v in value.items()) + "}"
    if isinstance(value, float) and value != value:
        return "nan"
    return repr(value)


def misspelt(draw: random.Random, word: str) -> str:
    """A word with one letter changed, doubled or left out."""
    if not word:
        return "x"
    k = draw.randrange(len(word))
    return draw.choice(
        (
            word[:k] + word[k + 1 :],
            word[:k] + word[k] + word[k:],
            word[:k] + draw.choice("abcxyz._-=") + word[k + 1 :],
            word.upper(),
            word + draw.choice((".x", ".", "-", " ")),
        )
    )


def damaged(draw: random.Random, data: bytes) -> bytes:
    """The bytes of a file after an accident."""
    if not data:
        return b"\xff"
    k, n = draw.randrange(len(data)), draw.randrange(1, 64)
    return draw.choice(
        (
            b"",
            data[:k],
            data[:k] + bytes(n) + data[k + n :],
            data[:k] + bytes([data[k] ^ (1 << draw.randrange(8))]) + data[k + 1 :],
            data + data[-k:],
            b"[]",
            b"null",
            b"{}",
            b"\xef\xbb\xbf" + data,
            data.decode("latin-1").encode("utf-16"),
            draw.randbytes(n),
        )
    )
