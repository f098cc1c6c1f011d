"""A short run of benchmarks/abuse/kills.py: whatever ends a run, what it had written is there, once."""

import os
import random
import signal
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks" / "abuse"))

import kills

from spheremcap.io import export


@pytest.fixture(scope="module")
def jobs(tmp_path_factory):
    return kills.prepare(tmp_path_factory.mktemp("jobs"), seconds=3)


def test_kill_9_at_any_moment_loses_no_full_second_and_no_old_output(jobs, tmp_path):
    left = kills.disturbed(jobs, tmp_path, 15, [signal.SIGKILL], random.Random(1))
    assert sum(left.values()) == 15
    assert sum(count for (_, kind), count in left.items() if kind == "part, cut off") > 2


def test_sigterm_and_sighup_end_a_run_as_ctrl_c_does(jobs, tmp_path):
    numbers = [signal.SIGTERM, signal.SIGHUP]
    left = kills.disturbed(jobs, tmp_path, 8, numbers, random.Random(2))
    assert sum(left.values()) == 8
    assert not any(kind in ("part, cut off", "part of a table") for _, kind in left)


def test_a_table_is_not_left_half_written(jobs, tmp_path):
    job = next(job for job in jobs if job.name == "export")

    def before():  # in the run's own process: a signal once the first rows are written
        write = export._write_csv

        def signalled(rest):
            os.kill(os.getpid(), signal.SIGTERM)
            yield from rest

        export._write_csv = lambda path, first, rest, start_ns: write(path, first, signalled(rest), start_ns)

    with kills.old_output(job, tmp_path) as words:
        ending = kills.run(words, before)
        assert kills.checked(job, tmp_path, ending, killed=False) == "nothing written"
        assert (ending.code, ending.said) == (1, "spheremcap: interrupted\n")


def test_a_full_disk_keeps_what_fitted_and_the_old_output(jobs, tmp_path):
    _, left = kills.full_disks(jobs, tmp_path, 8)
    assert sum(left.values()) == 8
    assert sum(count for (_, kind), count in left.items() if kind == "part, ended") > 3
    assert not any(kind == "whole" for job, kind in left if job != "export")  # a small table, and disks have pages
