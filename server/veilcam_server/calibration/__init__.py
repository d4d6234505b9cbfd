"""The camera measured with itself: what panel, sensor and their distance really are."""
