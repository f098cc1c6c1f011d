"""What the configs of all stages share: frozen, and an unknown key is an error."""

from pydantic import BaseModel, ConfigDict


class StageConfig(BaseModel):
    """Base of every stage's own config; fields carry unit, range and the source of their default."""

    model_config = ConfigDict(frozen=True, extra="forbid")
