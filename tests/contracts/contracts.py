"""What every operator promises. Each contract measures how far an operator is from keeping it."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

from veilcam_optics.errors import OpticsError

from .setting import Bound, Operator, Setting

with warnings.catch_warnings():
    # Torch's own forward differentiation warns of torch's own scripting when it is first used.
    warnings.simplefilter("ignore", DeprecationWarning)
    torch.func.jvp(torch.sin, (torch.zeros(1),), (torch.ones(1),))

SIZES = ((5, 4), (6, 6), (1, 8), (7, 1), (1, 1))
"""Odd, even, 1 x N, N x 1, a single pixel, non-square."""

_WIDE, _NARROW = (
    frozenset({torch.float64, torch.complex128}),
    frozenset({torch.float32, torch.complex64, torch.float16, torch.bfloat16}),
)


@dataclass(frozen=True)
class Contract:
    """A promise with its tolerance."""

    name: str
    tolerance: float
    applies: Callable[[Operator], bool]
    measure: Callable[[Operator], float]


def relative(value: Tensor, reference: Tensor) -> float:
    """Relative L2 distance; 0 between two zeros."""
    value, reference = value.detach(), reference.detach()
    distance = float((value - reference).abs().double().norm())
    return distance / (float(reference.abs().double().norm()) or 1.0)


def dot(left: Tensor, right: Tensor) -> float:
    """Real part of the inner product: complex numbers count as pairs of reals."""
    return float((left.conj() * right).real.sum())


_PREPARED: dict[tuple[object, ...], Bound] = {}


def prepared(operator: Operator, setting: Setting) -> Bound:
    """The operator in a setting without variables, made once for several contracts."""
    assert not setting.variables
    key = (
        operator,
        *(getattr(setting, each.name) for each in fields(setting) if each.name != "variables"),
    )
    if key not in _PREPARED:
        if len(_PREPARED) > 200:  # contracts come operator by operator
            _PREPARED.clear()
        _PREPARED[key] = operator.bind(setting)
    return _PREPARED[key]


def linearity(operator: Operator) -> float:
    """A(0.3x + 0.6y) against 0.3 A x + 0.6 A y: an offset would show, and scenes stay scenes."""
    setting = Setting()
    bound = prepared(operator, setting)
    x, y = bound.sample(setting, 1), bound.sample(setting, 2)
    wanted = 0.3 * apply_one(operator, bound, x) + 0.6 * apply_one(operator, bound, y)
    return relative(apply_one(operator, bound, 0.3 * x + 0.6 * y), wanted)


def adjoint(operator: Operator) -> float:
    """The dot test <J u, v> = <u, J* v>: J by forward differentiation, J* by reverse."""
    worst = 0.0
    for rows, columns in SIZES:
        setting = Setting(rows, columns)
        bound = prepared(operator, setting)
        x, u = bound.sample(setting, 1), bound.sample(setting, 2)
        x.requires_grad_()
        y = apply_one(operator, bound, x)
        v = torch.rand(y.shape, generator=torch.Generator().manual_seed(3), dtype=y.dtype) + 0.5
        (back,) = torch.autograd.grad(y, x, v)
        if operator.linear:
            forward = apply_one(operator, bound, u)
        else:
            forward = torch.func.jvp(
                lambda w, bound=bound: apply_one(operator, bound, w), (x.detach(),), (u,)
            )[1]
        size = float(forward.norm() * v.norm())
        if size:
            worst = max(worst, abs(dot(forward, v) - dot(u, back)) / size)
    return worst


def input_gradient(operator: Operator) -> float:
    """The derivative along a direction by central differences, after torch's own gradcheck."""
    setting = Setting(rows=2, columns=3)
    bound = prepared(operator, setting)
    x = bound.sample(setting, 1).requires_grad_()

    def function(values: Tensor) -> Tensor:
        return apply_one(operator, bound, values)

    assert torch.autograd.gradcheck(function, (x,), fast_mode=True)
    return _directional(function, x, bound.sample(setting, 2))


def length_gradients(operator: Operator) -> float:
    """As the gradient of the input, for each length the operator may be differentiated by."""
    worst = 0.0
    for name in operator.quantities:
        base = Setting(rows=2, columns=3)
        x = operator.bind(base).sample(base, 1)

        def function(
            scale: Tensor, name: str = name, base: Setting = base, x: Tensor = x
        ) -> Tensor:
            variable = {name: base.length(name) * scale}
            return apply_one(operator, operator.bind(replace(base, variables=variable)), x)

        one = torch.ones((), dtype=torch.float64, requires_grad=True)
        # A length is a fraction of a wave: one part in a million of it turns phases by a milliturn.
        assert torch.autograd.gradcheck(
            function, (one,), eps=1e-7, atol=1e-5, rtol=1e-3, fast_mode=True
        )
        worst = max(worst, _directional(function, one, torch.ones_like(one), step=1e-6))
    return worst


def _directional(
    function: Callable[[Tensor], Tensor], at: Tensor, along: Tensor, step: float = 1e-4
) -> float:
    """Reverse differentiation against Richardson's extrapolation of central differences."""
    with torch.no_grad():
        wide, narrow = (
            (function(at + h * along) - function(at - h * along)) / (2 * h)
            for h in (2 * step, step)
        )
        difference = (4 * narrow - wide) / 3
    y = function(at)
    v = torch.rand(y.shape, generator=torch.Generator().manual_seed(4), dtype=y.dtype) + 0.5
    (gradient,) = torch.autograd.grad(y, at, v)
    return abs(dot(gradient, along) - dot(v, difference)) / (
        float(difference.norm() * v.norm()) or 1.0
    )


class _Types(TorchDispatchMode):  # type: ignore[no-untyped-call]
    """Collects the floating types of everything that is computed while it is active."""

    def __init__(self) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self.seen: set[torch.dtype] = set()

    def __torch_dispatch__(
        self,
        func: Any,
        types: Any,
        args: tuple[Any, ...] = (),
        kwargs: dict[str, Any] | None = None,
    ) -> Any:
        result = func(*args, **(kwargs or {}))
        for value in result if isinstance(result, (tuple, list)) else (result,):
            if isinstance(value, Tensor) and (value.is_floating_point() or value.is_complex()):
                self.seen.add(value.dtype)
        return result


def types_kept(operator: Operator) -> float:
    """The result has the type asked for, and nothing of another width was computed on the way.

    In float64 not even the preparation may narrow; otherwise it may be wider, not the application.
    """
    for dtype in operator.dtypes:
        setting = Setting(dtype=dtype)
        with _Types() as preparing:
            bound = operator.bind(setting)
        x = bound.sample(setting)
        with _Types() as applying:
            y = apply_one(operator, bound, x)
        assert y.dtype in (dtype, setting.complex_dtype), f"{dtype} became {y.dtype}"
        if dtype == torch.float64:
            narrow = (preparing.seen | applying.seen) & _NARROW
            assert not narrow, f"{narrow} under float64"
        else:
            wide = applying.seen & _WIDE
            assert not wide or operator.widens, f"{wide} while applying in {dtype}"
    return 0.0


def single_precision(operator: Operator) -> float:
    """The result in float32 against that in float64, for the same input."""
    results = []
    for dtype in (torch.float32, torch.float64):
        setting = Setting(dtype=dtype)
        bound = prepared(operator, setting)
        x = bound.sample(Setting(dtype=torch.float32))
        results.append(apply_one(operator, bound, x.to(bound.sample(setting).dtype)))
    return relative(*results)


def devices_kept(operator: Operator) -> float:
    """What lies on a device stays there, and means the same."""
    names = ["cpu"] + ["cuda"] * torch.cuda.is_available() + ["meta"] * operator.meta
    home = Setting()
    wanted = apply_one(operator, prepared(operator, home), prepared(operator, home).sample(home))
    worst = 0.0
    for name in names:
        setting = Setting(device=torch.device(name))
        bound = prepared(operator, setting)
        y = apply_one(operator, bound, bound.sample(setting))
        assert y.device.type == name
        assert y.shape == wanted.shape
        if name != "meta" and not operator.random:
            worst = max(worst, relative(y.cpu(), wanted))
    return worst


def sizes_and_mirror(operator: Operator) -> float:
    """Shapes and finiteness at every size; a mirrored input gives the mirrored output."""
    worst = 0.0
    for rows, columns in SIZES:
        setting = Setting(rows, columns)
        bound = prepared(operator, setting)
        x = bound.sample(setting)
        y = apply_one(operator, bound, x)
        assert tuple(y.shape) == bound.result, f"{tuple(y.shape)} instead of {bound.result}"
        assert bool(torch.isfinite(torch.view_as_real(y) if y.is_complex() else y).all())
        for axis, axes in zip((-2, -1), operator.mirror, strict=True):
            if axes:
                worst = max(worst, relative(apply_one(operator, bound, x.flip(axis)), y.flip(axes)))
    return worst


def batch_and_loop(operator: Operator) -> float:
    """A batch equals its elements one by one; an empty batch gives an empty result."""
    setting = Setting()
    bound = prepared(operator, setting)
    batch = bound.sample(setting, batch=(11,))
    together = bound.apply(batch)
    one_by_one = torch.cat([bound.apply(batch[i : i + 1]) for i in range(11)])
    assert bound.apply(batch[:0]).shape == (0, *bound.result)
    return relative(together, one_by_one)


def input_untouched(operator: Operator) -> float:
    """The input is neither written to nor returned for others to write to."""
    for dtype in operator.dtypes:
        setting = Setting(dtype=dtype)
        bound = prepared(operator, setting)
        x = bound.sample(setting)
        before, version = x.clone(), x._version
        apply_one(operator, bound, x)
        assert x._version == version
        assert torch.equal(x, before)
    return 0.0


def repeatable(operator: Operator) -> float:
    """Made twice, applied twice, also after another input: the same bits."""
    for dtype in operator.dtypes:
        setting = Setting(dtype=dtype)
        bound = operator.bind(setting)
        x = bound.sample(setting, 1)
        first = apply_one(operator, bound, x)
        apply_one(operator, bound, bound.sample(setting, 2))
        assert torch.equal(first, apply_one(operator, bound, x)), "applying it twice"
        assert torch.equal(first, apply_one(operator, operator.bind(setting), x)), "making it twice"
    return 0.0


def shapes_refused(operator: Operator) -> float:
    """An input of another shape is an error that names it, not a broadcast."""
    setting = Setting()
    bound = prepared(operator, setting)
    for shape in ((bound.shape[-2] + 1, bound.shape[-1]), (bound.shape[-2], bound.shape[-1] + 2)):
        wrong = replace(bound, shape=(*bound.shape[:-2], *shape)).sample(setting)
        with pytest.raises(OpticsError, match=r"\.shape = "):
            apply_one(operator, bound, wrong)
    return 0.0


def apply_one(operator: Operator, bound: Bound, x: Tensor) -> Tensor:
    """The operator applied to a single input."""
    return bound.apply(x[None])[0] if operator.batched else bound.apply(x)


def _always(operator: Operator) -> bool:
    return True


CONTRACTS: tuple[Contract, ...] = (
    Contract("linear", 1e-13, lambda o: o.linear, linearity),
    Contract("adjoint", 1e-12, lambda o: o.smooth and o.forward, adjoint),
    Contract("input gradient", 1e-8, lambda o: o.smooth, input_gradient),
    Contract("length gradients", 1e-6, lambda o: bool(o.quantities), length_gradients),
    Contract("type kept", 0.0, _always, types_kept),
    Contract(
        "float32", 2e-6, lambda o: torch.float32 in o.dtypes and not o.random, single_precision
    ),
    Contract("device kept", 1e-12, _always, devices_kept),
    Contract("sizes, mirror", 1e-10, _always, sizes_and_mirror),
    Contract("batch = loop", 1e-12, lambda o: o.batched, batch_and_loop),
    Contract("input untouched", 0.0, _always, input_untouched),
    Contract("repeatable", 0.0, _always, repeatable),
    Contract("shape refused", 0.0, lambda o: o.refuses, shapes_refused),
)
