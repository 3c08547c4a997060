"""What is to be said of the noise: samples that stand alone, colour, size, another record."""

from __future__ import annotations

import numpy as np

from tridentify.estimation.answer.decision import DecisionKind
from tridentify.estimation.answer.finding import Finding
from tridentify.judgement.causes.system.slow import HALVES, MOSTLY_SLOW, slow_share
from tridentify.judgement.validation.known_causes import KnownCauses
from tridentify.judgement.validation.noise_of_each import of_each
from tridentify.judgement.validation.phrases import (
    AT_MOVES,
    LOOK_THERE,
    around_top,
    one_finding,
    seconds,
    when,
)
from tridentify.judgement.validation.residuals import View
from tridentify.judgement.validation.result import Transfer
from tridentify.judgement.validation.statistics.distribution import at_moves
from tridentify.judgement.validation.statistics.evidence import Evidence

ROBUST = "use a robust loss (loss='huber' or 'student'; --loss), or mark them as missing"
WEIGHED = "mark them as missing where they are wrong; the robust loss gives them little weight"
"""What to do about bad samples under the squared loss, and under one that does so already."""

MATTERS = 1.5
"""Largest over smallest size of the noise from which standard errors are called wrong: those of
halves of a record at 1 and 1.5 are off by a quarter at most."""

MOSTLY_WITHIN = 2.58
"""Standard deviations that 99 % of a correlation of white noise stays within."""

SET_IN = (
    "record what acts there (a door, a load, a gust) as an input, or identify stretches without "
    "it; look whether rows of the file are missing there"
)
"""What to do about disturbances that are seen to set in."""


def about_noise(
    one: Evidence, name: str, rejected: dict[tuple[str, str], float], beside: KnownCauses
) -> list[Finding]:
    """Samples that stand alone, a distribution that is not Gaussian, noise of changing size."""
    view, found = beside.view, []
    rows = one.normality.shocks
    if len(rows) and not np.isnan(one.scale):
        far = rows[np.argsort(-np.abs(rows[:, 2]))][:3]
        many, move = f"{len(rows)} disturbances set", "move"
        if len(rows) == 1:
            many, move = "a disturbance sets", "moves"
        which = "at" if len(rows) <= 3 else "the largest at"
        found.append(
            one_finding(
                "drift",
                name,
                f"{many} in at once and {move} {name} from there on ({which} "
                f"{when(far, len(view.records))}): no sample is wrong, but what is taken for noise "
                "is not alike over the record, and slow coefficients rest on that",
                SET_IN,
                times=np.sort(rows[:, 1]).tolist(),
            )
        )
    rows = one.normality.outliers
    if len(rows) and not np.isnan(one.scale):
        far = rows[np.argsort(-np.abs(rows[:, 2]))]
        at = when(far[:3], len(view.records))
        many = f"{len(rows)} samples lie" if len(rows) > 1 else "a sample lies"
        which = "at" if len(rows) <= 3 else "the farthest at"
        first = int(rows[0, 0])
        places = [(int(e), int(np.argmin(np.abs(view.records[int(e)].t - t)))) for e, t, _ in rows]
        moves = at_moves(view.records, places)
        found.append(
            one_finding(
                "bad-samples",
                name,
                f"{many} up to {np.abs(far[0, 2]):.0f} standard deviations from the model of "
                f"{name} ({which} {at}){f', {AT_MOVES}' if moves else ''}",
                LOOK_THERE.rstrip(".") if moves else WEIGHED if beside.robust else ROBUST,
                "note" if moves else "warning",
                times=np.sort(rows[:, 1]).tolist(),
                effect=beside.without_bad.rstrip("."),
                experiment=first if len(view.records) > 1 and np.all(rows[:, 0] == first) else None,
            )
        )
    elif ("Gaussian", name) in rejected and not found:
        found.append(
            one_finding(
                "distribution",
                name,
                f"the residual of {name} is not Gaussian (skewness {one.normality.skewness:.2f}, "
                f"excess kurtosis {one.normality.kurtosis:.2f}); the numbers do not rest on that",
                ""
                if beside.robust
                else "nothing, unless the tails are heavy: then loss='student' is more accurate",
                "note",
            )
        )
    if ("scale", name) in rejected:
        noises = [output.noise for output in view.outputs]
        each = of_each(view, one, name, beside.estimate, noises)
        found.append(each or _of_changing_size(one, name))
    return found


def _of_changing_size(one: Evidence, name: str) -> Finding:
    """Noise that is larger in one part of the record than in another."""
    ratio = float(np.nanmax(one.scales) / max(float(np.nanmin(one.scales)), 1e-300))
    little = ratio < MATTERS
    return one_finding(
        "noise-changes",
        name,
        f"the noise of {name} changes its size over the record, by a factor of {ratio:.1f}: the "
        f"standard errors are {'a little off' if little else 'not right'}",
        "" if little else "cut the record, or take standard errors from parts of it",
        "note" if little else "warning",
    )


def carried_findings(
    view: View, transfer: Transfer, rejected: dict[tuple[str, str], float]
) -> list[Finding]:
    """What another record says of coefficients and noise of an estimate."""
    found = []
    if ("same coefficients", "all") in rejected:
        found.append(
            one_finding(
                "another-system",
                "all",
                "the coefficients of this record differ from the estimate by more than its "
                "standard errors",
                "identify both records together if they are one system, else each on its own",
            )
        )
    for i, output in enumerate(view.outputs):
        if ("size of the noise", output.name) in rejected:
            more = transfer.size_ratio[i] > 1
            why, advice = (
                f"this record is {'noisier' if more else 'quieter'}",
                "nothing for the model; weight the records by their noise if they are joined",
            )
            spoilt = [("past inputs", output.name), ("level", output.name)]
            if any(key in rejected for key in [*spoilt, ("same coefficients", "all")]):
                why, advice = (
                    "what the model misses is in it, and it does not tell the noise of this record",
                    "mend what is missing first, and validate again",
                )
            found.append(
                one_finding(
                    "noise-size",
                    output.name,
                    f"the residual of {output.name} is {_times(transfer.size_ratio[i])} times as "
                    f"large as the estimate leads to expect: {why}",
                    advice,
                    "note",
                )
            )
    return found


def _times(ratio: float) -> str:
    """A ratio to two decimals, or to two digits where it is very small or large.

    Examples
    --------
    >>> _times(1.234), _times(0.00321), _times(4321.0)
    ('1.23', '0.0032', '4300')
    """
    return f"{ratio:.2f}" if 0.1 <= ratio < 100.0 else f"{float(f'{ratio:.2g}'):.10g}"


def not_white(one: Evidence, name: str, beside: KnownCauses) -> Finding:
    """A residual that is correlated with itself, and whether the errors that are stated know it."""
    view = beside.view
    modelled = _has_noise(view, name)
    noise = "the noise model does not fit" if modelled else "the noise is not white"
    if view.own and not modelled and beside.estimate.trace.about(DecisionKind.NOISE_WHITE):
        noise += ", by more tests than the one that it passed when it was taken as white"
    seen = f"the residual of {name} is correlated with itself at {_reach(view, one)}: {noise}"
    if not view.own and (slow := _slowest(view, name)) > MOSTLY_SLOW:
        text = (
            f"a slow disturbance moves {name} in this record: {100 * slow:.0f} % of the residual "
            f"is slower than {HALVES // 2} periods a record"
        )
        return one_finding("drift", name, text, "look what moved it there")
    if view.own and beside.estimate.errors == "scores":
        allows = (
            f"{seen}; the standard errors are from the scatter of the scores, which allows for it"
        )
        if modelled or beside.robust or view.uneven:
            do = "look for what shakes the output, if smaller standard errors are wanted"
            return one_finding("noise-model", name, allows, do, "note")
        do = "use noise='ar' (--noise ar), which estimates the noise along, for smaller ones"
        do = _declined(beside) or do
        return one_finding("noise-model", name, allows, do)
    if modelled or beside.robust:
        do = "take the standard errors for too small"
    elif view.uneven:
        do = "take the standard errors for too small; a noise model needs uniform time: resample"
    else:
        do = _declined(beside) or "use noise='ar' (--noise ar), which estimates the noise along"
    does_not = f"{seen}, and the standard errors do not allow for it"
    return one_finding("noise-model", name, does_not, do)


def _slowest(view: View, name: str) -> float:
    """Share of what is left of an output that is slow, in the record where it is most."""
    own = [output for output in view.outputs if output.name == name]
    return max((slow_share(one) for output in own for one in output.residual), default=0.0)


def _declined(beside: KnownCauses) -> str:
    """What to do where a noise model was tried and not taken; empty where none was tried."""
    if not beside.declined:
        return ""
    return (
        f"find what the model misses (a delay, a drift, the order): a noise model was tried and "
        f"not taken ({beside.declined})"
    )


def _has_noise(view: View, name: str) -> bool:
    return any(output.name == name and output.noise.size > 0 for output in view.outputs)


def _reach(view: View, one: Evidence) -> str:
    found = one.autocorrelation
    ratio = np.abs(found.value - found.mean) / np.where(found.std > 0, found.std, np.inf)
    low, high = around_top(ratio, MOSTLY_WITHIN)
    return seconds((low + 1) * view.step, (high + 1) * view.step)
