"""The Debian package in a root of its own: installed, upgraded, gone back from, removed."""
