"""The command line ``veilcam``."""
