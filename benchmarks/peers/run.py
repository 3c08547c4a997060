"""Against the packages that people would pick: accuracy, failures, time, memory.

Makes the record files, an environment for each package, sends the same files through every way of
estimating that a package has, and prints the table. ``--save`` stores it under
``benchmarks/results`` and in ``README.md`` here; rows that were not measured are kept.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

from cases import all_cases, write
from peer import HERE, PEERS, NotInstalledError, Peer, command, run
from table import describe, summarise, text

sys.path.append(str(HERE.parent))
RESULTS = HERE.parent / "results"
MARKS = ("<!-- peers -->", "<!-- end peers -->")


def starts(peers: list[Peer]) -> dict[str, list[str] | str]:
    """Peer -> how it is started, or why it cannot be."""
    found: dict[str, list[str] | str] = {}
    for peer in peers:
        try:
            found[peer.name] = command(peer)
        except NotInstalledError as error:
            found[peer.name] = str(error)
    return found


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """The rows that were asked for, telling on the standard error how far it is."""
    peers = [peer for peer in PEERS if not options.peers or peer.name in options.peers]
    ready = starts(peers)
    data: dict[str, Any] = {"cases": {}, "rows": {}}
    for case in all_cases():
        if options.cases and case.name not in options.cases:
            continue
        data["cases"][case.name] = describe(case)
        rows: dict[str, Any] = {peer.name: {} for peer in peers}
        data["rows"][case.name] = rows
        with tempfile.TemporaryDirectory() as folder:
            most = max(max(peer.ways.values()) for peer in peers)
            files = write(case, min(options.draws, most), Path(folder))
            for peer in peers:
                start = ready[peer.name]
                if isinstance(start, str):
                    rows[peer.name]["all"] = {"missing": start}
                    continue
                for way, draws in peer.ways.items():
                    print(f"{case.name}: {peer.name}: {way}", file=sys.stderr, flush=True)
                    batch = run(start, way, case.poles, case.zeros, files[:draws], options.limit)
                    rows[peer.name][way] = summarise(case, batch)
        if options.save:
            store(data)
    return data


def merged(old: dict[str, Any], new: dict[str, Any]) -> dict[str, Any]:
    """The rows of both, in the order of the table; new ones in the place of old ones."""
    data: dict[str, Any] = {"cases": {}, "rows": {}}
    for case in all_cases():
        found = {**old["cases"], **new["cases"]}.get(case.name)
        if found is None:
            continue
        data["cases"][case.name] = found
        rows = old["rows"].get(case.name, {}) | new["rows"].get(case.name, {})
        data["rows"][case.name] = {p.name: rows[p.name] for p in PEERS if p.name in rows}
    return data


def store(data: dict[str, Any]) -> None:
    """Results as text and JSON, and the text in ``README.md``; rows not measured now are kept."""
    from machine import describe as machine

    RESULTS.mkdir(exist_ok=True)
    earlier = RESULTS / "peers.json"
    if earlier.exists():
        data = merged(json.loads(earlier.read_text())["data"], data)
    report = text(data)
    (RESULTS / "peers.txt").write_text(report + "\n")
    earlier.write_text(json.dumps({"machine": machine(), "data": data}, indent=1) + "\n")
    readme = HERE / "README.md"
    before, _, rest = readme.read_text().partition(MARKS[0])
    after = rest.partition(MARKS[1])[2]
    readme.write_text(f"{before}{MARKS[0]}\n```text\n{report}\n```\n{MARKS[1]}{after}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--save", action="store_true", help="store the table")
    parser.add_argument("--draws", type=int, default=1000, help="most noise draws")
    parser.add_argument("--limit", type=int, default=120, help="processor seconds for a row")
    parser.add_argument("--peers", nargs="+", choices=[peer.name for peer in PEERS])
    parser.add_argument("--cases", nargs="+", choices=[case.name for case in all_cases()])
    options = parser.parse_args()
    print(text(measure(options)))


if __name__ == "__main__":
    main()
