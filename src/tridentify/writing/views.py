"""The one place where the house calls upward: what a model can be asked to show of itself.

Imports point downward everywhere. A user, though, asks the thing in hand:
``estimate.plot(record)``, ``model.step()``, ``estimate.report("page.html")``. The pictures and the
report stand floors above the estimate, so the methods here load their room by name when they are
first called, as pandas loads what draws its frames. Nothing of the room is needed before, an import
stays as light as it was, and an estimate is computed, saved and loaded where there is no plotting
library.

No other module reaches a room in this way (`tests/meta/test_layers.py` looks for it).
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from importlib import import_module
from pathlib import Path
from typing import Any

from tridentify.errors import MissingDependencyError, OptionError
from tridentify.numerics.arrays import Array
from tridentify.writing.pointers import OF_AN_ESTIMATE, Pointers


def room(name: str) -> Any:
    """A room of the package above the caller, loaded when it is asked for.

    Parameters
    ----------
    name : {"plots", "report"}

    Examples
    --------
    >>> room("plots").__name__
    'tridentify.plots'
    """
    return import_module(f"tridentify.{name}")


_UNSEEN: ContextVar[bool] = ContextVar("unseen", default=False)


@contextmanager
def unseen() -> Iterator[None]:
    """Keep the figures that are made meanwhile out of pyplot: they go into files and are let go.

    Examples
    --------
    >>> with unseen():
    ...     are_unseen()
    True
    """
    token = _UNSEEN.set(True)
    try:
        yield
    finally:
        _UNSEEN.reset(token)


def are_unseen() -> bool:
    """Whether figures are made for files only."""
    return _UNSEEN.get()


class FleetViews:
    """What a run over a fleet shows of itself."""

    def plot(self, **options: Any) -> Any:
        """Draw how the coefficients are distributed: `tridentify.plots.plot_fleet`."""
        return room("plots").plot_fleet(self, **options)

    def report(self, path: str | os.PathLike[str], **options: Any) -> Path:
        """Write the page: `tridentify.report.write_fleet_report`.

        Parameters
        ----------
        path : path-like
            The HTML file.
        **options
            ``title``, ``reports`` (units unlike the others that get a report of their own),
            ``figures``.

        Returns
        -------
        Path
        """
        written: Path = room("report").write_fleet_report(self, path, **options)
        return written


def pandas_frame(columns: Mapping[str, Sequence[Any] | Array], index: Sequence[str] = ()) -> Any:
    """A table as a pandas data frame; by default its rows are numbered.

    Raises
    ------
    MissingDependencyError
        pandas is not installed.
    """
    try:
        import pandas
    except ImportError as error:
        raise MissingDependencyError(
            "found no pandas; expected it for a data frame; pip install pandas"
        ) from error
    return pandas.DataFrame(dict(columns), index=list(index) or None)


class ModelViews:
    """Pictures of a transfer function or an estimate, one method each.

    Every method takes the options of the function of `tridentify.plots` that it names, ``axes=``
    among them, and gives back what that gives.
    """

    def bode(self, omega: Any = None, **options: Any) -> Any:
        """Draw magnitude and phase: `tridentify.plots.plot_bode`.

        Examples
        --------
        >>> from tridentify import TransferFunction
        >>> len(TransferFunction([1.0], [1.0, 1.0]).bode())
        2
        """
        return room("plots").plot_bode(self, omega, **options)

    def nyquist(self, omega: Any = None, **options: Any) -> Any:
        """Draw the response in the complex plane: `tridentify.plots.plot_nyquist`."""
        return room("plots").plot_nyquist(self, omega, **options)

    def step(self, t: Any = None, **options: Any) -> Any:
        """Draw the response to a unit step: `tridentify.plots.plot_step`."""
        return room("plots").plot_step(self, t, **options)

    def impulse(self, t: Any = None, **options: Any) -> Any:
        """Draw the response to a unit impulse: `tridentify.plots.plot_impulse`."""
        return room("plots").plot_impulse(self, t, **options)

    def pole_zero(self, **options: Any) -> Any:
        """Draw poles and zeros: `tridentify.plots.plot_pole_zero`."""
        return room("plots").plot_pole_zero(self, **options)


class RecordViews:
    """What a record shows by itself."""

    def explore(self, **options: Any) -> Any:
        """Open the record in the workbench, in the browser: `tridentify.app.notebook.explore`.

        Parameters
        ----------
        **options
            ``folder``: where record and session are kept; ``open_page``: whether a browser is
            opened.

        Returns
        -------
        tridentify.app.notebook.Workbench
            With ``address`` and ``stop()``.

        Raises
        ------
        MissingDependencyError
            The extra ``app`` is not installed.
        """
        return room("app.notebook").explore(self, **options)


class EstimateViews(ModelViews, Pointers):
    """What an estimate shows beside its model's pictures."""

    _elsewhere = OF_AN_ESTIMATE

    def plot(self, record: Any, **options: Any) -> Any:
        """Draw record and model response: `tridentify.plots.plot_fit`."""
        return room("plots").plot_fit(self, record, **options)

    def report(self, path: str | os.PathLike[str], record: Any = None, **options: Any) -> Path:
        """Write the report as one page: `tridentify.report.write_report`.

        Parameters
        ----------
        path : path-like
            The HTML file.
        record : Record or sequence of Record, optional
            What was identified. An estimate holds no data: without it the page has neither the
            measured response nor tests of the residual.
        **options
            ``title``, ``figures``, ``progress``.

        Returns
        -------
        Path

        Raises
        ------
        OptionError
            ``path`` is no name of a file.
        OutputPathError
            The file cannot be written; nothing is left behind.
        """
        if not isinstance(path, str | os.PathLike) and isinstance(record, str | os.PathLike):
            path, record = record, path
        if not isinstance(path, str | os.PathLike):
            raise OptionError(
                f"found {type(path).__name__} in place of the file; expected the name of the page, "
                'then what was identified; write estimate.report("page.html", record)'
            )
        records = () if record is None else record
        written: Path = room("report").write_report(self, records, path, **options)
        return written

    def to_control(self: Any) -> Any:
        """Convert the model for python-control: `TransferFunction.to_control`."""
        return self.model.to_control()

    def to_scipy(self: Any) -> Any:
        """Convert the model for SciPy: `TransferFunction.to_scipy`."""
        return self.model.to_scipy()

    def to_frame(self: Any, level: float = 0.95) -> Any:
        """Coefficients as a pandas data frame, one a row.

        Parameters
        ----------
        level : float
            Probability that an interval holds.

        Returns
        -------
        pandas.DataFrame
            Index: names; columns ``value``, ``std``, ``relative`` (``std`` over ``value`` [-]),
            ``low``, ``high`` (the interval) and ``unit``.

        Raises
        ------
        MissingDependencyError
            pandas is not installed.
        """
        rows = list(self.parameters.values())
        ends = [row.interval(level) for row in rows]
        columns = {
            "value": [row.value for row in rows],
            "std": [row.std for row in rows],
            "relative": [row.relative_std for row in rows],
            "low": [low for low, _ in ends],
            "high": [high for _, high in ends],
            "unit": [row.unit for row in rows],
        }
        return pandas_frame(columns, [row.name for row in rows])
