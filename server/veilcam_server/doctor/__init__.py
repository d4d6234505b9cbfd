"""What a Raspberry Pi needs to serve the camera: what is missing, and how to get it."""

from veilcam_server.doctor.checkup import examine
from veilcam_server.doctor.finding import Finding
from veilcam_server.doctor.machine import Machine

__all__ = ["Finding", "Machine", "examine"]
