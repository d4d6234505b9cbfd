"""The wire contract of bundles: what is installed, and which one is in use."""

from __future__ import annotations

from datetime import datetime

from veilcam_client.wire.base import EXAMPLE_DIGEST, EXAMPLE_TIME, Answer

BUNDLE_MEDIA_TYPE = "application/vnd.veilcam.bundle"


class CardFinding(Answer):
    """One row of a privacy card."""

    threat: str
    """``T0`` to ``T9``: see docs/privacy-card.md."""
    outcome: str
    """``PASS``, ``FAIL`` or ``NOT CLAIMED``."""
    figure: float
    """Result of the worst attacker, in ``unit``."""
    end: float
    """End of the figure's one-sided interval, in ``unit``."""
    unit: str
    """Unit of figure and end."""


class CardSummary(Answer):
    """Card of a bundle: results of attacks on it, as its maker states them."""

    outcome: str
    """``PASS``: all that is claimed held; ``FAIL``; ``NOT CLAIMED``: nothing is claimed; ``VOID``:
    the attacks failed even with the key, so that no row says anything."""
    mode: str
    """The masks that were attacked: ``fresh``, ``random``, or ``pairs`` and their number."""
    form: str
    """Form of embeddings of the attacked camera."""
    quick: bool
    """Few masks and light attackers."""
    made_at: datetime
    """Time of the attacks."""
    rows: tuple[CardFinding, ...]
    """One row for each threat."""


class MaskHiding(Answer):
    """Figures of what a bundle's masks hide, as its maker measured it without a key."""

    visible: bool
    """True: a mask shows pictures of the scene to an eye."""
    found: tuple[str, ...]
    """A sentence for each attacker: eye, machine with candidates, machine with the task."""


class BundleInfo(Answer):
    """Bundle of masks and classifiers, without its secrets."""

    digest: str
    """SHA-256 of the file."""
    task: str
    """Name of the task, as ``mnist``."""
    mode: str
    """``pairs``: stored masks; ``fresh``: a new one for every epoch, drawn from a key."""
    labels: tuple[str, ...]
    """Labels that its classifiers tell."""
    embedding_shape: tuple[int, ...]
    """Shape of an embedding: rows and columns, or channels before them."""
    pairs: int
    """Stored masks; 0 in mode ``fresh``."""
    version: int = 0
    """Version that its owner chose, from 1 on; 0: none."""
    signed_by: str | None = None
    """First digits of the SHA-256 of its owner's key; None for one that is not signed."""
    card: CardSummary | None = None
    """Its privacy card; None where it has none, or one of other masks."""
    hiding: MaskHiding | None = None
    """Figures of what its masks hide; None: nobody measured them."""


class InstalledBundle(Answer):
    """One bundle that the daemon can use, without its secrets."""

    digest: str
    """SHA-256 of the file: its name."""
    size: int
    """Size of its file [bytes]."""
    active: bool
    """True: masks and classifiers come from it."""
    configured: bool
    """True: the daemon was started with it, and it cannot be removed."""
    bundle: BundleInfo | None = None
    """Content; None for a file that was damaged on the disk."""


class InstalledBundles(Answer):
    """All of them."""

    bundles: tuple[InstalledBundle, ...]
    """Every bundle on the daemon's disk."""


def example_bundle() -> BundleInfo:
    """Return a BundleInfo for documents."""
    return BundleInfo(
        digest=EXAMPLE_DIGEST,
        task="mnist",
        mode="pairs",
        labels=("0", "1"),
        embedding_shape=(2, 3),
        pairs=6,
        version=4,
        signed_by="3a6eb0790f39",
        card=CardSummary(
            outcome="PASS",
            mode="pairs6",
            form="sealed",
            quick=False,
            made_at=EXAMPLE_TIME,
            rows=(
                CardFinding(threat="T0", outcome="PASS", figure=94.1, end=92.8, unit="%"),
                CardFinding(threat="T1", outcome="PASS", figure=0.2, end=0.8, unit="points"),
            ),
        ),
        hiding=MaskHiding(
            visible=False,
            found=(
                "An eye sees pictures of the scene: no (3 % of scenes picked out of 100; "
                "4 % behind random masks, 98 % behind a pinhole).",
            ),
        ),
    )


def _bundle() -> InstalledBundle:
    return InstalledBundle(
        digest=EXAMPLE_DIGEST, size=48_213, active=True, configured=False, bundle=example_bundle()
    )


def examples() -> tuple[Answer, ...]:
    """Return examples for documents."""
    return (_bundle(), InstalledBundles(bundles=(_bundle(),)))
