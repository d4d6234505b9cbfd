"""Bundle loading: checks a bundle against the camera, and opens the source of its masks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from veilcam_client.wire.bundles import BundleInfo, CardFinding, CardSummary, MaskHiding
from veilcam_client.wire.rotation import EveryCaptures, RotationOff, RotationPolicy
from veilcam_client.wire.sealing import Release
from veilcam_client.wire.status import Device
from veilcam_optics.camera.imperfections import NOMINAL, Imperfections
from veilcam_server.bundles.hiding import HidingCheck
from veilcam_server.bundles.owners import Owners
from veilcam_server.bundles.store import BundleStore
from veilcam_server.errors import (
    BundleOlderError,
    BundleRefusedError,
    StartError,
    UnknownBundleError,
)
from veilcam_server.masks.fresh import FreshSource
from veilcam_server.masks.pairs import load_pairs
from veilcam_server.masks.source import MaskSource, Terms
from veilcam_server.sealing.receivers import ReceiverStore
from veilcam_server.settings import MANY, Settings
from veilcam_server.system.state_file import Report
from veilcam_training.bundle import Bundle, BundleError, PrivacyCard, read_bundle, sentences


@dataclass(frozen=True, slots=True)
class Identity:
    """Facts that the daemon tells of itself; only the bundle changes while it runs."""

    device: Device
    bundle: BundleInfo
    experiment: str | None = None


def bundle_info(bundle: Bundle) -> BundleInfo:
    """Return the public facts of a bundle."""
    record = bundle.valid_hiding
    return BundleInfo(
        digest=bundle.digest,
        task=bundle.task,
        mode=bundle.mode,
        labels=bundle.labels,
        embedding_shape=bundle.measurement_shape,
        pairs=len(bundle.pairs),
        version=bundle.version,
        signed_by=None if bundle.owner is None else bundle.owner.short,
        card=None if bundle.card is None else _summary(bundle.card),
        hiding=None
        if record is None
        else MaskHiding(visible=record.visible, found=sentences(record)),
    )


def _summary(card: PrivacyCard) -> CardSummary:
    rows = tuple(
        CardFinding(
            threat=row.threat, outcome=row.outcome, figure=row.figure, end=row.end, unit=row.unit
        )
        for row in card.rows
    )
    return CardSummary(
        outcome=card.outcome,
        mode=card.mode,
        form=card.form,
        quick=card.quick,
        made_at=card.made_at,
        rows=rows,
    )


def open_source(
    settings: Settings, bundle: Bundle, imperfections: Imperfections = NOMINAL
) -> MaskSource:
    """Return what gives masks and their readers.

    Args:
        settings: checked.
        bundle: bundle to serve.
        imperfections: imperfections that decoders are prepared for. Stored pairs have none: their
            classifiers learned the nominal camera.

    Raises:
        StartError: the bundle cannot be served as it is.
    """
    if bundle.mode == "fresh":
        return FreshSource(
            bundle, wrong_decoder=settings.wrong_classifier, imperfections=imperfections
        )
    return load_pairs(bundle, wrong_classifier=settings.wrong_classifier)


def release_terms(settings: Settings, receivers: ReceiverStore) -> Callable[[], Terms]:
    """Return what tells the terms of an epoch that is prepared now.

    Unless it is said, embeddings leave sealed as soon as a receiver is paired, and else not at all.

    Args:
        settings: checked.
        receivers: receivers of this device.

    Raises:
        StartError: raw without a budget.
    """
    if settings.release == "raw" and settings.raw_budget < 1:
        raise StartError(
            "--release raw lets a mask be found out from what leaves behind it: say with "
            "--raw-budget N how many embeddings may leave behind one mask, or use sealed"
        )

    def terms() -> Terms:
        keys = receivers.keys
        default: Release = "sealed" if keys or receivers.lost else "none"
        return Terms(settings.release or default, keys)

    return terms


def rotation_policy(settings: Settings, bundle: Bundle) -> RotationPolicy:
    """Return when masks change.

    Unless it is said, fresh ones after every capture and stored ones after ``MANY``. A lone one
    cannot: behind it a simulated camera sees nobody, and a real one is told to go on.

    Raises:
        StartError: a real camera has a lone mask, and was not told.
    """
    if settings.rotation is not None:
        return settings.rotation
    if bundle.mode == "fresh":
        return EveryCaptures(captures=1)
    if len(bundle.pairs) > 1:
        return EveryCaptures(captures=MANY)
    if settings.device == "simulated":
        return RotationOff()
    raise StartError(
        "this bundle holds one mask only, which never changes: serve one with two or more, or say "
        "that you want it with --rotation-off"
    )


@dataclass(frozen=True, slots=True)
class LoadedBundle:
    """A bundle that can be used: what may be told of it, and where its masks come from."""

    info: BundleInfo
    source: MaskSource = field(repr=False)


OpenSource = Callable[[Bundle], MaskSource]


class Opener:
    """Opens bundles for a camera that stands as it is.

    Args:
        configured: the bundle that the daemon was started with.
        open_source: makes a bundle's source of masks, or raises :class:`StartError`.
        owners: owners whose bundles are taken.
        check_hiding: check of a bundle's masks.
    """

    def __init__(
        self,
        configured: Bundle,
        open_source: OpenSource,
        owners: Owners | None = None,
        check_hiding: HidingCheck = HidingCheck(),  # noqa: B008 - it never changes
    ) -> None:
        self._configured, self._open_source = configured, open_source
        self.owners, self._check_hiding = owners or Owners(), check_hiding

    def with_source(self, open_source: OpenSource) -> Opener:
        """Return the same opener with another maker of mask sources."""
        return Opener(self._configured, open_source, self.owners, self._check_hiding)

    def read(self, path: Path) -> Bundle:
        """Read a bundle that fits this camera.

        Raises:
            BundleRefusedError: it is damaged, for another camera, or of another mode.
        """
        try:
            bundle = read_bundle(path)
        except BundleError as error:
            # Where the daemon keeps its files is nobody's business.
            reason = str(error).removeprefix(f"{path}: ")
            raise BundleRefusedError(f"this bundle cannot be used: {reason}") from None
        for name in ("mode", "camera", "scene", "embedding", "channels"):
            if getattr(bundle, name) != getattr(self._configured, name):
                raise BundleRefusedError(
                    f"this bundle is for another {name}: start the daemon with it, as --bundle"
                )
        return bundle

    def take(self, path: Path) -> Bundle:
        """Read a bundle that may be used; raises as :meth:`read` and :meth:`check`."""
        bundle = self.read(path)
        self.check(bundle)
        return bundle

    def check(self, bundle: Bundle) -> None:
        """Refuse a bundle that may not be used, though it fits.

        Raises:
            BundleRefusedError: no owner signed it, or its masks show pictures of the scene.
        """
        self.owners.check(bundle)
        self._check_hiding(bundle)

    def open(self, path: Path, digest: str) -> LoadedBundle:
        """Open the bundle of this digest; raises as :meth:`take`."""
        bundle = self.take(path)
        if bundle.digest != digest:
            raise BundleRefusedError("this bundle was changed on the disk: install it again")
        return self.load(bundle)

    def load(self, bundle: Bundle) -> LoadedBundle:
        """Open the source of a bundle's masks; raises :class:`BundleRefusedError`."""
        try:
            return LoadedBundle(bundle_info(bundle), self._open_source(bundle))
        except (StartError, BundleError) as error:
            raise BundleRefusedError(str(error)) from None


def last_good(
    store: BundleStore,
    opener: Opener,
    configured: Bundle,
    report: Report,
    *,
    allow_older: bool = False,
) -> LoadedBundle:
    """Open the bundle that was in use last and still can be.

    One that is older than what was in use is the last resort.

    Args:
        store: knows what was in use.
        opener: opener of bundles that may be used.
        configured: the bundle that the daemon was started with.
        report: takes why one cannot be used any more, or that it is older.
        allow_older: may be older than the one in use before.

    Raises:
        BundleRefusedError: the configured one cannot be used.
        BundleOlderError: the configured one is new to this daemon, and older.
    """
    opener.check(configured)
    older: list[LoadedBundle] = []
    for digest in store.candidates():
        try:
            if digest == store.configured:
                keys = opener.load(configured)
            else:
                keys = opener.open(store.path(digest), digest)
            said = opener.owners.check_version(keys.info, store.used, allow_older=allow_older)
        except BundleOlderError:
            if not store.goes_on:
                raise
            older.append(keys)
        except (UnknownBundleError, BundleRefusedError) as error:
            if digest == store.configured and not older:
                raise
            report(BundleRefusedError(f"bundle {digest[:12]} is not in use any more: {error}"))
        else:
            if said:
                report(_is_older(keys))
            return keys
    # There is one: the configured one was the last, and did not raise.
    report(_is_older(older[0]))
    return older[0]


def _is_older(keys: LoadedBundle) -> BundleOlderError:
    return BundleOlderError(
        f"bundle {keys.info.digest[:12]} of version {keys.info.version} is in use, which is older "
        "than the one before it"
    )
