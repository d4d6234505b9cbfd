"""The container of a simulated daemon: built, started and asked."""
