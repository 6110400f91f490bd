"""What a command prints for programs and on standard error: one line each."""

import json
import sys
from typing import Any

#: characters of a line on standard error
LONGEST = 1000


def print_json(answer: Any) -> None:
    """Print one JSON object on standard output; NaN is refused."""
    print(json_text(answer), end="")


def json_text(answer: Any) -> str:
    """JSON as it is printed and kept in files."""
    return json.dumps(answer, indent=2, allow_nan=False) + "\n"


def warn(message: object) -> None:
    """Print a line on standard error; of a very long one the middle is left out."""
    line = " ".join(str(message).split())
    if len(line) > LONGEST:
        line = f"{line[: LONGEST // 2]} ... {line[-LONGEST // 2 :]}"
    print(f"jaxstage: {line}", file=sys.stderr, flush=True)


def progress(text: str) -> None:
    """Print what goes on as a line of standard error."""
    print(text, file=sys.stderr, flush=True)
