"""Bridge from one camera to a house: MQTT as Home Assistant has it, and webhooks."""
