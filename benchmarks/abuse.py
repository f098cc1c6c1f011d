"""Damaged recordings and videos over every verb, thousands of them: no traceback, no hang, no silence.

    python benchmarks/abuse.py --mutants 10000 --first 0

The mutants of a seed are always the same: what is printed as wrong is made again by `--first SEED --mutants 1`. Each
batch runs in a process of its own, so that one that hangs or is killed names the mutant that did it.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "tests" / "io"), str(ROOT / "tests" / "abuse")]
TIMEOUT_S = 300.0
"""For one mutant; all verbs together take below a second, but on a busy machine a process waits long for its turn."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mutants", type=int, default=10_000)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--batch", type=int, default=250)
    parser.add_argument("--track-every", type=int, default=2, help="track only each so many-th mutant of a file")
    parser.add_argument("--worker", nargs=3, metavar=("FIRST", "END", "FOLDER"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker:
        first, end, folder = options.worker
        _work(range(int(first), int(end)), Path(folder), options.track_every)
        return 0
    print(f"seeds {options.first} to {options.first + options.mutants - 1}", flush=True)
    wrong: list[str] = []
    runs: dict[str, int] = {}
    codes: dict[str, int] = {}
    peak, slowest, began = 0.0, 0.0, time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        from mutants import whole_files

        whole_files(Path(folder))
        at, end = options.first, options.first + options.mutants
        while at < end:
            stop = min(at + options.batch, end)
            last, tally = _batch(at, stop, folder, options.track_every)
            if tally is None:
                wrong.append(f"seed {last}: the process hung or died")
                print(wrong[-1], flush=True)
                at = last + 1
                continue
            for name in tally["wrong"]:
                print(name, flush=True)
            wrong += tally["wrong"]
            for total, part in ((runs, tally["runs"]), (codes, tally["codes"])):
                for key, count in part.items():
                    total[key] = total.get(key, 0) + count
            peak, slowest = max(peak, tally["peak_mb"]), max(slowest, tally["slowest_s"])
            at = stop
    spent = time.monotonic() - began
    print(f"{options.mutants} mutants in {spent:.0f} s; runs {runs}; exit codes {codes}")
    print(f"peak {peak:.0f} MB, slowest run {slowest:.1f} s, {len(wrong)} wrong")
    return 1 if wrong or peak > 600 else 0


def _batch(first: int, end: int, folder: str, track_every: int) -> tuple[int, dict | None]:
    """The seed that was last begun, and the tally; None when the process hung or died at it."""
    command = [sys.executable, __file__, "--track-every", str(track_every), "--worker", str(first), str(end), folder]
    last, tally = first, None
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    assert process.stdout is not None
    import selectors

    with selectors.DefaultSelector() as selector:
        selector.register(process.stdout, selectors.EVENT_READ)
        while True:
            if not selector.select(TIMEOUT_S):
                process.kill()
                break
            line = process.stdout.readline()
            if not line:
                break
            if line.startswith("TALLY "):
                tally = json.loads(line[6:])
            elif line.split(" ")[0].isdigit():
                last = int(line.split(" ")[0])
            else:
                print(line, end="", flush=True)
    process.wait()
    return last, tally


def _work(seeds: range, folder: Path, track_every: int) -> None:
    from mutants import Tally, abuse, peak_mb

    tally = Tally()
    wholes = sorted(folder.iterdir())
    abuse(wholes, seeds, track_every=track_every, tally=tally, say=lambda line: print(line, flush=True))
    told = {"wrong": tally.wrong, "runs": tally.runs, "codes": tally.codes}
    print("TALLY " + json.dumps(told | {"slowest_s": tally.slowest_s, "peak_mb": peak_mb()}), flush=True)


if __name__ == "__main__":
    sys.exit(main())
