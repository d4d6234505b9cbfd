"""Fixtures of the training's unit tests, for tests that fit."""

from tests.unit.training.conftest import *  # noqa: F403
