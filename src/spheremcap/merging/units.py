"""Units that sensor files come in, to SI."""

import math

from spheremcap.errors import UsageError

G = 9.80665
_DEG = math.pi / 180

UNITS: dict[str, dict[str, float]] = {
    "linear_acceleration": {"m/s2": 1, "m/s/s": 1, "mps2": 1, "ms-2": 1, "mm/s2": 1e-3, "g": G, "mg": G / 1000},
    "angular_velocity": {
        "rad/s": 1, "rads": 1, "rps": 1, "mrad/s": 1e-3, "deg/s": _DEG, "d/s": _DEG, "dps": _DEG,
        "mdps": _DEG / 1000, "degs": _DEG, "rpm": math.pi / 30, "rev/s": 2 * math.pi, "hz": 2 * math.pi,
    },
    "magnetic_field": {"t": 1, "mt": 1e-3, "ut": 1e-6, "nt": 1e-9, "g": 1e-4, "gauss": 1e-4, "mgauss": 1e-7},
    "orientation": {"1": 1},
    "temperature": {"c": 1, "celsius": 1},
    "angle": {"rad": 1, "deg": _DEG, "rev": 2 * math.pi, "turn": 2 * math.pi},
    "force": {"n": 1, "kn": 1e3, "lbf": 4.4482216152605, "kgf": G},
    "moment": {"nm": 1, "nmm": 1e-3, "kgfm": G},
    "length": {"m": 1, "cm": 1e-2, "mm": 1e-3, "in": 0.0254},
    "speed": {
        "m/s": 1, "mps": 1, "km/h": 1 / 3.6, "mph": 0.44704, "mi/h": 0.44704, "kn": 1852 / 3600, "kt": 1852 / 3600,
        "knots": 1852 / 3600, "ft/s": 0.3048, "fps": 0.3048, "cm/s": 1e-2, "mm/s": 1e-3, "m/min": 1 / 60,
    },
}  # fmt: skip
UNITS["rate"] = UNITS["angular_velocity"]
TIME_UNITS = {
    "ns": 1, "us": 1_000, "ms": 1_000_000, "s": 1_000_000_000, "min": 60_000_000_000, "h": 3_600_000_000_000,
}  # fmt: skip

_SAME = str.maketrans({"µ": "u", "μ": "u", "²": "2", "°": "deg", "·": "", "^": "", "(": "", ")": "", "*": "", " ": ""})
_WORDS = {
    "degc": "c", "gradc": "c", "grad": "deg", "degrees": "deg", "degree": "deg", "grad/s": "deg/s", "deg/sec": "deg/s",
    "milliseconds": "ms", "millisecond": "ms", "millis": "ms", "msec": "ms", "millisekunden": "ms",
    "microseconds": "us", "microsecond": "us", "usec": "us", "mikrosekunden": "us", "nanoseconds": "ns", "nsec": "ns",
    "sekunden": "s", "sekunde": "s", "sek": "s", "secondes": "s", "segundos": "s", "secondi": "s", "sekunder": "s",
    "minuten": "min", "minutes": "min", "hours": "h", "stunden": "h", "std": "h",
    "kmh": "km/h", "kph": "km/h", "kmph": "km/h", "km/std": "km/h", "kmh-1": "km/h", "m/sec": "m/s",
    "u/min": "rpm", "1/min": "rpm", "min-1": "rpm", "umin-1": "rpm", "radian": "rad", "radians": "rad",
}  # fmt: skip


def plain(unit: str) -> str:
    """A unit as the tables here spell it: `m/(s^2)*` is m/s2, `°/s` deg/s, `N·m` nm, `Sekunden` s."""
    text = unit.strip().translate(_SAME).lower()
    text = _WORDS.get(text, text)
    for long, short in (
        ("degrees", "deg"),
        ("degree", "deg"),
        ("seconds", "s"),
        ("second", "s"),
        ("sec", "s"),
    ):
        text = text.replace(long, short)
    return _WORDS.get(text, text).replace(".", "")


def factor(quantity: str, unit: str, where: str) -> float:
    """What a number in `unit` is multiplied with to be SI. Raises UsageError naming `where` and what there
    is.
    """
    known = UNITS[quantity]
    value = known.get(plain(unit))
    if value is None:
        what = f"unit {unit!r} is none of" if unit.strip() else "has no unit; give one of"
        raise UsageError(f"{where}: {what} {', '.join(known)} ({quantity.replace('_', ' ')})")
    return value


_OTHERS = ("", "au", "no_units", "unitless", "local_flux", "kpa", "hpa", "pa", "mv", "v", "%", "w", "bpm", "a", "ma")


def is_unit(text: str) -> bool:
    """Whether a cell of a units row is a unit, known here or not."""
    bare = plain(text)
    return is_known(text) or bare in _OTHERS or bare[:4] in ("yyyy", "dd/m", "ddmm", "hh:m") or bare[:2] == "tt"


def is_known(text: str) -> bool:
    """Whether a text is a unit that can be converted."""
    bare = plain(text)
    return any(bare in t for t in UNITS.values()) or bare in TIME_UNITS
