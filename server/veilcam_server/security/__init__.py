"""Security: callers, their scopes and limits, and the audit log."""
