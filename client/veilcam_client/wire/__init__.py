"""Wire contract of the REST API: one model per answer and request."""
