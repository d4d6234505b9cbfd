"""Arguments of the SDK: checks that name the argument, and addresses without their passwords."""

from __future__ import annotations

import ipaddress
import math
import numbers
import reprlib
from collections.abc import Mapping
from typing import TypeVar

from pydantic import BaseModel, ValidationError

from veilcam_client.errors import ArgumentError

ModelT = TypeVar("ModelT", bound=BaseModel)


def seconds(name: str, value: object, use: str = "> 0", *, zero: bool = False) -> float:
    """Return a duration [s] above zero, or from zero on; raises ArgumentError."""
    number = isinstance(value, numbers.Real) and not isinstance(value, bool)
    if not number or not (value > 0 or (zero and value == 0)):  # type: ignore[operator]
        raise ArgumentError(f"{name} = {reprlib.repr(value)} s is not valid: use {use}")
    return float(value)  # type: ignore[arg-type]


def whole(name: str, value: object, least: int, most: float = math.inf) -> int:
    """Return a whole number within limits; raises ArgumentError."""
    number = isinstance(value, numbers.Integral) and not isinstance(value, bool)
    if not number or not least <= value <= most:  # type: ignore[operator]
        to = f" to {most}" if most < math.inf else " on"
        raise ArgumentError(
            f"{name} = {reprlib.repr(value)} is not valid: use a whole number from {least}{to}"
        )
    return int(value)  # type: ignore[call-overload, no-any-return]


def of_type(name: str, value: object, kinds: type | tuple[type, ...], use: str) -> None:
    """Raise ArgumentError, without the value, unless it has one of the types."""
    if not isinstance(value, kinds):
        raise ArgumentError(f"{name} cannot be a {type(value).__name__}: use {use}")


def model(kind: type[ModelT], fields: Mapping[str, object]) -> ModelT:
    """Return the question that arguments make; raises ArgumentError for the first at fault."""
    try:
        return kind.model_validate(fields)
    except ValidationError as error:
        item = error.errors(include_url=False)[0]
        if not item["loc"]:
            raise ArgumentError(item["msg"].removeprefix("Value error, ")) from None
        name = str(item["loc"][0])
        value = f" = {reprlib.repr(fields[name])}" if kind.model_fields[name].repr else ""
        raise ArgumentError(f"{name}{value} is not valid: {item['msg']}") from None


def is_this_machine(host: str) -> bool:
    """Return whether a host is localhost or a loopback address."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def masked(address: str) -> str:
    """Return an address without user, password and query: for messages and ``repr``."""
    if address.startswith("unix:"):
        return address
    # Greedy: a password that is not quoted as it should be may hold any character.
    head, at, tail = address.rpartition("@")
    scheme, slashes, _ = head.partition("//")
    shown = f"{scheme}{slashes}***@{tail}" if slashes else f"***@{tail}"
    place, mark, _ = (shown if at else address).partition("?")
    return f"{place}{mark}***" if mark else place
