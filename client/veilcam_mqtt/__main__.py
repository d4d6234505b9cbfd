"""``python -m veilcam_mqtt`` is ``veilcam-mqtt``."""

from veilcam_client.entry_points import veilcam_mqtt

if __name__ == "__main__":
    veilcam_mqtt()
