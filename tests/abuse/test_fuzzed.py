"""A short run of benchmarks/abuse/fuzz.py without coverage, and the inputs on which a reader once failed there."""

import random
import sys
from pathlib import Path

import pytest
from mutants import hurt_bytes

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks" / "abuse"))

import fuzz

CRASHES = sorted((Path(__file__).parent / "crashes").glob("*/*"))


@pytest.mark.parametrize("reader", fuzz.READERS)
def test_whole_and_damaged_inputs_are_read_or_refused(reader: str) -> None:
    for number, data in enumerate(fuzz.beginnings(reader)):
        fuzz.READERS[reader](data)
        for seed in range(40):
            fuzz.READERS[reader](hurt_bytes(data, random.Random(f"{number} {seed}")))


@pytest.mark.parametrize("path", CRASHES, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_what_once_failed_is_read_or_refused(path: Path) -> None:
    fuzz.READERS[path.parent.name](path.read_bytes())


def test_a_reader_that_loses_or_changes_something_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fuzz, "McapRecords", lambda path: _Half(path))
    with pytest.raises(AssertionError, match="6 messages without a word, a tolerant reader gets 12"):
        fuzz.records(fuzz.beginnings("records")[0])
    monkeypatch.setattr(fuzz, "units", lambda data, format_: [(1, b"not in it")])
    with pytest.raises(ValueError, match="not found"):
        fuzz.annex_b(fuzz.beginnings("annex_b")[0])


class _Half(fuzz.McapRecords):
    def messages(self, topics=None):
        return (message for message in super().messages(topics) if message.sequence % 2)
