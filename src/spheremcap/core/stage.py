"""What the configs of all stages share: frozen, unknown keys refused, numbers that are numbers."""

import math
import re
from typing import Any

from annotated_types import Gt, Le, Lt
from pydantic import BaseModel, ConfigDict, ValidationInfo, field_validator

from spheremcap.errors import short

_LENGTH = re.compile(r"\s*(\d+\.?\d*|\.\d+)\s*(mm|cm|m|in)\s*", re.ASCII)
_UNIT_M = {"mm": 0.001, "cm": 0.01, "m": 1.0, "in": 0.0254}
_FARTHEST, _NEAREST = 1e6, 1e-9
"""No setting without a bound of its own is larger, and none that has to be above zero is smaller."""


class StageConfig(BaseModel):
    """Base of every stage's own config; fields carry unit, range and the source of their default."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @field_validator("*", mode="before")
    @classmethod
    def _a_number(cls, value: Any, info: ValidationInfo) -> Any:
        """A switch or a text is no number, and neither is one beyond all bounds."""
        field = cls.model_fields[str(info.field_name)]
        kinds = {field.annotation, *getattr(field.annotation, "__args__", ())}
        numeric = bool(kinds & {int, float})
        if isinstance(value, bool):
            if numeric:
                raise ValueError("true and false are for switches, a number is expected")
        elif isinstance(value, str) and numeric:
            raise ValueError("a number has no quotes, and its decimals a point: 0.04")
        elif isinstance(value, int | float | str) and bool in kinds:
            raise ValueError("a switch is true or false")
        elif isinstance(value, int | float) and numeric:
            bounds = {type(bound): bound for bound in field.metadata}
            bounded = Le in bounds or Lt in bounds
            if not math.isfinite(value) or (abs(value) > _FARTHEST and not bounded):
                raise ValueError("no setting is that large")
            if Gt in bounds and 0 < value < _NEAREST:
                raise ValueError("no setting is that small")
        return value


def length_m(text: Any) -> float:
    """Metres of a length with its unit, such as "4 cm". Raises ValueError."""
    found = _LENGTH.fullmatch(text) if isinstance(text, str) else None
    if not found:
        raise ValueError(f'diameter {short(text)} is not a length such as "4 cm"')
    return float(found[1]) * _UNIT_M[found[2]]
