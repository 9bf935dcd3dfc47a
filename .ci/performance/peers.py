"""The same work by us and by others, in turn, on one machine: a table of ratios in Markdown.

    peers.py PROGRAM KERNEL WORK ROUNDS

PROGRAM: drivebench; KERNEL: the benchmark `kernel`, which does one hot path a given number of times; WORK: a folder with the
compiled C peers. What is not installed is left out, and said.
"""

import csv
import statistics
import subprocess
import sys
import time
from pathlib import Path


def output(*command):
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout


def numpy_update(times):
    """Nanoseconds of one update of recursive least squares, four parameters."""
    import numpy as np

    random = np.random.default_rng(2)
    rows = random.uniform(-1, 1, (4096, 4))
    values = rows.sum(axis=1)
    theta, p = np.zeros(4), np.eye(4) * 1e6
    begun = time.perf_counter()
    for _ in range(times):
        for x, value in zip(rows, values):
            px = p @ x
            gain = px / (0.98 + x @ px)
            theta = theta + gain * (value - x @ theta)
            p = (p - np.outer(gain, px)) / 0.98
    return (time.perf_counter() - begun) * 1e9 / (times * len(rows))


def reader(module):
    """Nanoseconds of one row of four numbers by a library that reads CSV."""

    def read(path, times):
        if module == "pandas":
            import pandas

            work = lambda: pandas.read_csv(path)
        elif module == "pyarrow":
            import pyarrow
            from pyarrow import csv as arrow

            pyarrow.set_cpu_count(1)
            work = lambda: arrow.read_csv(path)
        else:

            def work():
                with open(path, newline="") as file:
                    # As ours: numbers as such, a status and remarks as text.
                    rows = csv.DictReader(file)
                    texts = {"status", "quality"}
                    return [[cell if name in texts else float(cell) for name, cell in row.items()] for row in rows]

        begun = time.perf_counter()
        for _ in range(times):
            rows = work()
        return (time.perf_counter() - begun) * 1e9 / (times * len(rows))

    return read


def has(module):
    try:
        __import__(module)
        return True
    except ImportError:
        return False


def main():
    program, kernel, work, rounds = Path(sys.argv[1]), sys.argv[2], Path(sys.argv[3]), int(sys.argv[4])
    csv_file = work / "table.csv"
    csv_file.write_text(output(kernel, "table"))
    ours = lambda name, times: lambda: float(output(kernel, name, str(times)))
    pairs = [
        ("recursive least squares, 4 parameters, one update", "plain C loop, gcc -O2", ours("rls/guarded_4", 400), lambda: float(output(work / "rls", "400"))),
    ]
    if has("numpy"):
        pairs.append(("the same", "numpy", ours("rls/guarded_4", 400), lambda: numpy_update(3)))
    for module in ["csv", "pandas", "pyarrow"]:
        if has(module):
            read = reader(module)
            name = "Python's csv" if module == "csv" else module
            # A thread for each, and a number as it was written, to the last bit.
            pairs.append(("a row of a CSV with twelve columns read", name, ours("recording/run_in", 10), lambda read=read: read(csv_file, 2)))
        else:
            print(f"not installed: {module}", file=sys.stderr)
    print("| what | ours | beside | theirs | ours by theirs, median (least to most) |")
    print("|---|---|---|---|---|")
    for what, peer, mine, theirs in pairs:
        both = []
        for number in range(rounds):
            # Who goes first changes from round to round.
            if number % 2:
                other, own = theirs(), mine()
            else:
                own, other = mine(), theirs()
            both.append((own, other))
        ratios = sorted(own / other for own, other in both)
        own, other = (statistics.median(column) for column in zip(*both))
        print(f"| {what} | {own:.0f} ns | {peer} | {other:.0f} ns | {statistics.median(ratios):.3f} ({ratios[0]:.3f} to {ratios[-1]:.3f}) |")


if __name__ == "__main__":
    main()
