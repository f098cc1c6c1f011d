"""Which markers, and which time of a recording, somebody wants."""

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from spheremcap.core.time import LARGEST_RELATIVE_NS
from spheremcap.errors import UsageError
from spheremcap.io.mcap_records import McapRecords


@dataclass(frozen=True)
class Selection:
    """Markers by name (none: all), and start_ns <= stamp < end_ns (None: open).

    Times below `LARGEST_RELATIVE_NS` count from the recording's first message, once it is known (`from_start_of`).
    """

    markers: tuple[str, ...] = ()
    start_ns: int | None = None
    end_ns: int | None = None

    def from_start_of(self, records: McapRecords) -> "Selection":
        """The same with times as the recording has them."""
        first_ns = (records.span_ns or (0, 0))[0]

        def absolute(ns: int | None) -> int | None:
            return ns + first_ns if ns is not None and ns < LARGEST_RELATIVE_NS else ns

        return replace(self, start_ns=absolute(self.start_ns), end_ns=absolute(self.end_ns))

    def rows(self, stamps: npt.NDArray[np.int64], markers: npt.NDArray[Any] | None = None) -> npt.NDArray[np.bool_]:
        """Which of the rows with these stamps (N,), and markers where there are several, are wanted: (N,)."""
        wanted = np.ones(len(stamps), np.bool_)
        if self.start_ns is not None:
            wanted &= stamps >= self.start_ns
        if self.end_ns is not None:
            wanted &= stamps < self.end_ns
        if self.markers and markers is not None:
            wanted &= np.isin(markers, self.markers)
        return wanted

    def check(self, there: Collection[str], path: object) -> None:
        """Raises UsageError for a marker that is not there."""
        for marker in self.markers:
            if marker not in there:
                raise UsageError(f"{path}: no marker {marker!r}; there are: {', '.join(sorted(there)) or 'none'}")
