"""Privacy of a camera as it is set up: what each observer can learn from it."""

from __future__ import annotations

from veilcam_client.wire.privacy import Observer, Privacy
from veilcam_client.wire.sealing import Release
from veilcam_server.security.privacy_figures import FIGURES


def privacy_of(release: Release, *, beat: bool = True, full_scores: bool = False) -> Privacy:
    """Return what everybody can learn, each with the figure of the best attack that was tried.

    Args:
        release: form in which embeddings leave.
        beat: True: streams tell the state at every look, changed or not.
        full_scores: True: scores leave in full.
    """
    return Privacy(
        observers=(
            _listener(beat=beat),
            Observer(
                who="has a token that reads the status",
                learns="When captures are taken, who receives them, and faults; of what is there, "
                "no more than the figure.",
                measured=_auc("presence", FIGURES["status_presence_auc_upper"]),
                switch="`veilcam token revoke` ends a token",
            ),
            Observer(
                who="has a token for labels",
                learns="Each label, and with it who comes and goes.",
                measured=f"{100 * FIGURES['demo_accuracy']:.1f} % of the demo's digits are read "
                "right",
                switch="a token without the scope `classify`",
            ),
            _scores(full=full_scores),
            _receiver(release),
            Observer(
                who="has the SD card, or a backup",
                learns="No scene and no earlier capture; they can pose as the camera, and read the "
                "log and the masks that are stored in a bundle.",
                measured=f"{FIGURES['past_opened']:.0f} of 1,000 earlier captures opened",
                switch="`veilcamd wipe` before the card is given away",
            ),
            Observer(
                who="is root on the camera",
                learns="All that the sensor sees from then on: the fine frame before it is binned.",
                measured=f"{FIGURES['measurements_in_memory']:.0f} of 200 earlier measurements "
                "found in memory",
                switch="none: pull the plug",
            ),
            Observer(
                who="is in the room with the camera",
                learns="The mask that is shown, by a photograph of the panel; it opens nothing "
                "without a measurement.",
                measured=f"{100 * FIGURES['shipped_read']:.0f} % of digits read by a machine from "
                "measurements, even without the mask",
                switch="`--release none`: no measurement leaves",
            ),
        )
    )


def _listener(*, beat: bool) -> Observer:
    sizes = f"{FIGURES['listener_sizes_a_route']:.0f} size a route"
    learns = (
        "That the camera is in use. No size tells what is seen; times tell no more than the figure."
    )
    measured = f"{sizes}; " + _auc("arrivals", FIGURES["listener_presence_auc_upper"])
    switch = "`--beat off` saves bytes, and shows when something is seen"
    if not beat:
        learns = "That the camera is in use, and by an event at once that something is seen."
        measured = f"{sizes}; every arrival shows in a stream of events"
        switch = "`--beat on`"
    return Observer(
        who="is on the same network and listens", learns=learns, measured=measured, switch=switch
    )


def _scores(*, full: bool) -> Observer:
    name = "scores_full_identified_of_100" if full else "scores_identified_of_100"
    return Observer(
        who="has a token for scores, too",
        learns="How sure the classifier is, in full: as good as a fingerprint of the scene."
        if full
        else "How sure the classifier is, in tenths.",
        measured=f"{FIGURES[name]:.0f} of 100 scenes picked out of 100 of their label; 1 is a "
        "guess",
        switch="without `--full-scores`, tenths"
        if full
        else "`--full-scores` tells them in full: "
        f"{FIGURES['scores_full_identified_of_100']:.0f} of 100 picked out",
    )


def _receiver(release: Release) -> Observer:
    learns, measured, switch = {
        "none": (
            "Nothing: no embedding leaves.",
            "nothing leaves",
            "`--release sealed` lets receivers open captures",
        ),
        "sealed": (
            "Every capture while they are paired: a coarse picture, and the label.",
            f"{FIGURES['fresh_accuracy_sealed']:.1f} % of digits read",
            "`veilcam receiver remove`, from the next mask on; `--release none`",
        ),
        "raw": (
            "Nothing is sealed: whoever has a token for raw embeddings has every capture.",
            f"{FIGURES['keyless_accuracy_raw']:.0f} % of digits read without the mask",
            "`--release sealed`",
        ),
    }[release]
    return Observer(
        who="has a receiver's private key", learns=learns, measured=measured, switch=switch
    )


def _auc(what: str, upper: float) -> str:
    return f"{what} told with an AUC of at most {upper:.2f}; 0.5 is a guess"
