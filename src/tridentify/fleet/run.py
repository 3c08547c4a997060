"""A run over a fleet: what was asked, and the rows that came of it."""

from __future__ import annotations

import contextlib
import io
import json
import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from tridentify.errors import (
    ConstantInputError,
    ConvergenceError,
    DataError,
    IdentifiabilityError,
    OptionError,
    shown,
)
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.likelihood.setup.nuisance import Nuisances
from tridentify.fleet.job import FAILURES, NO_ANSWER, Item
from tridentify.fleet.local import Local, Piece, summable
from tridentify.fleet.passes import Sums, pieces_of, summed
from tridentify.fleet.pool import Pool, pooled
from tridentify.fleet.rows import STILL
from tridentify.fleet.sources import items_of
from tridentify.fleet.store import Store
from tridentify.fleet.together import Pass, Together, Without, chosen_nuisance, joint
from tridentify.fleet.workers.engines import Engine, engine
from tridentify.fleet.working import Question, checked_limits, telling, work_off
from tridentify.numerics.arrays import Array
from tridentify.record.formats.assemble import Wanted
from tridentify.record.record import Record
from tridentify.structure import Structure
from tridentify.writing.files import write_atomically
from tridentify.writing.layout import first_of, format_table, format_value
from tridentify.writing.lock import alone_in
from tridentify.writing.views import FleetViews, pandas_frame

MOST_CAUSES = 8
"""Kinds of failures and cautions that a summary tells one by one."""

MOST_ASKED = 200
"""Units that decide which nuisance terms all have, where a fleet is pooled: more say the same."""

TOGETHER, POOL, POOLED = "together.json", "pool.json", "pool.parquet"
"""Files of `Run.together` and `Run.pool`."""

UNREAD = tuple(status for status in FAILURES if status != NO_ANSWER)
"""Failures of units that have no part in what a fleet says together."""

UNANSWERED = ("no-response", STILL)
"""Cautions of units whose outputs say nothing of the system, only of the noise."""

QUARTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
"""What a summary tells of the distribution of a coefficient."""


@dataclass(frozen=True, eq=False)
class Run(FleetViews):
    """The rows of a fleet, in their folder.

    Attributes
    ----------
    store : Store
    question : Question
    notes : tuple of str
        On parts that were found damaged when the run was resumed.
    common : Together, optional
        One model for all units, where it was asked for.
    population : Pool, optional
        The population of the units, where it was asked for.
    """

    store: Store
    question: Question
    notes: tuple[str, ...] = ()
    common: Together | None = None
    population: Pool | None = None

    @property
    def folder(self) -> Path:
        """Where the results are."""
        return self.store.folder

    @property
    def written(self) -> tuple[Path, ...]:
        """Files beside the rows, of what was asked for of all units together."""
        names = [TOGETHER] if self.common is not None else []
        names += [POOL, POOLED] if self.population is not None else []
        return tuple(self.folder / name for name in names)

    def rows(self, columns: Sequence[str] | None = None) -> Any:
        """Rows as they are stored, lists in place of columns for coefficients.

        Parameters
        ----------
        columns : sequence of str, optional
            Those of `fleet.COLUMNS` that are wanted.

        Returns
        -------
        polars.DataFrame
            Every key once, sorted by key; of several attempts the last.
        """
        return self.store.rows(columns)

    def table(self) -> Any:
        """One row a unit, a column a coefficient.

        Returns
        -------
        pandas.DataFrame
            Sorted by ``key``: the columns of `rows`, and in place of the lists of coefficients
            each coefficient and its standard error, ``a0`` and ``a0_std``; with several outputs
            ``fit`` and ``noise_variance`` are numbered. What a unit does not have is nan.

        Raises
        ------
        MissingDependencyError
            pandas is not installed; `rows` needs none.
        """
        return pandas_frame(wide(self.rows()))

    def failed(self) -> Any:
        """The rows of `table` without a usable estimate, with the reason.

        Returns
        -------
        pandas.DataFrame

        Raises
        ------
        MissingDependencyError
            pandas is not installed.
        """
        rows = self.rows()
        return pandas_frame(wide(rows.filter(~rows["ok"])))

    def estimate(self, key: str) -> Estimate:
        """The whole estimate of one unit, made anew from its record.

        Parameters
        ----------
        key : str

        Returns
        -------
        Estimate
            Whatever its status.

        Raises
        ------
        DataError
            There is no such unit, or its record cannot be used.
        IdentifiabilityError, ConvergenceError
            As `tridentify.identify`.
        """
        return self.question.job.estimate(self.records(key))

    def records(self, key: str) -> tuple[Record, ...]:
        """What one unit was identified from.

        Parameters
        ----------
        key : str

        Raises
        ------
        DataError
            There is no such unit, or its record cannot be read.
        """
        for item in self._items():
            if item.key == key:
                return item.place.records(self.question.job.wanted)
        raise DataError(
            f"found no unit {shown(key)} in the source; expected one of its keys; an iterable that "
            "gives its records only once cannot be asked again"
        )

    def retry(
        self,
        *,
        status: str | Sequence[str] | None = None,
        workers: Any = None,
        time_limit: float | None = None,
        memory_limit: int | None = None,
    ) -> Run:
        """Try the units that failed once more, with other limits if that is asked for.

        Parameters
        ----------
        status : str or sequence of str, optional
            Only those that failed so, such as ``"over time"``.
        workers, time_limit, memory_limit
            As `fleet.fit`; by default as before.

        Returns
        -------
        Run
            The same folder; the new rows count, those before them stay in it.

        Raises
        ------
        OptionError
            No unit failed so, or as `fleet.fit`.
        """
        wanted = (status,) if isinstance(status, str) else status
        rows = self.rows(["key", "ok", "status", "attempt"])
        keys = {
            key: attempt + 1
            for key, ok, found, attempt in rows.iter_rows()
            if not ok and (wanted is None or found in wanted)
        }
        if not keys:
            known = sorted({found for _, ok, found, _ in rows.iter_rows() if not ok})
            that = "" if wanted is None else f" that is {' or '.join(wanted)}"
            raise OptionError(
                f"found no failed unit{that}; expected some to try again; failed are: "
                f"{', '.join(known) or 'none'}"
            )
        before = self.question.limits
        limits = checked_limits(
            before.seconds if time_limit is None else time_limit,
            before.memory if memory_limit is None else memory_limit,
        )
        question = replace(
            self.question,
            workers=self.question.workers if workers is None else workers,
            limits=limits,
        )
        with alone_in(self.store.folder):
            items, _ = items_of(question.source, question.key)
            waiting = (replace(one, attempt=keys[one.key]) for one in items if one.key in keys)
            work_off(waiting, question, self.store, telling(False), len(keys), 0)
        return Run(self.store, question, self.notes)

    def together(self) -> Together:
        """One model for all units, as if one machine identified all records at once.

        Returns
        -------
        Together
            Also written as ``together.json``.

        Raises
        ------
        UnsupportedError
            Orders are left open, delays are estimated, or something is known of coefficients.
        IdentifiabilityError
            All units have references (it is done in open loop). No unit has an estimate to begin
            from, or all of them do not tell the coefficients.
        ConvergenceError
            No maximum was reached.

        Notes
        -----
        The joint estimate of maximum likelihood with white noise, ``identify(records, structure,
        ThreeModel(noise="white", finish="likelihood"))``; records of which it is not stated what
        the input does between samples are taken each for what it looks like.

        Where units show no response to their input the estimate is made without them, too, and
        what comes of it stands beside (`Together.without`): their noise counts as that of all.
        """
        structure = summable(self.question.job.structure)
        names, values = coefficients(self._good())
        if not names:
            raise IdentifiabilityError(
                "found no unit with an estimate; expected some to begin from; look at the messages "
                "of run.failed()"
            )
        skipped = self._unread()
        with engine(self.question.workers) as workers:

            def looking(gone: Mapping[str, str]) -> Pass:
                def look(theta: Array, choices: tuple[Nuisances, ...]) -> Sums:
                    job = Local(structure, tuple(theta.tolist()), choices, self._wanted)
                    items = (one for one in self._items() if one.key not in gone)
                    return summed(workers, items, job, self.question.limits)

                return look

            found = joint(looking(skipped), np.median(values, axis=0))
            mute = {key: why for key, why in self._mute().items() if key not in skipped}
            if mute and len(mute) < found.n_units:
                with contextlib.suppress(IdentifiabilityError, ConvergenceError):  # others are few
                    other = joint(looking({**skipped, **mute}), np.median(values, axis=0))
                    found = replace(found, without=Without(mute, other.theta, other.std))
        found = replace(found, left_out={**skipped, **found.left_out})
        write_atomically(self.folder / TOGETHER, json.dumps(found.to_dict(), indent=1))
        return found

    def pool(self) -> Pool:
        """The population that the units come from, and every unit in its light.

        Returns
        -------
        Pool
            Also written as ``pool.json`` and, a row a unit, ``pool.parquet``.

        Raises
        ------
        UnsupportedError
            As `together`.
        TooFewSamplesError
            There are fewer than ten units for each coefficient.
        """
        import polars as pl

        structure = summable(self.question.job.structure)
        good = self._good()
        names, values = coefficients(good)
        skipped = self._unread()
        own = {key: () for key in self.rows(["key"])["key"] if key not in skipped}
        own |= dict(zip(good["key"], values.tolist(), strict=True))
        with engine(self.question.workers) as workers:
            choice = self._usual_nuisance(structure, workers, skipped, values)

            def look(at: Mapping[str, Sequence[float]]) -> Mapping[str, Piece]:
                job = Local(structure, (), (choice,), self.question.job.wanted)
                items = (
                    replace(one, about=tuple(at[one.key])) for one in self._items() if one.key in at
                )
                return pieces_of(workers, items, job, self.question.limits)

            found = pooled(look, names, own)
        write_atomically(self.folder / POOL, json.dumps(found.to_dict(), indent=1))
        content = io.BytesIO()
        pl.DataFrame(found.columns()).write_parquet(content)
        write_atomically(self.folder / POOLED, content.getvalue())
        return found

    def _usual_nuisance(
        self, structure: Structure, workers: Engine, skipped: Mapping[str, str], values: Array
    ) -> Nuisances:
        """Nuisance terms for all units alike: what AICc says of the first of them together."""
        some = (one for one in self._items() if one.key not in skipped)
        job = Local(structure, tuple(np.median(values, axis=0).tolist()), (), self._wanted)
        sums = summed(workers, islice(some, MOST_ASKED), job, self.question.limits)
        return chosen_nuisance(sums)

    @property
    def _wanted(self) -> Wanted:
        return self.question.job.wanted

    def _items(self) -> Iterator[Item]:
        return items_of(self.question.source, self.question.key)[0]

    def _good(self) -> Any:
        rows = self.rows(["key", "ok", "names", "coefficients", "standard_errors"])
        return rows.filter(rows["ok"])

    def _mute(self) -> dict[str, str]:
        """Key -> caution of units that show no response."""
        rows = self.rows(["key", "cautions", "exception"])
        still = ConstantInputError.__name__
        told = (
            (key, [c for c in (STILL, *codes) if c in UNANSWERED][error != still :])
            for key, codes, error in rows.iter_rows()
        )
        return {key: codes[0] for key, codes in told if codes}

    def _unread(self) -> dict[str, str]:
        """Key -> reason of units whose records cannot be used at all."""
        rows = self.rows(["key", "status", "message"])
        return {key: f"{s}: {m}" for key, s, m in rows.iter_rows() if s in UNREAD}

    def summary(self) -> str:
        """Text for people: how many, what failed and why, how the coefficients are distributed."""
        rows = self.rows()
        good = rows.filter(rows["ok"])
        failed = rows.height - good.height
        lines = [f"{rows.height} records: {good.height} with an estimate, {failed} without"]
        if rows.height:
            seconds = rows["seconds"]
            lines.append(
                f"{seconds.median():.3g} s a record (median), {seconds.sum():.4g} s in all"
            )
        bad = rows.filter(~rows["ok"])
        lines += _counted("without an estimate", bad["status"].to_list())
        lines += [f"  {key}: {why}" for key, why in bad["key", "message"].rows()[:MOST_CAUSES]]
        lines += _counted("status", good["status"].to_list())
        lines += _counted("cautions", [code for codes in good["cautions"] for code in codes])
        names, values = coefficients(good)
        if names:
            titles = ("coefficient", *(f"{100 * q:.0f} %" for q in QUARTILES), "std error")
            lines += ["", *format_table(titles, distribution(names, values, good))]
        for found in (self.common, self.population):
            lines += [] if found is None else ["", found.summary()]
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """Counts, and quantiles of the coefficients, ready for JSON."""
        rows = self.rows(["key", "ok", "status", "cautions", "names", "coefficients", "place"])
        good = rows.filter(rows["ok"])
        names, values = coefficients(good)
        ends = np.quantile(values, QUARTILES, axis=0).T if names else np.zeros((0, 0))
        more = {"together": self.common, "population": self.population}
        return {
            "records": rows.height,
            "estimates": good.height,
            "failed": rows.height - good.height,
            "status": dict(Counter(rows["status"].to_list()).most_common()),
            "cautions": dict(Counter(c for codes in rows["cautions"] for c in codes).most_common()),
            "quantiles": list(QUARTILES),
            "coefficients": dict(zip(names, ends.tolist(), strict=True)),
            "folder": os.fspath(self.folder),
            **{name: one.to_dict() for name, one in more.items() if one is not None},
        }

    def __repr__(self) -> str:
        rows = self.rows(["ok"])
        good = int(rows["ok"].sum() or 0)
        where = os.fspath(self.folder)
        return f"Run({rows.height} records, {good} with an estimate, in {where!r})"


def distribution(names: Sequence[str], values: Array, good: Any) -> list[tuple[str, ...]]:
    """Rows of a table: coefficient, its quantiles, and the standard error of a typical unit.

    Parameters
    ----------
    names : sequence of str
    values : ndarray, shape (n_units, n)
    good : polars.DataFrame
        Rows of these units.
    """
    errors = np.nanmedian(np.stack(good["standard_errors"].to_list()), axis=0)
    ends = np.quantile(values, QUARTILES, axis=0).T
    return [
        (name, *(format_value(v, std) for v in row.tolist()), f"{std:.2g}")
        for name, row, std in zip(names, ends, errors.tolist(), strict=True)
    ]


def coefficients(rows: Any) -> tuple[tuple[str, ...], Any]:
    """Names and values where all rows have the same; nothing where they do not.

    Parameters
    ----------
    rows : polars.DataFrame
        With an estimate.

    Returns
    -------
    names : tuple of str
    values : ndarray, shape (n_rows, n_names)
    """
    every = {tuple(names) for names in rows["names"].to_list()}
    if len(every) != 1:
        return (), np.zeros((rows.height, 0))
    return every.pop(), np.stack(rows["coefficients"].to_list())


def wide(rows: Any) -> dict[str, Any]:
    """Columns of a table for people: one a coefficient.

    Parameters
    ----------
    rows : polars.DataFrame
        As stored.
    """
    lists = ("names", "coefficients", "standard_errors", "fit", "noise_variance", "covariance")
    columns: dict[str, Any] = {}
    for name in rows.columns:
        if name not in lists:
            columns[name] = rows[name].to_list()
    found: dict[str, Any] = {}
    for k, row in enumerate(rows.select(lists[:5]).iter_rows()):
        names, values, errors, fit, noise = row
        cells = dict(zip(names, values, strict=True))
        cells |= {f"{n}_std": v for n, v in zip(names, errors, strict=True)}
        for title, parts in (("fit", fit), ("noise_variance", noise)):
            several = len(parts) > 1
            cells |= {f"{title}_{i}" if several else title: v for i, v in enumerate(parts, 1)}
        for name, value in cells.items():
            if name not in found:
                found[name] = np.full(rows.height, np.nan)
            found[name][k] = np.nan if value is None else value
    at = list(columns).index("seconds")
    head = dict(list(columns.items())[:at])
    tail = dict(list(columns.items())[at:])
    return head | found | tail | {"covariance": rows["covariance"].to_list()}


def _counted(title: str, found: Sequence[str]) -> list[str]:
    counts = [f"{name} {count}" for name, count in Counter(found).most_common()]
    return [f"{title}: {first_of(counts, MOST_CAUSES, 'more kinds')}"] if counts else []
