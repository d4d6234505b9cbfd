"""Every operator of the optics, once. Adding one to its list puts it through every contract."""

from __future__ import annotations

from .light_operators import LIGHT
from .measurement_operators import MEASUREMENTS
from .setting import Operator
from .transfer_operators import TRANSFER
from .wave_operators import WAVES

OPERATORS: tuple[Operator, ...] = (*TRANSFER, *WAVES, *LIGHT, *MEASUREMENTS)
