"""The command line ``veilcamd``."""
