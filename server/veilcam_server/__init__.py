"""The daemon ``veilcamd``: devices, bundle, rotation, capture, inference and the REST API."""
