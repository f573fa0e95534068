"""Bounded numbers and names, which the types of several topics consist of."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

# Below 2^64, as `codec` requires.
Count = Annotated[int, Meta(ge=0)]
# \A and \Z: msgspec searches, and $ would accept a final newline, which ends a line of a log.
Code = Annotated[str, Meta(pattern=r"\A[a-z0-9_]{0,64}\Z")]
Key = Annotated[str, Meta(pattern=r"\A[A-Za-z0-9_.-]{1,64}\Z")]
# JSON has no infinity, but 1e308 is as bad for whoever adds or draws it.
Rate = Annotated[float, Meta(ge=0, le=1e9)]
# Half a ball of the greatest skin, 10 m, has 2.1e12 mm³.
Volume = Annotated[float, Meta(ge=0, le=1e13)]
Number = Annotated[float, Meta(ge=-1e6, le=1e6)]
SevenNumbers = tuple[Number, Number, Number, Number, Number, Number, Number]
Counts = Annotated[dict[Key, Count], Meta(max_length=64)]
# Stick, partial, full.
SlipCode = Annotated[int, Meta(ge=0, le=2)]
