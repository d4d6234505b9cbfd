"""A data set that is read from disk once, for many fits."""

from __future__ import annotations

from collections.abc import Mapping

from veilcam_optics.camera.geometry import Scene
from veilcam_training.data.images import Images, Source


class ReadOnce:
    """A data set that is read from disk once, for the many cells that use it."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self._training: Images | None = None
        self._test: Images | None = None
        self._digests: Mapping[str, str] | None = None

    @property
    def name(self) -> str:
        """As the source's."""
        return self._source.name

    @property
    def labels(self) -> tuple[str, ...]:
        """As the source's."""
        return self._source.labels

    @property
    def colour(self) -> bool:
        """As the source's."""
        return self._source.colour

    @property
    def scene(self) -> Scene:
        """As the source's."""
        return self._source.scene

    def training(self) -> Images:
        """As the source's."""
        if self._training is None:
            self._training = self._source.training()
        return self._training

    def test(self) -> Images:
        """As the source's."""
        if self._test is None:
            self._test = self._source.test()
        return self._test

    def digests(self) -> Mapping[str, str]:
        """As the source's."""
        if self._digests is None:
            self._digests = self._source.digests()
        return self._digests
