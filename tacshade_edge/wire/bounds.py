"""Bounded numbers and names, which the types of several topics consist of."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

Count = Annotated[int, Meta(ge=0)]  # below 2^64, as `codec` requires
Code = Annotated[str, Meta(pattern=r"\A[a-z0-9_]{0,64}\Z")]
Key = Annotated[str, Meta(pattern=r"\A[A-Za-z0-9_.-]{1,64}\Z")]
Rate = Annotated[float, Meta(ge=0, le=1e9)]
Number = Annotated[float, Meta(ge=-1e6, le=1e6)]
SevenNumbers = tuple[Number, Number, Number, Number, Number, Number, Number]
Counts = Annotated[dict[Key, Count], Meta(max_length=64)]
SlipCode = Annotated[int, Meta(ge=0, le=2)]  # stick, partial, full
