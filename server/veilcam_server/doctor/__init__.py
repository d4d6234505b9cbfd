"""What a Raspberry Pi needs to serve the camera: what is missing, and how to get it."""

from veilcam_server.doctor.checkup import Finding, examine
from veilcam_server.doctor.machine import Machine

__all__ = ["Finding", "Machine", "examine"]
