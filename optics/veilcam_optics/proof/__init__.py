"""Proof of the mask: whether a capture was taken behind the mask that it names.

Light that passed a mask bears its spectrum, whatever the scene and wherever the light comes from.
Every capture is compared with the mask that it names, with other states of the panel, and with
masks that are certainly not there: these say how far chance goes in this very capture.
"""

from veilcam_optics.proof.finding import Alternative, Finding, Verdict
from veilcam_optics.proof.mask_test import PROOF, MaskTest, MaskTests

__all__ = ["PROOF", "Alternative", "Finding", "MaskTest", "MaskTests", "Verdict"]
