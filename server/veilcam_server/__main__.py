"""``python -m veilcam_server`` is ``veilcamd``."""

from veilcam_server.cli import main

if __name__ == "__main__":
    main()
