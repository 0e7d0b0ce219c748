"""A table by vehicle that stays bounded, for a peer may invent names. Not for use by several threads at once."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterator
from typing import Generic, TypeVar

T = TypeVar("T")

MOST_VEHICLES = 1000


class LastReceived(Generic[T]):
    """Values of at most `most` vehicles: a new one replaces the one that has sent nothing for the longest time.

    So invented names are in the way of no aircraft that goes on sending.
    """

    def __init__(self, make: Callable[[str], T], most: int = MOST_VEHICLES) -> None:
        self._make, self._most = make, most
        self._held: OrderedDict[str, T] = OrderedDict()

    def of(self, vehicle: str) -> T:
        """Return the value of a vehicle of which something came now; made if it is new."""
        held = self._held.get(vehicle)
        if held is None:
            held = self._held[vehicle] = self._make(vehicle)
        self._held.move_to_end(vehicle)
        while len(self._held) > self._most:
            self._held.popitem(last=False)
        return held

    def get(self, vehicle: str) -> T | None:
        return self._held.get(vehicle)

    def __contains__(self, vehicle: str) -> bool:
        return vehicle in self._held

    def __iter__(self) -> Iterator[str]:
        return iter(self._held)

    def values(self) -> list[T]:
        return list(self._held.values())
