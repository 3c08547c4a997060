"""Which order: candidates in one table, and a recommendation with its reasons.

- `select` (`select_structure`): the way from records and candidates to a `Selection`.
- `shared`: the parallel model, fitted once; starting poles for candidates in coloured noise.
- `contest`: every candidate finished on the likelihood's maximum, in rounds, all on one noise
  model.
- `criteria`: AIC, AICc, BIC and YIC. `held_out`: the cross-validated fit.
- `soundness`: what speaks against a candidate. `paired`: two of them on the same held-out samples.
- `rule`: which row is recommended. `words`: why.
- `in_loop`: the same for a plant whose input reacts to its output, one sample ahead.
- `hankel`: Hankel singular values of the parallel model, with a floor of what noise alone gives.
"""

from __future__ import annotations

from tridentify.judgement.selection.hankel import Hankel, hankel_values
from tridentify.judgement.selection.orders import default_candidates
from tridentify.judgement.selection.result import Selection, SelectionRow
from tridentify.judgement.selection.select import select_structure

__all__ = [
    "Hankel",
    "Selection",
    "SelectionRow",
    "default_candidates",
    "hankel_values",
    "select_structure",
]
