"""``python -m veilcam_server`` is ``veilcamd``."""

from veilcam_server.cli.main import main

if __name__ == "__main__":
    main()
