"""HTTP: requests, retries, credentials and event streams."""
