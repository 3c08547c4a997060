"""``tridentify demo``: the main job on the record that ships with the package, and its truth."""

from __future__ import annotations

import json
import math
import shlex
import shutil
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from importlib.resources import as_file, files
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from tridentify.cli import tables
from tridentify.cli.results import ResultFolder
from tridentify.cli.run import estimate_model, load_compiled, write_results
from tridentify.cli.terminal import Activity, listed, own_command, paragraph, show, show_json
from tridentify.cli.work import describe_files
from tridentify.estimation.answer.estimate import Estimate
from tridentify.record.formats.read import read_record
from tridentify.record.record import Record
from tridentify.structure import Structure
from tridentify.writing.layout import format_std, format_value

STEM = "short_period"
TITLE = "Short period of an A-4 at 200 m/s and 5000 m"
NOT_DETERMINED = "not determined"
NUMERATORS = ("b alone", "b1 s + b0")
# Both numerators are called b by the identification; the truth keeps b for alpha and c for q.
LETTERS = {"alpha": "b", "q": "c", "alpha_true": "b"}


@dataclass(frozen=True)
class Comparison:
    """One coefficient beside its truth."""

    name: str
    value: float
    std: float
    truth: float
    unit: str

    @property
    def percent(self) -> float:
        """Error in percent of the truth: positive where the magnitude is too large."""
        return 100 * (self.value - self.truth) / self.truth

    @property
    def percent_text(self) -> str:
        """The same as text; of a value below its standard error a percentage says nothing."""
        return f"{self.percent:+.2f}" if self.std <= abs(self.value) else NOT_DETERMINED

    @property
    def in_std(self) -> float:
        """Error in standard errors."""
        return (self.value - self.truth) / self.std if self.std else math.nan


@dataclass(frozen=True, eq=False)
class Fitted:
    """One identification of the demonstration record."""

    record: Record
    estimate: Estimate
    rows: tuple[Comparison, ...]


def demo(
    out: Annotated[Path, typer.Option(metavar="DIR")] = Path("tridentify-demo"),
    as_json: Annotated[bool, typer.Option("--json")] = False,
) -> None:
    """Identify the aircraft record that ships with the package and compare with the truth.

    The record is ten simulated seconds of an A-4 whose elevator makes a 3-2-1-1. Angle of attack
    and pitch rate carry sensor noise; the engine that flew it states the true coefficients.

    Parameters
    ----------
    out
        Folder for the report, the figures and the record.
    as_json
        Print one JSON object instead of tables.
    """
    with ExitStack() as stack:
        results = stack.enter_context(ResultFolder(out))
        activity = stack.enter_context(Activity())
        folder = stack.enter_context(as_file(files("tridentify") / "data"))
        story = json.loads((folder / f"{STEM}.json").read_text(encoding="utf-8"))
        load_compiled(activity)

        def fit(*outputs: str, zeros: int) -> Fitted:
            activity.stage(f"identifying {listed(outputs)}, numerator {NUMERATORS[zeros]}")
            return _fit(folder / f"{STEM}.csv", story, outputs, zeros)

        alpha, both = fit("alpha", zeros=1), fit("alpha", "q", zeros=1)
        numerators = {
            "b1 s + b0, with noise": alpha,
            "b alone, with noise": fit("alpha", zeros=0),
            "b1 s + b0, without noise": fit("alpha_true", zeros=1),
            "b alone, without noise": fit("alpha_true", zeros=0),
        }
        write_results(both.estimate, both.record, results.draft, activity, TITLE)
        shutil.copyfile(folder / f"{STEM}.csv", results.draft / f"{STEM}.csv")
        written = results.publish()
    if as_json:
        show_json(_document(alpha, both, numerators, written))
    else:
        show(*_account(story, alpha, both, numerators), *describe_files(written), _next(out))


def _fit(file: Path, story: Mapping[str, Any], outputs: Sequence[str], zeros: int) -> Fitted:
    record = read_record(
        file,
        time="t",
        inputs=["delta_e"],
        outputs=outputs,
        units={name: story["record"]["units"][name] for name in ("t", "delta_e", *outputs)},
    )
    estimate = estimate_model(record, Structure(2, zeros))
    return Fitted(record, estimate, compare(estimate, story["short_period"]))


def compare(estimate: Estimate, truth: Mapping[str, float]) -> tuple[Comparison, ...]:
    """Put every coefficient beside its truth.

    Parameters
    ----------
    estimate : Estimate
        Of one or both of the outputs alpha and q.
    truth : mapping of str to float
        a1, a0; b1, b0 of alpha; c1, c0 of q.

    Returns
    -------
    tuple of Comparison
        In the order of the estimate.
    """
    rows = []
    for name, parameter in estimate.parameters.items():
        letter, power = name[0], name[1]
        if letter == "b":
            channel = name.partition("[")[2].partition(",")[0] or estimate.output_names[0]
            letter = LETTERS[channel]
        rows.append(
            Comparison(name, parameter.value, parameter.std, truth[letter + power], parameter.unit)
        )
    return tuple(rows)


def _account(
    story: Mapping[str, Any], alpha: Fitted, both: Fitted, numerators: Mapping[str, Fitted]
) -> list[str | Table]:
    noise = {name: math.degrees(std) for name, std in story["noise"]["std"].items()}
    return [
        paragraph(
            f"The record: ten seconds of a simulated {story['flight']['aircraft']} "
            f"({story['provenance']['engine']}), 50 samples a second. The elevator makes a 3-2-1-1 "
            "of one degree and then its mirror image. Angle of attack and pitch rate carry white "
            f"noise of {noise['alpha']:.2g} deg and {noise['q']:.2g} deg/s. The truth comes from "
            "the engine's own accelerations at trim."
        ),
        "1. Angle of attack alone: alpha / delta_e = (b1 s + b0) / (s^2 + a1 s + a0)",
        _comparison_table(alpha.rows),
        _verdict(alpha),
        "2. Pitch rate along with it, one denominator for both",
        _comparison_table(both.rows),
        _verdict(both, _gain(alpha, both)),
        "3. Why b1 s + b0 and not b alone: error of each coefficient of alpha [%]",
        _numerator_table(numerators),
        _bias(numerators),
    ]


def _comparison_table(rows: Iterable[Comparison]) -> Table:
    titles = ("coefficient", "value", "std error", "truth", "error [%]", "[std err]", "unit")
    cells = [
        (
            row.name,
            format_value(row.value, row.std),
            format_std(row.std),
            format_value(row.truth, row.std),
            row.percent_text,
            f"{abs(row.in_std):.2f}",
            row.unit,
        )
        for row in rows
    ]
    return tables.make_table(titles, [cells])


def _verdict(fitted: Fitted, more: str = "") -> str:
    within = sum(abs(row.in_std) <= 2 for row in fitted.rows)
    weak = [row.name for row in fitted.rows if row.std > 0.5 * abs(row.truth)]
    found = [f"{item['output']} {item['fit']:.1f} %" for item in tables.fits(fitted.estimate)]
    text = (
        f"{within} of {len(fitted.rows)} coefficients lie within two standard errors of the truth. "
        f"Fit: {listed(found)}; the rest is noise."
    )
    if weak:
        text += (
            f" {listed(weak)}, the lift of the elevator itself, is no larger than its standard "
            "error: the record says little more than that it is small."
        )
    return paragraph(f"{text} {more}")


def _gain(alpha: Fitted, both: Fitted) -> str:
    ratio = [one.std / two.std for one, two in zip(alpha.rows, both.rows, strict=False)]
    return (
        f"The second output makes the standard errors of a1 and a0 {ratio[0]:.1f} and "
        f"{ratio[1]:.1f} times smaller."
    )


def _numerator_table(numerators: Mapping[str, Fitted]) -> Table:
    names = ("a1", "a0", "b1", "b0")
    rows = []
    for title, fitted in numerators.items():
        errors = {row.name: row.percent_text for row in fitted.rows}
        rows.append((title, *(errors.get(name, "left out") for name in names)))
    return tables.make_table(("error [%]", *names), [rows])


def _bias(numerators: Mapping[str, Fitted]) -> str:
    full, short = list(numerators.values())[2:]
    largest = max(abs(row.percent) for row in full.rows if row.name != "b1")
    own = listed([f"{row.percent:+.1f} % in {row.name}" for row in short.rows])
    return paragraph(
        "The elevator lifts a little by itself, and alpha answers to that at once: this is b1. The "
        "form with b alone, as in the paper's example, leaves it out. Without noise that costs "
        f"{own}: a bias that neither a longer record nor a better sensor takes away. With b1 "
        f"the other errors are at most {largest:.1f} %, from the aircraft's nonlinearity and its "
        "slow mode. In one noisy record the noise hides the bias (first two rows); the mean over "
        "many records shows it."
    )


def _next(out: Path) -> str:
    record, report = (shlex.quote(str(out / name)) for name in (f"{STEM}.csv", "report.html"))
    other, command = shlex.quote(str(out / "pitch-rate")), own_command()
    return "\n".join(
        (
            "What to look at, and to try next:",
            f"  {report}   (in a browser; both outputs, part 2 above)",
            f"  {command} identify {record} --input delta_e --output q \\",
            f"      --poles 2 --zeros 1 --out {other}",
            f"  {command} identify YOUR.csv --input NAME --output NAME --poles 2 --zeros 1",
            f"  {command} study aircraft --draws 20",
        )
    )


def _document(
    alpha: Fitted, both: Fitted, numerators: Mapping[str, Fitted], written: Sequence[Path]
) -> dict[str, Any]:
    def entry(fitted: Fitted) -> dict[str, Any]:
        rows = [
            asdict(row) | {"error_percent": row.percent, "error_in_std": row.in_std}
            for row in fitted.rows
        ]
        return {"comparison": rows, **tables.estimate_document(fitted.estimate, [fitted.record])}

    return {
        "alpha": entry(alpha),
        "alpha and q": entry(both),
        "numerators": {title: entry(fitted) for title, fitted in numerators.items()},
        "files": [str(path) for path in written],
    }
