"""Writes docs/stability.md: ``python -m tests.contracts.report`` from the root.

Every contract is measured for every operator, so the numbers are those of the tests. A test holds
the file's operators, contracts, tolerances and cases against the registry.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import torch

from .contracts import CONTRACTS, Contract
from .registry import OPERATORS
from .setting import Operator

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "stability.md"
TESTS = ROOT / "tests"
FOLDERS = ("unit/optics", "contracts")

HARD_CASES = (
    "contracts/test_hard_cases.py",
    "contracts/test_hard_measurements.py",
    "contracts/test_phases.py",
    "contracts/test_plans.py",
)

CLOSED_FORMS: Mapping[str, tuple[str, ...]] = {
    "square aperture": (
        "square_aperture",
        "square_aperture_on_axis",
        "square_aperture_against_quadrature",
    ),
    "circular aperture on its axis": ("circular_aperture_on_axis",),
    "Gaussian beam": ("gaussian_beam",),
    "Talbot distance": ("talbot_distance",),
    "Arago's spot": ("arago_spot",),
    "knife edge": ("knife_edge",),
    "two slits": ("two_slits_in_the_far_field",),
    "energy": (
        "energy_is_conserved_exactly_when_periodic",
        "energy_is_kept_by_propagation",
        "open_area_is_not_floored",
        "energy_of_the_field",
        "energy_of_the_transfer",
    ),
    "there and back again": ("there_and_back_again",),
    "shift equivariance": (
        "shift_of_the_source_shifts_the_field",
        "subpixel_shift_is_exact",
        "scene_shift_moves_the_image_the_other_way",
        "shift_equivariance_of_the_field",
        "shift_equivariance_of_the_transfer",
        "scene_pixel_further_is_an_embedding_pixel_back",
    ),
}

DEFECTS: Mapping[str, tuple[str, ...]] = {
    "odd sizes shifted by a pixel": ("odd_sizes_are_not_shifted_by_a_pixel",),
    "colour and wavelength swapped": (
        "each_colour_is_propagated_at_its_own_wavelength",
        "each_colour_has_its_own_wavelength",
    ),
    "apertures floored to whole samples": ("open_area_is_not_floored", "energy_of_the_transfer"),
    "weights outside [0, 1] get no gradient": ("weights_at_the_ends_do_not_die",),
    "more signal to noise than asked for": ("noise_far_above_and_below_the_signal",),
    "noise on the scene instead of the measurement": ("noise_of_a_plan_is_noise_after_the_optics",),
    "a bright neighbour in the batch darkens an image": (
        "contract",
        "each_image_has_its_own_noise_level",
    ),
    "misspelt options swallowed": ("no_function_swallows_a_misspelt_option",),
    "a pattern divided by its own maximum": ("dim_mask_stays_dim",),
    "bits lost on the wire modelled nowhere": ("six_bits_of_the_wire_are_modelled",),
    "options that do nothing": (
        "every_option_of_the_angular_spectrum_does_something",
        "every_option_of_the_transfer_operator_does_something",
        "every_option_of_the_other_paths_does_something",
    ),
    "frequencies that are not the DFT's": ("angular_spectrum_transfer",),
    "float32 kernels under complex128": ("contract",),
    "NaN gradient at the evanescent edge": ("wave_on_the_evanescent_edge_is_kept",),
    "resizing that skips pixels": ("binning_reads_every_pixel",),
    "division by no light": ("opaque_and_fully_open", "zero_in_zero_out"),
}


def named_tests(path: Path) -> dict[str, str]:
    return {
        node.name: (ast.get_docstring(node) or "").split("\n")[0]
        for node in ast.parse(path.read_text()).body
        if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")
    }


def places(name: str) -> list[str]:
    files = [path for each in FOLDERS for path in sorted((TESTS / each).rglob("test_*.py"))]
    found = [path.relative_to(TESTS) for path in files if f"def test_{name}(" in path.read_text()]
    assert found, f"there is no test_{name}"
    return [f"{path}::test_{name}" for path in found]


def measured(operator: Operator, contract: Contract) -> str:
    if not contract.applies(operator):
        return ""
    value = contract.measure(operator)
    if value > contract.tolerance:
        raise AssertionError(f"{operator.name} breaks {contract.name}: {value}")
    if not contract.tolerance:
        return "kept"
    return f"{value:.0e}" if value else "exact"


def blank(operator: Operator, contract: Contract) -> str:
    return ("#" if contract.tolerance else "kept") if contract.applies(operator) else ""


def without_numbers(page: str) -> str:
    before, heading, rest = page.partition("## Measured")
    table, end, after = rest.partition("Where float64 is computed")
    table = re.sub(r"(?<=\| )(\de[+-]\d+|exact)(?= \|)", "#", table)
    return before + heading + table + end + after


def lines(cell: Callable[[Operator, Contract], str]) -> Iterator[str]:
    yield "# Numerical stability"
    yield ""
    yield "Written by `python -m tests.contracts.report`; do not edit. Every operator of the"
    yield "optics goes through every contract that makes sense for it, on each run of the tests."
    yield ""
    yield "## Contracts"
    yield ""
    yield "| contract | tolerance | promise |"
    yield "|---|---|---|"
    for contract in CONTRACTS:
        tolerance = f"{contract.tolerance:.0e}" if contract.tolerance else "exact"
        promise = (contract.measure.__doc__ or "").split("\n")[0]
        yield f"| {contract.name} | {tolerance} | {promise} |"
    yield ""
    yield "## Measured"
    yield ""
    yield "Largest relative distance from the promise over all sizes and inputs, to one digit, in"
    yield "float64 unless the contract says otherwise. An empty cell: the contract says nothing"
    yield "about this operator. Devices are the CPU, a GPU if there is one, and torch's `meta`."
    yield ""
    numbers = [each for each in CONTRACTS if each.tolerance]
    yield f"| operator | {' | '.join(each.name for each in numbers)} |"
    yield "|---|" + "---|" * len(numbers)
    for operator in OPERATORS:
        yield f"| {operator.name} | {' | '.join(cell(operator, each) for each in numbers)} |"
    yield ""
    for contract in CONTRACTS:
        if not contract.tolerance:
            others = "; ".join(each.name for each in OPERATORS if not cell(each, contract))
            yield f"- {contract.name}: kept" + (
                f". It says nothing about {others}." if others else ""
            )
    yield ""
    yield "Where float64 is computed while applying in float32, and why:"
    yield ""
    for reason in sorted({operator.widens for operator in OPERATORS if operator.widens}):
        names = "; ".join(operator.name for operator in OPERATORS if operator.widens == reason)
        yield f"- {reason}: {names}."
    yield ""
    yield "## Hard cases"
    yield ""
    for file in HARD_CASES:
        summary = ast.get_docstring(ast.parse((TESTS / file).read_text())) or ""
        yield f"### `tests/{file}`"
        yield ""
        yield summary.split("\n")[0]
        yield ""
        for name, about in named_tests(TESTS / file).items():
            title = name.removeprefix("test_").replace("_", " ")
            yield f"- {title}" + (f": {about}" if about else "")
        yield ""
    for title, table in (("Closed forms", CLOSED_FORMS), ("Defects of others", DEFECTS)):
        yield f"## {title}"
        yield ""
        yield "| what | tests, below `tests` |"
        yield "|---|---|"
        for what, tests in table.items():
            found = "<br>".join(f"`{place}`" for name in tests for place in places(name))
            yield f"| {what} | {found} |"
        yield ""


def render(cell: Callable[[Operator, Contract], str]) -> str:
    return "\n".join(lines(cell)).rstrip() + "\n"


if __name__ == "__main__":
    torch.set_num_threads(1)
    PAGE.write_text(render(measured))
    sys.stdout.write(f"{len(OPERATORS)} operators, {len(CONTRACTS)} contracts: {PAGE}\n")
