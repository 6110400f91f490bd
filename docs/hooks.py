"""What the pages of the documentation do not say by hand: it is read from the library itself.

A line ``<!-- NAME WORDS -->`` of a page becomes what the function NAME of `GENERATORS` makes of the
words: tables of fields, values, claims, loops, commands. Formulas become MathML, which browsers
draw without a script.
"""

import dataclasses
import html
import importlib
import inspect
import os
import pkgutil
import re
from collections.abc import Callable, Iterable
from typing import Any

import latex2mathml.converter
import numpy as np

os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")

MARK = re.compile(r"^<!-- (\w+) ?(.*?) -->$", re.MULTILINE)
#: modules inside a published study hold its numbers, which its page shows
INNER = re.compile(r"jaxstage\.studies\.\w+\.")
FORMULA = re.compile(r'<(div|span) class="arithmatex">\\(?:\[|\()(.*?)\\(?:\]|\))</\1>', re.DOTALL)


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Replace the marks of a page."""
    return MARK.sub(lambda mark: GENERATORS[mark[1]](*mark[2].split()), markdown)


def on_page_content(content: str, **_: Any) -> str:
    """Formulas as MathML."""

    def convert(found: re.Match[str]) -> str:
        display = "block" if found[1] == "div" else "inline"
        return latex2mathml.converter.convert(html.unescape(found[2]), display=display)

    return FORMULA.sub(convert, content)


# --- studies ---------------------------------------------------------------------------------


def _study(name: str) -> Any:
    from jaxstage.studies import all_studies

    return next(study for study in all_studies if study.name == name)


def _verdicts(name: str) -> dict[str, str]:
    from jaxstage.studies import stored_verdicts

    return stored_verdicts(_study(name))


def source(study: str) -> str:
    """The paper of a study."""
    return f"Source: {_study(study).source}."


def counts(study: str) -> str:
    """How many claims hold, fail and cannot be checked."""
    from jaxstage.studies.claim import count

    found = count(_verdicts(study))
    total = sum(found.values())
    return (
        f"Of the paper's {total} claims **{found['holds']} hold**, **{found['fails']} fail** and "
        f"**{found['unchecked']} cannot be checked** by simulation (`jaxstage compare {study}` "
        "computes every verdict anew)."
    )


def claims(study: str, verdict: str, fold: str = "") -> str:
    """A table of the claims with a verdict; ``fold`` hides it behind a line."""
    verdicts = _verdicts(study)
    rows = [
        (c.where, c.text, _published(c), f"holds if {c.bound.text}; {c.reason}"
         if c.bound else c.reason)
        for c in _study(study).claims
        if verdicts[c.id] == verdict
    ]  # fmt: skip
    table = _table(("where", "what the paper says", "printed", "what the verdict rests on"), rows)
    if not fold:
        return table
    indented = "\n".join("    " + line for line in table.splitlines())
    words = {"holds": "hold", "fails": "fail", "unchecked": "cannot be checked"}
    return f'??? note "The {len(rows)} claims that {words[verdict]}"\n\n{indented}'


def _published(claim: Any) -> str:
    return "" if claim.published is None else f"{claim.published:.4g} {claim.unit}".strip()


def loops(study: str) -> str:
    """The loops of a study."""
    return _table(("loop", "what it is"), [(f"`{x.name}`", x.summary) for x in _study(study).loops])


def spreads(study: str) -> str:
    """How uncertain its values are."""
    rows = [(f"`{s.path}`", f"{s.low:g} to {s.high:g}", s.reason) for s in _study(study).spreads]
    return _table(("value", "factors", "why"), rows)


def values(loop: str, *roots: str) -> str:
    """The numbers of a loop below ``plant``, ``reference``, ..., with symbol and unit."""
    from jaxstage import find
    from jaxstage.model.fields import in_units_of
    from jaxstage.model.settings import known_leaves

    entry = find(loop)
    case = entry.build(entry.timing)
    rows = []
    for path, (quantity, value) in known_leaves(case.gains, case.scenario, case.path).items():
        if path.split(".")[0] in roots and np.size(value) <= 4:
            unit = in_units_of(quantity, case.loop.plant.command_unit).unit
            numbers = ", ".join(f"{x:.6g}" for x in np.ravel(np.asarray(value, float)))
            rows.append((f"`{path}`", quantity.symbol, numbers, _unit(unit), quantity.doc))
    return _table(("setting", "symbol", "value, one per axis", "unit", "meaning"), rows)


# --- fields ----------------------------------------------------------------------------------


def modules(name: str) -> str:
    """A module, or every module of a package, with all that is public in it."""
    names = [name]
    package = importlib.import_module(name)
    if hasattr(package, "__path__"):
        found = pkgutil.walk_packages(package.__path__, f"{name}.")
        names += [m.name for m in found if not INNER.match(m.name)]
    return "\n\n".join(f"::: {n}" for n in names)


def fields(*names: str) -> str:
    """A table for each pytree class."""
    return "\n\n".join(_fields(_class(name)) for name in names)


def _class(name: str) -> type:
    where, _, last = name.rpartition(".")
    return getattr(importlib.import_module(where), last)


def _fields(cls: type) -> str:
    rows = []
    for field in dataclasses.fields(cls):
        quantity = field.metadata.get("quantity")
        if quantity is None:
            said = field.metadata.get("part") or "data of its own"
            rows.append((f"`{field.name}`", "", "", "", "", said))
            continue
        allowed = quantity.range_text() if quantity.role != "signal" else ""
        if quantity.at_least:
            allowed = f"{allowed}, >= {quantity.at_least}".removeprefix("finite, ")
        rows.append(
            (f"`{field.name}`", quantity.symbol, _unit(quantity.unit), quantity.shape,
             allowed, quantity.doc)
        )  # fmt: skip
    return _table(("field", "symbol", "unit", "shape", "allowed", "meaning"), rows)


#: loops whose reports together hold every metric
REPORTING = ("dfcmac-circle", "asmc-s1", "asmc-mrac", "af-pid-ccc")


def metric_keys() -> str:
    """Every metric that a report of the library may hold: its column, and what it is."""
    from jaxstage.metrics.table import key

    rows = {}
    for cls in {cls for loop in REPORTING for cls in _reports(loop)}:
        for field in dataclasses.fields(cls):
            q = field.metadata["quantity"]
            each = "per axis" if "axes" in q.shape else ""
            rows[key(field.name, q.shown)] = (each, f"{_summary(cls)} {_capital(q.doc)}.")
    table = [(f"`{name}`", *row) for name, row in sorted(rows.items())]
    return _table(("column", "", "what it is"), table)


def _reports(name: str) -> Iterable[type]:
    """The classes in the report of a loop, those of its recorded metrics too. Nothing is run."""
    import jax

    from jaxstage import find, together, with_metric

    entry = find(name)
    case = entry.build(entry.timing)
    stored = [recorded.metric for recorded in entry.recorded]
    run = jax.eval_shape(with_metric(case, together(case.metric, *stored)).simulate)
    found = [run.report] + [
        jax.eval_shape(lambda rows, r=r: r.evaluate(rows, case.loop.dt), run.rows[r.metric.name])
        for r in entry.recorded
    ]
    return [type(x) for x in jax.tree.leaves(found, is_leaf=dataclasses.is_dataclass)]


def _summary(cls: type) -> str:
    return (inspect.getdoc(cls) or "").split("\n\n")[0].replace("\n", " ")


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


# --- commands --------------------------------------------------------------------------------


def commands() -> str:
    """The help of every command, as it is printed."""
    import typer

    from tuning.app.main import app

    root = typer.main.get_command(app)
    context = root.make_context("jaxstage", [], resilient_parsing=True)
    parts = [_help("jaxstage", root, None)]
    for name in sorted(root.commands):  # type: ignore[attr-defined]
        parts.append(_help(f"jaxstage {name}", root.commands[name], context))  # type: ignore[attr-defined]
    return "\n\n".join(parts)


def _help(title: str, command: Any, parent: Any) -> str:
    name = title.split()[-1]
    with command.make_context(name, [], parent=parent, resilient_parsing=True) as context:
        context.max_content_width = 100
        text = command.get_help(context)
    return f"## {title}\n\n```text\n{text}\n```"


# --- tables ----------------------------------------------------------------------------------


def _unit(text: str) -> str:
    return "" if text == "1" else text


def _table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    names = list(head)
    lines = ["| " + " | ".join(names) + " |", "|" + " --- |" * len(names)]
    return "\n".join([*lines, *("| " + " | ".join(map(_cell, row)) + " |" for row in rows)])


def _cell(text: str) -> str:
    """A cell as plain text: nothing in it is markup, but a name in backticks."""
    text = " ".join(str(text).split())
    if re.fullmatch(r"`[^`]+`", text):
        return text.replace("|", "\\|")
    kept = re.split(r"(`[^`]+`)", text)
    return "".join(
        part
        if part.startswith("`")
        else re.sub(r"([\\*_|\[\]$])", r"\\\1", html.escape(part, quote=False))
        for part in kept
    )


GENERATORS: dict[str, Callable[..., str]] = {
    maker.__name__: maker
    for maker in (
        source,
        counts,
        claims,
        loops,
        spreads,
        values,
        fields,
        modules,
        metric_keys,
        commands,
    )
}
