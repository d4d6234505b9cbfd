"""What a lensless camera does to light: geometry, masks, propagation, transfer operator, plans.

from veilcam_optics import Camera, Embedding, Scene, plan

chosen = plan(Camera(), Scene(), Embedding(24, 32), tolerance=1e-2)
print(chosen.explain())
"""

from veilcam_optics.camera.geometry import Camera, Embedding, Panel, Scene, Sensor, Window
from veilcam_optics.errors import OpticsError

try:
    from veilcam_optics.camera.imperfections import Conditions, Imperfections
    from veilcam_optics.camera.masks import quantise, random_mask, to_levels, to_weights
    from veilcam_optics.plan import Plan, plan
    from veilcam_optics.sensor.noise import shot_noise
    from veilcam_optics.transfer.grid import GridLight
    from veilcam_optics.transfer.operator import Reach, TransferOperator, Variables
except ModuleNotFoundError as missing:
    # What a device computes in NumPy is imported from its own modules.
    if missing.name != "torch":
        raise

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
