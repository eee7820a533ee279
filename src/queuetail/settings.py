"""What every settings table is made of, so that each part of queuetail can declare its own."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Latitude = Annotated[float, Field(ge=-90, le=90, allow_inf_nan=False)]
Longitude = Annotated[float, Field(ge=-180, le=180, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
LatLon = tuple[Latitude, Longitude]
Metres2 = tuple[Finite, Finite]


class Settings(BaseModel):
    """Base of every settings table: frozen, and unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True)
