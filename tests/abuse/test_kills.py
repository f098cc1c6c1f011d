"""A short run of benchmarks/abuse/kills.py: whatever ends a run, what it had written is there, once."""

import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

KILLS = Path(__file__).parents[2] / "benchmarks" / "abuse" / "kills.py"


@pytest.fixture(scope="module")
def said() -> str:
    """What a short run prints, in a process of its own: one with threads, as that of the tests, cannot be forked."""
    counts = ["--kills", "15", "--ends", "8", "--full", "8", "--seconds", "3"]
    run = subprocess.run([sys.executable, KILLS, *counts], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout + run.stderr
    return run.stdout


def left(said: str, title: str) -> Counter[tuple[str, str]]:
    """How often each job left a file of each kind, by the table with that title."""
    head, *rows = said.split(f"\n{title}")[1].split("\n\n")[0].splitlines()[1:]
    kinds = re.split(r"\s{2,}", head.strip())
    found = Counter[tuple[str, str]]()
    for row in rows:
        for kind, count in zip(kinds, row[20:].split(), strict=True):
            found[row[:20].strip(), kind] += int(count)
    return found


def test_kill_9_at_any_moment_loses_no_full_second_and_no_old_output(said: str) -> None:
    found = left(said, "15 times kill -9")
    assert found.total() == 15
    assert sum(count for (_, kind), count in found.items() if kind == "part, cut off") > 2


def test_sigterm_and_sighup_end_a_run_as_ctrl_c_does(said: str) -> None:
    found = left(said, "8 times SIGTERM, SIGHUP or SIGINT")
    assert found.total() == 8
    assert not any(kind in ("part, cut off", "part of a table") for _, kind in found)


def test_a_table_is_not_left_half_written(said: str) -> None:
    assert "an export that is told to end after its first rows: nothing written" in said


def test_a_full_disk_keeps_what_fitted_and_the_old_output(said: str) -> None:
    found = left(said, "8 full disks")
    assert found.total() == 8
    assert sum(count for (_, kind), count in found.items() if kind == "part, ended") > 3
    # a small table, and disks have pages
    assert not any(count for (job, kind), count in found.items() if kind == "whole" and job != "export")
