"""The operating system: systemd, sockets, logs."""
