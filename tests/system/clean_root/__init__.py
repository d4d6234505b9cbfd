"""The README's commands in a root of Debian that has nothing but what the README asks for."""
