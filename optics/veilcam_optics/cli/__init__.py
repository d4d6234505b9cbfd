"""The command line ``veilcam-optics``."""
