"""What holds for every format: numbers come back, and a damaged file ends in one clear error."""

from __future__ import annotations

import os
import random
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tridentify import errors, list_channels, read_record
from tridentify.record.formats.apart import isolation
from tridentify.record.formats.read import FORMATS
from tridentify.record.record import Record

pytestmark = pytest.mark.unisolated

EXTRA = {"h5py": "matlab", "pyulog": "ulog", "asammdf": "mdf", "openpyxl": "excel"}


def test_the_record_comes_back(sample) -> None:
    record = read_record(sample.path, **sample.asked)
    np.testing.assert_array_equal(record.u[:, 0], sample.u)
    np.testing.assert_array_equal(record.y[:, 0], sample.y)
    np.testing.assert_allclose(record.t, sample.t, atol=1e-12)
    assert record.dt == pytest.approx(0.02)


@pytest.mark.fast("run.csv", "run.ulg", "run.npz", "*.mat")
def test_a_reference_is_read_like_an_input(sample) -> None:
    if sample.path.suffix == ".mat":
        pytest.skip("iddata has no place for a reference; variables do, see test_matlab.py")
    prefix = sample.asked["inputs"][0].removesuffix("u")
    asked = {**sample.asked, "references": [f"{prefix}r"]}
    record = read_record(sample.path, **asked, start=0.04, stop=0.1)
    assert [name.rpartition(".")[2] for name in record.reference_names] == ["r"]
    assert record.units.get("r") == record.units.get("y")
    np.testing.assert_array_equal(record.reference[:, 0], sample.r[2:6])
    np.testing.assert_array_equal(record.u[:, 0], sample.u[2:6])
    with pytest.raises(errors.MissingColumnError, match="found no column 'setpoint'"):
        read_record(sample.path, **{**asked, "references": ["setpoint"]})
    with pytest.raises(errors.ChannelNameError, match="inputs, outputs and references; drop one"):
        read_record(sample.path, **{**asked, "references": sample.asked["outputs"]})


@pytest.mark.fast("run.csv", "seven.mat", "run.npz", "run.xlsx")
def test_a_stretch_and_a_stated_step(sample) -> None:
    record = read_record(sample.path, **sample.asked, start=0.04, stop=0.1, dt=0.02)
    assert (record.n_samples, record.dt) == (4, 0.02)
    with pytest.raises(errors.NonUniformTimeError, match=r"expected 0\.03 s"):
        read_record(sample.path, **sample.asked, dt=0.03)


@pytest.mark.fast("run.csv", "run.npz", "five.mat")
def test_a_name_that_is_not_there_lists_those_that_are(sample) -> None:
    names = [channel.header for channel in list_channels(sample.path)]
    wrong = {**sample.asked, "outputs": ["no such channel"]}
    with pytest.raises(errors.MissingColumnError, match="expected one of ") as caught:
        read_record(sample.path, **wrong)
    assert all(name in str(caught.value) for name in names)


def test_an_empty_file_and_another_format_are_refused(sample, tmp_path: Path) -> None:
    path = tmp_path / sample.path.name
    path.write_bytes(b"")
    with pytest.raises(errors.EmptyFileError, match="found nothing"):
        read_record(path, **sample.asked)
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(64))
    with pytest.raises(errors.UnreadableFileError):
        read_record(path, **sample.asked)


@pytest.mark.fast("run.npz", "run.ulg", "five.mat", "run.csv")
def test_the_first_half_of_a_file_is_refused_or_read(sample, tmp_path: Path) -> None:
    content = sample.path.read_bytes()
    path = tmp_path / sample.path.name
    path.write_bytes(content[: len(content) // 2])
    assert_refused_or_read(path, sample.asked)


def test_a_missing_package_is_named_with_its_extra(sample, monkeypatch) -> None:
    if not sample.needs:
        pytest.skip("needs no optional package")
    monkeypatch.setitem(sys.modules, sample.needs, None)
    expected = rf"no module '{sample.needs}'.*pip install 'tridentify\[{EXTRA[sample.needs]}\]'"
    for verb in (
        lambda: read_record(sample.path, **sample.asked),
        lambda: list_channels(sample.path),
    ):
        with pytest.raises(errors.MissingDependencyError, match=expected) as caught:
            verb()
        assert "\n" not in str(caught.value)


def test_every_extra_that_a_reader_names_is_declared(repository: Path) -> None:
    import tomllib

    project = tomllib.loads((repository / "pyproject.toml").read_text())["project"]
    declared = project["optional-dependencies"]
    for known in FORMATS:
        if known.extra:
            assert any(entry.startswith(known.needs) for entry in declared[known.extra])


@pytest.mark.slow
def test_nothing_is_printed(sample) -> None:
    program = (
        f"from tridentify import read_record; read_record({str(sample.path)!r}, **{sample.asked!r})"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, check=True)
    assert (done.stdout, done.stderr) == (b"", b"")


# ---------------------------------------------------------------------------------------- damage
def outcome(path: Path, asked: dict[str, object]) -> Record | str:
    """The record, or the message of the refusal; whatever else is raised fails the test."""
    try:
        return read_record(path, **asked)
    except errors.TridentifyError as error:
        return str(error)


def assert_refused_or_read(path: Path, asked: dict[str, object]) -> None:
    found = outcome(path, asked)
    if isinstance(found, str):
        assert "\n" not in found
        assert len(found) < 600


def damaged(content: bytes, seed: int) -> bytes:
    """Cut the content, or change some of its bytes."""
    chance = random.Random(seed)
    spoiled = bytearray(content)
    if chance.random() < 0.25:
        return bytes(spoiled[: chance.randrange(len(spoiled))])
    for _ in range(chance.choice((1, 1, 2, 8, 32))):
        spoiled[chance.randrange(len(spoiled))] = chance.choice((0, 255, chance.randrange(256)))
    return bytes(spoiled)


def check_damage(sample, seed: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, sample.path.name)
        path.write_bytes(damaged(sample.path.read_bytes(), seed))
        assert_refused_or_read(path, sample.asked)


FIXTURE_IS_CONSTANT = [HealthCheck.function_scoped_fixture]


@pytest.mark.timeout(120)
@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in (1, 2))])
@pytest.mark.fast("run.npz-0", "run.ulg-0", "run.csv-0", "seven.mat-0")
def test_damage_is_refused_or_read(sample, seed: int) -> None:
    if sample.needs == "asammdf":
        pytest.skip("asammdf takes seconds to start; the slow test below damages MDF4 files")
    check_damage(sample, seed)


@pytest.mark.slow
@pytest.mark.isolated
@pytest.mark.timeout(1200)
@settings(max_examples=200, suppress_health_check=FIXTURE_IS_CONSTANT)
@given(seed=st.integers(0, 2**32))
def test_much_damage_is_refused_or_read(sample, seed: int) -> None:
    check_damage(sample, seed)


# ------------------------------------------------------------------------------------- isolation
READER = """
import ctypes, os, sys, tempfile, time
from pathlib import Path
import numpy as np
from tridentify.record.formats.channels import Channel

class File:
    channels = (Channel("u", "u", samples=3), Channel("y", "y", samples=3))
    def read(self, indices):
        deed = {deed!r}
        Path(tempfile.gettempdir(), "left behind").touch()
        if deed == "crash":
            ctypes.string_at(0)
        if deed == "exit":
            os._exit(0)
        if deed == "hang":
            time.sleep(1000)
        if deed == "grow":
            return [np.ones(2**40)]
        if deed == "import":
            import no_such_module
        if deed == "raise":
            raise KeyError("two\\nlines")
        if deed == "print":
            print("to stdout", flush=True)
            os.write(1, b"to stdout")
            os.write(2, b"to stderr")
        return [np.arange(3.0)] * len(indices)
    def instants(self, clock):
        return None

def open_file(path):
    return File()
"""


@pytest.fixture
def misbehave(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Read through a reader that does one deed, with a folder of its own for temporary files."""
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))

    def run(deed: str):
        (tmp_path / f"reader_{deed}.py").write_text(READER.format(deed=deed))
        monkeypatch.syspath_prepend(str(tmp_path))
        path = tmp_path / "some.bin"
        path.write_bytes(b"x")
        with isolation.IsolatedFile(path, f"reader_{deed}", "made-up") as source:
            return source.read([0, 1])

    return run


@pytest.mark.parametrize(
    ("deed", "error", "words"),
    [
        ("crash", errors.UnreadableFileError, "makes its reader fail"),
        ("exit", errors.UnreadableFileError, "makes its reader fail"),
        ("hang", errors.UnreadableFileError, "not read within 1 s"),
        ("grow", errors.FileTooLargeError, "at most .* GiB"),
        ("import", errors.MissingDependencyError, "no_such_module.*install them anew"),
        ("raise", errors.UnreadableFileError, "damaged content"),
    ],
)
@pytest.mark.isolated
@pytest.mark.fast("raise-UnreadableFileError-damaged content")
def test_a_reader_that_fails_is_one_clear_error(
    misbehave, monkeypatch: pytest.MonkeyPatch, deed: str, error: type[Exception], words: str
) -> None:
    monkeypatch.setattr(isolation, "PATIENCE", 1.0 if deed == "hang" else 30.0)
    with pytest.raises(error, match=words) as caught:
        misbehave(deed)
    assert type(caught.value) is error
    assert "\n" not in str(caught.value)
    assert not list(Path(tempfile.gettempdir()).iterdir())


@pytest.mark.isolated
def test_what_a_reader_prints_goes_nowhere(misbehave, capfd: pytest.CaptureFixture[str]) -> None:
    assert [list(values) for values in misbehave("print")] == [[0, 1, 2], [0, 1, 2]]
    assert capfd.readouterr() == ("", "")


@pytest.mark.fast("run.npz", "run.ulg")
@pytest.mark.isolated
def test_the_child_ends_with_the_reading(sample) -> None:
    if sample.path.suffix == ".csv":
        pytest.skip("text is read in this process")
    known = next(f for f in FORMATS if sample.path.suffix in f.suffixes)
    if sample.path.name == "seven.mat":
        known = next(f for f in FORMATS if f.name == "MATLAB 7.3")
    with isolation.IsolatedFile(
        sample.path, f"tridentify.record.formats.{known.module}", known.name
    ) as source:
        process, folder = source._process, Path(source._process.folder.name)
        assert process.poll() is None
        assert folder.is_dir()
    assert process.poll() is not None
    assert not folder.exists()


# -------------------------------------------------------------------------------- special paths
@pytest.mark.isolated
def test_pipes_devices_and_directories_are_refused_at_once(tmp_path: Path) -> None:
    for name in ("pipe.ulg", "pipe.mat", "pipe.parquet"):
        if hasattr(os, "mkfifo"):
            os.mkfifo(tmp_path / name)
            with pytest.raises(errors.UnreadableFileError, match="no regular file"):
                list_channels(tmp_path / name)
    if Path("/dev/zero").exists():
        with pytest.raises(errors.UnreadableFileError, match="no regular file"):
            list_channels("/dev/zero")
    (tmp_path / "folder.mf4").mkdir()
    with pytest.raises(errors.UnreadableFileError, match="a directory"):
        list_channels(tmp_path / "folder.mf4")
    with pytest.raises(errors.UnreadableFileError, match="no such file"):
        list_channels(tmp_path / "absent.mf4")


@pytest.mark.parametrize("suffix", [".parquet", ".npz", ".mat", ".ulg", ".mf4", ".feather"])
@pytest.mark.isolated
def test_text_under_the_suffix_of_another_format_is_refused(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"run{suffix}"
    path.write_text("t,u,y\n0,1,2\n1,1,2\n")
    with pytest.raises(errors.UnreadableFileError, match=r"found no mark of .* at the start"):
        read_record(path, time="t", inputs=["u"], outputs=["y"])
