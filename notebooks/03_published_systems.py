# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#     text_representation:
#       extension: .py
#       format_name: percent
#       format_version: '1.3'
#       jupytext_version: 1.19.6
#   kernelspec:
#     display_name: Python 3 (ipykernel)
#     language: python
#     name: python3
# ---

# %% [markdown]
#

# %% [markdown]
# # The four published systems
#
# Four papers, four machines, and everything their authors claim: each claim is a predicate with a
# threshold on metrics that experiments compute. This notebook lists every claim with its verdict,
# then computes some of the verdicts anew.

# %%
from collections import Counter

import ipywidgets
import matplotlib.pyplot as plt
from IPython.display import display

import jaxstage as js
from jaxstage import plot, studies

# %matplotlib inline

js.configure(precision="double")

# %% [markdown]
# How long that takes is up to you: a whole paper needs minutes, one experiment seconds.

# %% tags=["parameters"]
AGAIN = "fuzzy-ccc"  # the study whose claims are computed again
ONLY = None  # the names of its experiments, or None for all of them

# %% [markdown]
# ## What holds, what fails, what nobody can tell
#
# A claim is *unchecked* where it is about a field test, or about a value that is not printed. It
# *fails* also where the paper contradicts itself: an average that is not that of its own column is
# a failed claim like any other.

# %%
stored = {study.name: studies.stored_verdicts(study) for study in studies.all_studies}
counts = {name: Counter(verdicts.values()) for name, verdicts in stored.items()}
figure, ax = plt.subplots(figsize=(10, 3), layout="constrained")
left = dict.fromkeys(counts, 0)
for verdict, colour in (("holds", "#009E73"), ("fails", "#D55E00"), ("unchecked", "#8A8A8A")):
    numbers = [counts[name][verdict] for name in counts]
    ax.barh(list(counts), numbers, left=list(left.values()), color=colour, label=verdict)
    left = {name: left[name] + n for name, n in zip(counts, numbers, strict=True)}
ax.set(xlabel="claims", title="Verdicts, as stored with the studies")
ax.legend(ncols=3)

# %% [markdown]
# ## Every claim
#
# A tab for each paper: where it stands, what it says, the verdict, and what that rests on.


# %%
def row(claim, verdict):
    cells = (claim.where, claim.text, verdict, claim.reason)
    return "<tr>" + "".join(f"<td style='text-align:left'>{cell}</td>" for cell in cells) + "</tr>"


def table(study):
    rows = [row(claim, stored[study.name][claim.id]) for claim in study.claims]
    head = "<tr><th>where</th><th>claim</th><th>verdict</th><th>reason</th></tr>"
    return ipywidgets.HTML(f"<p>{study.source}</p><table>{head}{''.join(rows)}</table>")


tabs = ipywidgets.Tab([table(study) for study in studies.all_studies])
tabs.titles = [study.name for study in studies.all_studies]
display(tabs)

# %% [markdown]
# ## Computing verdicts again
#
# An experiment simulates what some claims need and gives *evidence*: metrics by name. `judge` holds
# a claim against it. A claim whose evidence is not there is left out here.

# %%
study = next(study for study in studies.all_studies if study.name == AGAIN)
evidence = {}
for experiment in study.experiments:
    if ONLY is None or experiment.name in ONLY:
        print(experiment.text)
        evidence |= experiment.measure()


# %%
def judged(claim):
    try:
        return studies.judge(claim, evidence)
    except KeyError:  # its experiment was left out
        return None


found = [one for one in map(judged, study.claims) if one is not None and one.ours is not None]
for one in found:
    print(f"{one.verdict:6s} {one.text}")
assert all(one.verdict == stored[AGAIN][one.id] for one in found)

# %% [markdown]
# And as one picture: dots are our value over the published one.

# %%
plot.claims(study.title, tuple(found))
