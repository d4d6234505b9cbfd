"""Optics of a lensless camera: geometry, masks, propagation, transfer operator, plans.

from veilcam_optics import Camera, Embedding, Scene, plan

chosen = plan(Camera(), Scene(), Embedding(24, 32), tolerance=1e-2)
print(chosen.explain())
"""

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from veilcam_optics.camera.geometry import Camera, Embedding, Panel, Scene, Sensor, Window
    from veilcam_optics.camera.imperfections import Conditions, Imperfections
    from veilcam_optics.camera.masks import quantise, random_mask, to_levels, to_weights
    from veilcam_optics.errors import OpticsError
    from veilcam_optics.plan import Plan, plan
    from veilcam_optics.sensor.noise import shot_noise
    from veilcam_optics.transfer.grid import GridLight
    from veilcam_optics.transfer.operator import TransferOperator
    from veilcam_optics.transfer.tables import Reach, Variables

_OWNERS = {
    "camera.geometry": ("Camera", "Embedding", "Panel", "Scene", "Sensor", "Window"),
    "camera.imperfections": ("Conditions", "Imperfections"),
    "camera.masks": ("quantise", "random_mask", "to_levels", "to_weights"),
    "errors": ("OpticsError",),
    "plan": ("Plan", "plan"),
    "sensor.noise": ("shot_noise",),
    "transfer.grid": ("GridLight",),
    "transfer.operator": ("TransferOperator",),
    "transfer.tables": ("Reach", "Variables"),
}
"""Modules of the public names, which are imported when a name is asked for (PEP 562): torch takes
seconds of a Raspberry Pi, and a device computes in NumPy, by modules of its own."""

__all__ = [
    "Camera",
    "Conditions",
    "Embedding",
    "GridLight",
    "Imperfections",
    "OpticsError",
    "Panel",
    "Plan",
    "Reach",
    "Scene",
    "Sensor",
    "TransferOperator",
    "Variables",
    "Window",
    "plan",
    "quantise",
    "random_mask",
    "shot_noise",
    "to_levels",
    "to_weights",
]


def __getattr__(name: str) -> object:
    for owner, names in _OWNERS.items():
        if name in names:
            return getattr(import_module(f"{__name__}.{owner}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


class _Package(ModuleType):
    """``plan`` is the function, although a subpackage has that name too."""

    @property
    def plan(self) -> object:
        return __getattr__("plan")

    @plan.setter
    def plan(self, _: ModuleType) -> None:
        """Whoever imports a subpackage has it put here."""


sys.modules[__name__].__class__ = _Package
