"""SMARTwheel: no header; column 2 counts samples, 4 is the angle in degrees, 19-21 forces in N, 22-24 moments in
N m.
"""

from dataclasses import replace

import numpy as np

from spheremcap.errors import UsageError
from spheremcap.merging.columns import even_stamps, fixed
from spheremcap.merging.log import SensorLog
from spheremcap.merging.mapping import TableMapping
from spheremcap.merging.tables import Table, read_columns
from spheremcap.merging.times import Timing

_LONGEST = 10_000_000
"""Samples: more than eleven hours at 240 Hz."""
_COLUMNS: dict[str, tuple[str | int, ...]] = {"angle": (4,), "force": (19, 20, 21), "moment": (22, 23, 24)}
_UNITS = {"angle": "deg", "force": "N", "moment": "Nm"}


def matches(table: Table) -> bool:
    """Many columns without names."""
    return not table.names and len(table.first_row) >= 24


def read(table: Table, name: str, mapping: TableMapping) -> SensorLog:
    """The times are those of the counter, at a rate that has to be given; missing samples are counted."""
    rate_hz = mapping.time.rate_hz
    if rate_hz is None:
        raise UsageError(f"{table.path}: a SMARTwheel file has no times: give its rate (240 and 200 Hz both occur)")
    # The same columns, so that both readings leave out the same lines.
    counter = read_columns(table, (1, 3, *range(18, 24))).values[:, 0]
    samples = counter - counter[0]
    steps = np.diff(samples)
    if not len(steps) or not (steps.min() >= 1) or np.any(steps != np.rint(steps)) or samples[-1] > _LONGEST:
        return fixed(table, name, mapping, _COLUMNS, _UNITS)
    stamp_ns = even_stamps(int(samples[-1]) + 1, rate_hz)[samples.astype(int)]
    timing = Timing(f"column 2, which counts samples, at {rate_hz:g} Hz", "start")
    log = fixed(table, name, mapping, _COLUMNS, _UNITS, (stamp_ns, timing))
    missing = int(samples[-1]) + 1 - len(samples)
    return replace(log, notes=(*log.notes, f"{table.path}: {missing} samples are missing")) if missing else log
