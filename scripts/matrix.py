#!/usr/bin/env python3
"""Map random shapes in random ways, and count by kind of shape what came of it; the runs are those of tests/matrix.

usage: matrix.py [--runs 2000] [--first 0] [--processes 1] [--output FILE] [--seconds 600] [--only NUMBER ...]
       matrix.py --table FILE ...
A run is known by its number: --only 17 does that one alone and says all of it. With --output, a line of JSON for each run is
added to a file, and runs that the file holds already are not done again. At the end a table in Markdown is printed, and the
runs with faults. Exit status 1 where there is a fault.
"""

from __future__ import annotations

import argparse
import json
import os
import selectors
import subprocess
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
FAULT, SLOW_S = "FAULT", 10.0
COLUMNS = ("right", "right, another map", "marked folded", "refused", "failed", FAULT)


class Worker:
    """A process that does one run at a time, and is started anew after one that it did not survive."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None
        self._number = -1
        self._told: dict[str, Any] | None = None
        self._since = 0.0

    def begin(self, number: int) -> None:
        """Start a run."""
        if self._process is None:
            path = os.pathsep.join(map(str, (ROOT, ROOT / "tests", ROOT / "tests" / "matrix")))
            command = [sys.executable, str(ROOT / "tests" / "matrix" / "runs.py")]
            pipe = subprocess.PIPE
            self._process = subprocess.Popen(
                command, stdin=pipe, stdout=pipe, stderr=pipe, text=True, env=os.environ | {"PYTHONPATH": path}
            )
        self._told, self._since = None, time.monotonic()
        self._number = number
        assert self._process.stdin is not None
        self._process.stdin.write(f"{number}\n")
        self._process.stdin.flush()

    def result(self, most_s: float) -> dict[str, Any] | None:
        """What came of the run, None while it lasts."""
        assert self._process is not None
        assert self._process.stdout is not None
        with selectors.DefaultSelector() as selector:
            selector.register(self._process.stdout, selectors.EVENT_READ)
            ready = selector.select(timeout=0.2)
        seconds = round(time.monotonic() - self._since, 2)
        if ready:
            line = self._process.stdout.readline()
            if line and self._told is None:
                self._told = json.loads(line)
                return None
            if line:
                return json.loads(line)
            self._process.wait()
            assert self._process.stderr is not None
            why, said = f"the process ended with {self._process.returncode}", self._process.stderr.read()[-2000:]
        elif seconds > most_s:
            why, said = f"no end after {most_s:.0f} s", ""
        else:
            return None
        self.end()
        told = self._told or {"run": self._number, "kind": "?"}
        return {**told, "outcome": FAULT, "faults": [why], "said": said, "seconds": seconds}

    def end(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
        self._process = None


def done_by(numbers: Sequence[int], processes: int, most_s: float = 600.0) -> Iterator[dict[str, Any]]:
    """What came of runs, as they end."""
    waiting, idle, busy = list(reversed(numbers)), [Worker() for _ in range(processes)], []
    try:
        while waiting or busy:
            while waiting and idle:
                busy.append(idle.pop())
                busy[-1].begin(waiting.pop())
            for worker in list(busy):
                if (found := worker.result(most_s)) is not None:
                    busy.remove(worker)
                    idle.append(worker)
                    yield found
    finally:
        for worker in (*idle, *busy):
            worker.end()


def table(rows: list[dict[str, Any]]) -> str:
    """Outcomes by kind, in Markdown."""
    count: dict[str, Counter[str]] = defaultdict(Counter)
    slow: Counter[str] = Counter()
    for row in rows:
        for kind in (row["kind"], "all"):
            count[kind][row["outcome"]] += 1
            slow[kind] += row["seconds"] > SLOW_S
    kinds = [*sorted(set(count) - {"all"}), "all"]
    lines = [f"| kind | runs | {' | '.join(COLUMNS)} | over {SLOW_S:.0f} s |", f"| --- |{' ---: |' * (len(COLUMNS) + 2)}"]
    for kind in kinds:
        numbers = [sum(count[kind].values()), *(count[kind][column] for column in COLUMNS), slow[kind]]
        lines.append(f"| {kind} | {' | '.join(map(str, numbers))} |")
    return "\n".join(lines)


def read_rows(path: Path) -> list[dict[str, Any]]:
    """Runs that a file holds; the last line of each number."""
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    return list({row["run"]: row for row in map(json.loads, lines)}.values())


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=2000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--output", type=Path)
    parser.add_argument("--seconds", type=float, default=600.0, help="a run that lasts longer is ended, and is a fault")
    parser.add_argument("--only", type=int, nargs="+", metavar="NUMBER")
    parser.add_argument("--table", type=Path, nargs="+", metavar="FILE")
    arguments = parser.parse_args(words)
    rows = [row for path in arguments.table or () for row in read_rows(path)]
    if not arguments.table:
        known = {row["run"]: row for row in read_rows(arguments.output)} if arguments.output else {}
        numbers = arguments.only or range(arguments.first, arguments.first + arguments.runs)
        rows = [known[number] for number in numbers if number in known]
        for row in done_by([n for n in numbers if n not in known], arguments.processes, arguments.seconds):
            rows.append(row)
            if arguments.only:
                print(json.dumps(row, indent=1), flush=True)
            if arguments.output:
                with arguments.output.open("a", encoding="utf-8") as stream:
                    stream.write(json.dumps(row) + "\n")
    print(table(rows))
    faults = [row for row in rows if row["outcome"] == FAULT]
    for row in faults:
        print(f"run {row['run']}: {row['kind']}, {'; '.join(row['faults'])} [{row.get('words', '')}] {row['said'].strip()}")
    return int(bool(faults))


if __name__ == "__main__":
    sys.exit(main())
