"""Records from files: the table of formats, and the two verbs on a file.

To add a format, write one module with a function ``open_file(path)`` that gives an `OpenFile`, and
add one row to `FORMATS`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from tridentify.errors import OptionError, UnreadableFileError, shown
from tridentify.record.checks.samples import Intersample
from tridentify.record.formats.apart.isolated import open_here
from tridentify.record.formats.apart.isolation import IsolatedFile
from tridentify.record.formats.assemble import Instants, Wanted, record_from
from tridentify.record.formats.channels import Channel, OpenFile
from tridentify.record.formats.contents import Contents, as_file, called
from tridentify.record.formats.requirements import require
from tridentify.record.formats.text.csv import TextFile
from tridentify.record.formats.text.text_opening import check_readable
from tridentify.record.record import Record
from tridentify.writing.layout import printable


@dataclass(frozen=True)
class Format:
    """A binary format: how to know it, and who reads it.

    Attributes
    ----------
    name : str
    suffixes : tuple of str
    marks : tuple of (int, bytes)
        Bytes that a file begins with, at an offset; one of them must be there.
    members : tuple of bytes
        For a ZIP archive: beginnings of the name of its first file, one of which must be there.
    module : str
        The reader, in `tridentify.record.formats`.
    needs, extra : str
        Module that must be installed, and the extra of this package that brings it.
    """

    name: str
    suffixes: tuple[str, ...]
    marks: tuple[tuple[int, bytes], ...]
    module: str
    needs: str = ""
    extra: str = ""
    members: tuple[bytes, ...] = ()


FORMATS = (
    Format("Parquet", (".parquet", ".pq"), ((0, b"PAR1"),), "arrow"),
    Format("Feather", (".feather", ".arrow", ".ipc"), ((0, b"ARROW1"),), "arrow"),
    Format(
        "Excel",
        (".xlsx", ".xlsm"),
        ((0, b"PK\x03\x04"),),
        "excel",
        "openpyxl",
        "excel",
        (b"[Content_Types].xml", b"_rels/", b"docProps/", b"xl/", b"customXml/"),
    ),
    Format("NPY", (".npy",), ((0, b"\x93NUMPY"),), "npy"),
    Format("NPZ", (".npz",), ((0, b"PK\x03\x04"), (0, b"PK\x05\x06")), "npz"),
    Format("MATLAB 5", (".mat",), ((0, b"MATLAB 5.0"),), "matlab.matlab"),
    Format(
        "MATLAB 7.3",
        (".mat",),
        ((0, b"MATLAB 7.3"), (0, b"\x89HDF\r\n\x1a\n")),
        "matlab.matlab_hdf5",
        "h5py",
        "matlab",
    ),
    Format("ULog", (".ulg", ".ulog"), ((0, b"ULog\x01\x12\x35"),), "ulog", "pyulog", "ulog"),
    Format(
        "MDF4",
        (".mf4", ".mdf", ".dat"),
        ((0, b"MDF     "), (0, b"UnFinMF ")),
        "mdf",
        "asammdf",
        "mdf",
    ),
)
"""The formats beside delimited text, which is what everything else is taken for."""

MEMBER_NAME = 30
"""Where the name of the first file of a ZIP archive begins."""

TEXT_SUFFIXES = (".dat",)
"""Suffixes of a binary format that text goes by as well."""


def read_record(
    path: Contents,
    *,
    time: str | None = None,
    dt: float | None = None,
    inputs: Sequence[str],
    outputs: Sequence[str],
    references: Sequence[str] = (),
    intersample: Intersample = "auto",
    reference_intersample: Intersample | None = None,
    units: Mapping[str, str] | None = None,
    start: float | None = None,
    stop: float | None = None,
    instants: Instants = "auto",
) -> Record:
    r"""Read one experiment from a file.

    Parameters
    ----------
    path : path-like, bytes, or file open for reading
        Delimited text (CSV, TSV), Excel (``.xlsx``), Parquet, Feather, NPY, NPZ, MATLAB (``.mat``,
        version 5 or 7.3), ULog or MDF4, recognised by its content. Excel, MATLAB 7.3, ULog and MDF4
        need the extras ``excel``, ``matlab``, ``ulog`` and ``mdf`` of this package. A file in
        memory (``io.BytesIO``) or an upload is read from where it stands.
    time : str, optional
        Name of the channel of time. Its unit is seconds unless the file or `units` say otherwise;
        dates (``2026-11-22T10:30:00.25``) and times of day (``10:30:00.25``) count from the first.
        Without it and without `dt`, the channel that is called ``t`` or ``time``, in any case and
        with or without a unit in brackets, is taken if there is exactly one; else one of dates
        that is called ``timestamp``, ``datetime`` or ``date``.
        Not needed where the format has a time of its own: ULog, MDF4, and in MATLAB files
        timeseries, ``iddata`` and Simulink's structures with time.
    dt : float, optional
        Uniform sampling interval [s]. Together with a recorded time it replaces the recorded steps,
        which must then agree with it to 5 percent; without, time begins at zero.
    inputs, outputs : sequence of str
        Names of the channels, as `list_channels` gives them; the unit in brackets may be left out.
    references : sequence of str, optional
        Names of the channels that drove a loop from outside, as in `Record`; read like inputs.
    intersample : {"auto", "zoh", "foh", "band-limited"}
        What the input does between samples, as in `Record`; with "auto" `identify` takes what
        explains the record best, and says so.
    reference_intersample : {"zoh", "foh", "band-limited", "auto"}, optional
        What the references do; by default as in `Record`, with "auto" by their samples.
    units : mapping of str to str, optional
        Units by channel name, before those of the file.
    start, stop : float, optional
        Keep the samples from `start` to `stop` [s], both ends included.
    instants : {"auto", "outputs", "all"}
        Where the record has samples when the channels were sampled at different times: at the
        instants of the outputs; at those of inputs and outputs; or at all of them if they lie on
        one uniform raster, else at those of the outputs. Outputs are nan where they were not
        sampled, inputs follow from `intersample`, and references count with the inputs.

    Returns
    -------
    Record
        Named after the file (what cannot be printed is escaped); only the channels that are asked
        for are read. Their samples may take an eighth of the machine's memory.

    Raises
    ------
    UnreadableFileError, EmptyFileError, MissingHeaderError, RaggedRowError, FileTooLargeError
        The file cannot be read, is damaged, no table with a header, or larger than memory.
    MissingColumnError, DuplicateColumnError, TextInColumnError, ForeignObjectError
        A channel does not exist, occurs twice, or holds text or objects.
    SamplingError, NonUniformTimeError, TimeNotIncreasingError, EmptyRangeError
        Time is not stated, does not agree with `dt`, runs backwards, or has no samples in range.
    MissingDependencyError
        The package that reads this format is not installed; the message names the extra.
    SampleTypeError
        `path` is neither a path nor bytes nor an open file.
    DataError
        Whatever else `Record` refuses.

    Warns
    -----
    DataWarning
        Lines above the header are taken for a title and passed over, lines of text below the last
        row are left out, words of errors are taken for missing samples, numbers for days, or dates
        for one of two readings.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> from tridentify import read_record
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder, "doublet.csv")
    ...     _ = path.write_text("t,elevator [rad],q\n0,0,0\n0.5,1,0\n1,1,0.2\n")
    ...     read_record(path, time="t", inputs=["elevator"], outputs=["q"])
    Record('doublet', 3 samples, 1 s, dt=0.5 s, auto, inputs: elevator [rad], outputs: q)
    """
    wanted = Wanted(
        inputs, outputs, time, dt, intersample, units, start, stop, instants, references,
        reference_intersample,
    )  # fmt: skip
    return _read(path, wanted)


def read_records(
    paths: Sequence[Contents],
    *,
    time: str | None = None,
    dt: float | None = None,
    inputs: Sequence[str],
    outputs: Sequence[str],
    references: Sequence[str] = (),
    intersample: Intersample = "auto",
    reference_intersample: Intersample | None = None,
    units: Mapping[str, str] | None = None,
    start: float | None = None,
    stop: float | None = None,
    instants: Instants = "auto",
) -> tuple[Record, ...]:
    r"""Read several experiments with the same channels, a file each, as `identify` takes them.

    Parameters
    ----------
    paths : sequence of path-like, bytes, or files open for reading
        As for `read_record`, one at least.
    time, dt, inputs, outputs, references, intersample, reference_intersample, units, start, stop
        As for `read_record`; the same for all files.
    instants : {"auto", "outputs", "all"}
        Likewise.

    Returns
    -------
    tuple of Record
        In the order of `paths`.

    Raises
    ------
    OptionError
        `paths` is a single file, or there is none.
    DataError
        As `read_record`.

    Examples
    --------
    >>> flights = [b"t,u,y\n0,0,0\n1,1,0\n", b"t,u,y\n0,1,0\n1,1,2\n2,0,3\n"]
    >>> [record.n_samples for record in read_records(flights, inputs=["u"], outputs=["y"])]
    [2, 3]
    """
    several = isinstance(paths, Sequence) and not isinstance(paths, str | bytes | bytearray)
    if not several or not paths:
        raise OptionError(
            f"found {'no file' if several else shown(paths, 80)}; expected a list of files, one "
            "for each experiment; put them into a list, or read one file with read_record"
        )
    wanted = Wanted(
        inputs, outputs, time, dt, intersample, units, start, stop, instants, references,
        reference_intersample,
    )  # fmt: skip
    return tuple(_read(path, wanted) for path in paths)


def _read(path: Contents, wanted: Wanted) -> Record:
    with opened(path) as source:
        return record_from(source, wanted, printable(Path(called(path)).stem))


def list_channels(path: Contents) -> tuple[Channel, ...]:
    r"""List the channels of a file, with units, number of samples and clock where it tells them.

    Parameters
    ----------
    path : path-like, bytes, or file open for reading
        As for `read_record`.

    Returns
    -------
    tuple of Channel

    Raises
    ------
    UnreadableFileError, EmptyFileError, MissingHeaderError, MissingDependencyError
        As for `read_record`.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder, "doublet.csv")
    ...     _ = path.write_text("t,elevator [rad]\n0,0\n1,1\n")
    ...     [(channel.name, channel.unit) for channel in list_channels(path)]
    [('t', ''), ('elevator', 'rad')]
    """
    with opened(path) as source:
        return source.channels


@contextmanager
def opened(path: Contents, *, isolated: bool = True) -> Iterator[OpenFile]:
    """Open a file with the reader that its content asks for.

    Parameters
    ----------
    path : path-like, bytes, or file open for reading
    isolated : bool
        Whether a binary file is decoded in a process of its own. False is for a process that may
        itself crash, hang or grow without harm.

    Raises
    ------
    UnreadableFileError, EmptyFileError, MissingHeaderError, MissingDependencyError, SampleTypeError
    """
    with as_file(path) as file:
        start = check_readable(file)
        known = next((f for f in FORMATS if _marked(start, f)), None)
        if known is None:
            _refuse_suffix(file)
            yield TextFile(file)
            return
        if known.needs:
            require(known.needs, f"tridentify[{known.extra}]", f"a {known.name} file")
        module = f"tridentify.record.formats.{known.module}"
        if not isolated:
            yield open_here(module, file)
            return
        with IsolatedFile(file, module, known.name) as source:
            yield source


def _marked(start: bytes, known: Format) -> bool:
    marked = any(start[at:].startswith(mark) for at, mark in known.marks)
    return marked and (not known.members or start[MEMBER_NAME:].startswith(known.members))


def _refuse_suffix(file: Path) -> None:
    suffix = file.suffix.lower()
    named = [f.name for f in FORMATS if suffix in f.suffixes and suffix not in TEXT_SUFFIXES]
    if named and file.stat().st_size:
        raise UnreadableFileError(
            f"found no mark of {' or '.join(named)} at the start of {shown(file.name)}; expected "
            "what the suffix says; the file may be damaged or of another version: write it anew"
        )
