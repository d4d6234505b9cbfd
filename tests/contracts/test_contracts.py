"""Every operator through every contract that applies to it."""

from __future__ import annotations

import pytest

from .contracts import CONTRACTS, Contract
from .registry import OPERATORS
from .setting import Operator

SLOW = (
    "adjoint",
    "device kept",
    "input gradient",
    "length gradients",
    "repeatable",
    "sizes, mirror",
    "type kept",
)
"""Contracts that build a matrix, differentiate, or compute more than once for every input."""
PAIRS = [
    pytest.param(
        operator,
        contract,
        id=f"{contract.name}-{operator.name}",
        marks=[pytest.mark.slow] if contract.name in SLOW else [],
    )
    for operator in OPERATORS
    for contract in CONTRACTS
    if contract.applies(operator)
]


@pytest.mark.thorough
@pytest.mark.parametrize(("operator", "contract"), PAIRS)
def test_contract(operator: Operator, contract: Contract) -> None:
    assert contract.measure(operator) <= contract.tolerance


def test_names_are_unique() -> None:
    for names in ([o.name for o in OPERATORS], [c.name for c in CONTRACTS]):
        assert len(set(names)) == len(names)
