"""The gate in front of uvicorn: who is let in, how long for, and who has to go for others."""
