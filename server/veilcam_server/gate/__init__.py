"""Gate in front of uvicorn: caps, deadlines and eviction of connections."""
