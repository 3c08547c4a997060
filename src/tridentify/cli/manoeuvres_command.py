"""``tridentify manoeuvres``: long logs in, the pieces of them that are worth identifying out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

from tridentify.cli import options
from tridentify.cli.groups import Measured, Reading
from tridentify.cli.load import load
from tridentify.cli.run import load_compiled
from tridentify.cli.tables import describe_records
from tridentify.cli.terminal import Activity, paragraph, show, show_json
from tridentify.errors import OptionError

if TYPE_CHECKING:
    from tridentify.judgement.advice import Manoeuvre


NONE = (
    "no manoeuvre was found: nowhere does an input move after a quiet stretch with an answer above "
    "the noise"
)


def manoeuvres(
    measured: Measured,
    *,
    reading: Reading,
    gap: Annotated[float | None, options.record_option(metavar="SECONDS")] = None,
    as_json: options.AsJson = False,
) -> None:
    """Find the pieces of a long log that are worth identifying: an input moves, and is answered.

    Example: tridentify manoeuvres flight.csv --input elevator --output q

    Parameters
    ----------
    gap
        Quiet that separates two manoeuvres and stands before and after each; by default a hundredth
        of the record, less where a long log has no quiet of that length.
    """
    from tridentify.judgement.advice import find_manoeuvres

    if gap is not None and not gap > 0.0:
        raise OptionError(f"found --gap {gap:g}; expected seconds above zero; correct it")
    inputs, outputs = measured.columns()
    source = reading.source(measured.files, inputs, outputs)
    with Activity() as activity:
        records = load(source, activity)
        load_compiled(activity)
        activity.stage("looking for manoeuvres")
        found = [find_manoeuvres(record, gap) for record in records]
    if as_json:
        pairs = zip(records, found, strict=True)
        rows = [{"name": r.name, "manoeuvres": [one._asdict() for one in own]} for r, own in pairs]
        show_json({"records": rows})
    else:
        show(describe_records(records), *map(_listed, found))


def _listed(found: Sequence[Manoeuvre]) -> str:
    """The manoeuvres of a record, each as the option that takes it."""
    if not found:
        return paragraph(NONE)
    wide = len(str(len(found)))
    return "\n".join(
        paragraph(f"--range {one.start:.10g}:{one.stop:.10g}  {one.why}", f"{k:{wide}d}  ", "    ")
        for k, one in enumerate(found, 1)
    )
