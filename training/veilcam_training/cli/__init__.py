"""The command line ``veilcam-train``."""
