"""The daemon ``veilcamd``: devices, keyring, rotation, capture, inference and the REST API."""
