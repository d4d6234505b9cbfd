"""Pages of other sites in a real browser, and what they can make the daemon do: nothing."""
