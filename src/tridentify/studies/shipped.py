"""Files of studies that come with the package."""

from __future__ import annotations

from pathlib import Path

from tridentify.errors import OptionError, shown

FOLDER = Path(__file__).parent / "files"
SHIPPED = tuple(sorted(path.stem for path in FOLDER.glob("*.toml")))
"""Their names."""


def shipped_study(name: str) -> Path:
    """The file of a study that comes with the package.

    Parameters
    ----------
    name : str
        One of `SHIPPED`, with or without its ending.

    Returns
    -------
    Path
        To run, or to copy and change.

    Raises
    ------
    OptionError
        There is none of that name.

    Examples
    --------
    >>> shipped_study("aircraft").name
    'aircraft.toml'
    """
    stem = name.removesuffix(".toml")
    if stem not in SHIPPED:
        raise OptionError(
            f"found no study {shown(name)} in the package; expected one of: {', '.join(SHIPPED)}; "
            "choose one, or give the path of a file"
        )
    return FOLDER / f"{stem}.toml"
