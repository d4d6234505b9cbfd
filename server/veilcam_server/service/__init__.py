"""The camera for an event loop: queue, scheduler, events, and what the API answers."""
