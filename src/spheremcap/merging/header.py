"""What a column's name obviously means, in the languages that loggers speak."""

import re
import unicodedata
from typing import NamedTuple

from spheremcap.merging.tables import bare_name, split_unit
from spheremcap.merging.units import TIME_UNITS, UNITS, plain

VECTORS = ("linear_acceleration", "angular_velocity", "magnetic_field", "force", "moment")

_QUANTITIES: tuple[tuple[str, str], ...] = (
    (r"(free|user|gravity)(acc|beschl)\w*|gravity|linacc\w*", ""),  # gravity is taken out, or nothing else is in it
    (
        r"linearacceleration|accelerometer|acceleration|beschleunigung|beschl|aceleracion|accel|acc|a",
        "linear_acceleration",
    ),
    (
        r"angularvelocity|angularrate|gyroscope|gyroskop|drehrate|winkelgeschwindigkeit|rateofturn|gyro|gyr|g|omega|w",
        "angular_velocity",
    ),
    (r"magneticfield|magnetometer|magnetfeld|magnetic|mag", "magnetic_field"),
    (r"force|kraft|fuerza|f", "force"),
    (r"moment|drehmoment|torque|t", "moment"),
    (r"m", "moment|magnetic_field"),
)
_AXIS = re.compile(r"^(.*?)([xyz])$")
_AXIS_FIRST = re.compile(r"^([xyz])(?:achse|axis)?(\w{3,})$")
_TIME_NAME = re.compile(
    r"^(?:relative|elapsed|absolute|abs|unix|utc|gps|sample|device|local|system|host|rec|recording|mess|lauf)?"
    r"(?:time|timestamp|t|sampletimefine|epoch|epoc|unixtime|datetime|dateandtime|date|timeofday|clock|elapsed"
    r"|zeit|zeitstempel|zeitpunkt|uhrzeit|datum|datumuhrzeit|datumzeit|datumundzeit|zeitpunkt"
    r"|temps|horodatage|heure|tiempo|hora|fecha|tempo|orario|tijd|tijdstip|tid|tidspunkt|aika|czas"
    r"|время|дата|时间|時間|時刻)(ns|us|ms|s)?$"
)
_ANGLES = (
    "angle", "wheelangle", "theta", "encoder", "position", "counts", "winkel", "radwinkel", "kurbelwinkel",
    "drehwinkel",
)  # fmt: skip
_RATES = ("rate", "angularrate", "wheelrate", "angularvelocity", "rpm", "drehzahl", "winkelgeschwindigkeit", "cadence")
_SPEEDS = ("speed", "velocity", "v", "geschwindigkeit", "vitesse", "velocidad", "wheelspeed", "gpsspeed", "groundspeed")
_TEMPERATURES = ("temperature", "temp", "temperatur")
_SUFFIX_UNITS = (
    ("_mps2", "m/s2"), ("_ms2", "m/s2"), ("_m_s2", "m/s2"), ("_dps", "dps"), ("_deg_s", "deg/s"),
    ("_rad_s", "rad/s"), ("_radps", "rad/s"), ("_km_h", "km/h"), ("_kmh", "km/h"), ("_kph", "km/h"), ("_mps", "m/s"),
    ("_m_s", "m/s"), ("_mph", "mph"), ("_ut", "uT"), ("_g", "g"), ("_nm", "Nm"), ("_n", "N"),
    ("_deg", "deg"), ("_rad", "rad"), ("_rpm", "rpm"), ("_ns", "ns"), ("_us", "us"), ("_ms", "ms"),
    ("_s", "s"),
)  # fmt: skip


class Meaning(NamedTuple):
    """A quantity (`time`, `linear_acceleration`, `speed`, ...), its axis or "", and the unit that the header gives."""

    quantity: str
    axis: str
    unit: str

    @property
    def value(self) -> str:
        """`linear_acceleration.x`, or `angle`."""
        return f"{self.quantity}.{self.axis}" if self.axis else self.quantity


def meaning(name: str, unit: str) -> Meaning | None:
    """What `Gyroscope X (deg/s)` obviously means; None when it does not. `unit` is that of a row of units."""
    bare, behind = split_unit(name)
    unit = unit or behind
    if not unit:
        for ending, meant in _SUFFIX_UNITS:
            if bare.lower().endswith(ending):
                bare, unit = bare[: -len(ending)], meant
                break
    text = re.sub(r"\W", "", without_accents(bare_name(bare)))
    if match := _TIME_NAME.match(text):
        in_name = match[1] if plain(unit) not in TIME_UNITS else None  # a row of units may say dd/mm/yyyy
        return Meaning("time", "", in_name or (unit if plain(unit) in TIME_UNITS else ""))
    if text in _SPEEDS and (plain(unit) in UNITS["speed"] or not unit):
        return Meaning("speed", "", unit)
    if text in _ANGLES:
        return Meaning("angle", "", unit)
    if text in (*_RATES, *_SPEEDS):
        return Meaning("rate", "", unit or ("rpm" if text == "rpm" else ""))
    if text in _TEMPERATURES:
        return Meaning("temperature", "", unit)
    text = text.removesuffix("achse").removesuffix("axis")
    if text in ("x", "y", "z") and unit:  # x-IMU3's high-g accelerometer, MbientLab
        quantity = next((q for q in VECTORS if plain(unit) in UNITS[q]), None)
        return Meaning(quantity, text, unit) if quantity is not None else None
    if match := _AXIS_FIRST.match(text):
        text = match[2] + match[1]
    if match := _AXIS.match(text):
        for pattern, quantity in _QUANTITIES:
            if re.fullmatch(pattern, match[1]):
                if "|" in quantity:
                    quantity = next((q for q in quantity.split("|") if plain(unit) in UNITS[q]), "")
                return Meaning(quantity, match[2], unit) if quantity else None
    if match := re.match(r"^(?:quaternion|quat|q)([wxyz])$", text):
        return Meaning("orientation", match[1], "1")
    return None


def topic_name(text: str) -> str:
    """A text as part of a topic: lower case, with _ for everything that is not a letter or digit."""
    for letter, plain_letters in (("ä", "ae"), ("ö", "oe"), ("ü", "ue"), ("ß", "ss")):
        text = text.replace(letter, plain_letters).replace(letter.upper(), plain_letters)
    return re.sub(r"[^a-z0-9]+", "_", without_accents(text).lower()).strip("_")


def field_name(name: str) -> str:
    """A column's name as a protobuf field: `Temperature (°C)` is temperature_c; "" when no letter is left."""
    bare, unit = split_unit(name)
    text = topic_name(f"{bare} {plain(unit).replace('/', ' per ')}")
    return text if text[:1].isalpha() or not text else f"c_{text}"


def without_accents(text: str) -> str:
    """`accélération` as `acceleration`."""
    return "".join(c for c in unicodedata.normalize("NFKD", text) if not unicodedata.combining(c))
