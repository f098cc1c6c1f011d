"""A few hundred damaged recordings and videos over every verb; `benchmarks/abuse.py` does it with thousands."""

from pathlib import Path

import pytest
from mutants import Tally, abuse, hurt_records, run, whole_files

SEEDS = 240
ONCE_WRONG = {
    50727: "a channel that only a damaged chunk has",
    200015: "an index of more messages than there are, in retrack",
    200075: "a state on a topic of one word, in annotate",
    200489: "a first state that is not as its schema says, in annotate",
    201083: "an index of more messages than there are, under the thread that decodes for annotate",
    300305: "accelerations beyond all measure, in sync",
}


@pytest.fixture(scope="module")
def wholes(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return sorted(whole_files(tmp_path_factory.mktemp("wholes")))


def test_no_mutant_traces_back_or_loses_anything_without_a_word(wholes: list[Path]) -> None:
    tally = Tally()
    abuse(wholes, range(SEEDS), track_every=5, tally=tally, say=lambda line: None)
    assert tally.wrong == []
    assert tally.mutants == SEEDS
    assert tally.slowest_s < 30
    assert {0, 1, 3} <= set(tally.codes)  # they are hurt, and not all of them beyond reading


@pytest.mark.parametrize("seed", ONCE_WRONG)
def test_a_mutant_that_once_was_wrong_is_right(wholes: list[Path], seed: int) -> None:
    tally = Tally()
    abuse(wholes, range(seed, seed + 1), track_every=1, tally=tally, say=lambda line: None)
    assert tally.wrong == []


def test_whole_files_are_found_whole(wholes: list[Path]) -> None:
    for path in wholes:
        outcome = run("info", "--check", path)
        assert (outcome.code, outcome.err) == (0, ""), path


def test_the_records_of_a_mutant_are_hurt_under_right_checksums(wholes: list[Path]) -> None:
    import io
    import random

    from mcap.stream_reader import StreamReader

    ours = next(path for path in wholes if path.name == "ours.mcap").read_bytes()
    for seed in range(20):
        assert list(StreamReader(io.BytesIO(hurt_records(ours, random.Random(seed))), validate_crcs=True).records)
