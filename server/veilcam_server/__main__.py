"""``python -m veilcam_server`` is ``veilcamd``."""

from veilcam_client.entry_points import veilcamd

if __name__ == "__main__":
    veilcamd()
