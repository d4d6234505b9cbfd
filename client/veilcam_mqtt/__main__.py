"""``python -m veilcam_mqtt`` is ``veilcam-mqtt``."""

from veilcam_mqtt.cli import main

if __name__ == "__main__":
    main()
