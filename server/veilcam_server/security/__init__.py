"""Security: callers, their scopes and limits, and the log."""
