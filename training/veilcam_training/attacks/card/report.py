"""Card of a bundle: rows one after the other, each kept, all of them judged together."""

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from pydantic import ValidationError

from veilcam_optics.files import write_whole
from veilcam_training.attacks.card.faces import face_notes, load_faces
from veilcam_training.attacks.card.rows import ROWS
from veilcam_training.attacks.card.shots import Found
from veilcam_training.attacks.card.study import Plan, Study, Tell, parted
from veilcam_training.attacks.card.subject import make_subject
from veilcam_training.attacks.card.threats import (
    CLAIMED,
    PERCENT,
    THREATS,
    lower,
    outcome_of,
)
from veilcam_training.attacks.intervals import ALPHA, Gain, holm
from veilcam_training.bundle import Bundle, CardRow, Finding, PrivacyCard
from veilcam_training.data import Images
from veilcam_training.errors import TrainingError, require

STATISTICS = 3000
"""Pictures that attackers make scene statistics from, at most, where the bundle has none."""
_SAID = "said.json"


@dataclass(frozen=True)
class Work:
    """A folder of what was found, so that a card that was broken off goes on.

    Attributes:
        folder: made if it is not there; None keeps nothing.
        resume: True: go on with the results in it.
    """

    folder: Path | None
    resume: bool = False

    def begin(self, said: dict[str, object]) -> None:
        """Refuse a folder of another card, and one that is not to be resumed.

        Raises:
            TrainingError: it holds something, and is another card's or ``resume`` is not set.
        """
        if self.folder is None:
            return
        path, text = self.folder / _SAID, json.dumps(said)
        if path.exists():
            require(self.resume, f"{self.folder} holds a card that was begun: give --resume")
            require(
                path.read_text() == text, f"{self.folder} holds another card: use another folder"
            )
        self.folder.mkdir(parents=True, exist_ok=True)
        write_whole(path, text.encode(), private=True)

    def load(self, threat: str) -> tuple[Found, float] | None:
        """Return a finished row, and its processor time [s]."""
        path = self._path(threat)
        if path is None or not path.exists():
            return None
        try:
            content = json.loads(path.read_text())
            return Found.model_validate(content["found"]), float(content["seconds"])
        except (ValueError, KeyError, TypeError, ValidationError):
            raise TrainingError(f"{path} is damaged: remove it to attack {threat} again") from None

    def keep(self, found: Found, seconds: float) -> None:
        """Write a row, whole or not at all."""
        path = self._path(found.threat)
        if path is not None:
            content = {"found": found.model_dump(), "seconds": seconds}
            write_whole(path, json.dumps(content).encode(), private=True)

    def _path(self, threat: str) -> Path | None:
        return None if self.folder is None else self.folder / f"{threat}.json"


def make_card(
    bundle: Bundle,
    images: Images,
    *,
    mode: str | None = None,
    form: str | None = None,
    data: str,
    plan: Plan,
    seed: int,
    work: Work,
    tell: Tell,
    faces: Path | None = None,
) -> tuple[PrivacyCard, Study]:
    """Attack a camera in all ten ways.

    Args:
        bundle: bundle of the camera.
        images: before it, and with the attackers; gray, of the bundle's scenes and labels.
        mode: see :func:`make_subject`; None: what the bundle holds.
        form: form in which embeddings leave; None: sealed of fresh masks, raw of others.
        data: name of the data.
        plan: plan of the attacks.
        seed: seed of everything.
        work: folder of results, old and new.
        tell: is told of progress.
        faces: folder of drawn faces, for notes beside T8 and T9; None: without them.

    Returns:
        The card, and the study with its captures.

    Raises:
        TrainingError: pictures or a mode that do not go with the bundle, or work that is of another
            card or damaged.
    """
    require(bundle.channels == 1, "a colour bundle cannot be attacked: use a gray one")
    classes, labels = int(images.labels.max()) + 1, len(bundle.labels)
    require(
        classes <= labels,
        f"pictures have {classes} classes and the bundle {labels}: use the data of its training",
    )
    public = parted(images, seed)[0].scenes(slice(0, STATISTICS))
    subject = make_subject(bundle, public, mode=mode, form=form, seed=seed)
    work.begin(
        {
            "subject": bundle.subject,
            "mode": subject.mode,
            "form": subject.form,
            "data": data,
            "images": len(images),
            "plan": repr(plan),
            "seed": seed,
            "faces": faces is not None,
        }
    )
    study = Study(subject, images, plan, seed=seed, folder=work.folder, tell=tell)
    found, spent = [], 0.0
    for number, (threat, attack) in enumerate(ROWS.items()):
        known = work.load(threat)
        if known is None:
            begun = time.process_time()
            known = attack(study), time.process_time() - begun
            work.keep(*known)
        found.append(known[0])
        spent += known[1]
        tell("threats", number + 1, len(ROWS))
    if faces is not None:
        found = _with_notes(found, face_notes(study, load_faces(faces, bundle.scene)))
    rows = judge(found, subject.form, quick=plan.quick)
    card = PrivacyCard(
        subject=bundle.subject,
        mode=subject.mode,
        form=subject.form,
        quick=plan.quick,
        data=data,
        seed=seed,
        made_at=datetime.now(UTC),
        minutes=round(spent / 60, 2),
        rows=tuple(rows),
    )
    return card, study


def _with_notes(found: Sequence[Found], notes: Mapping[str, str]) -> list[Found]:
    return [
        each.model_copy(update={"notes": (*each.notes, notes[each.threat])})
        if each.threat in notes
        else each
        for each in found
    ]


def judge(found: Sequence[Found], form: str, *, quick: bool) -> list[CardRow]:
    """Rows with their outcome: those that are claimed share one error (Holm)."""
    gains = {each.threat: _with_bar(each, quick=quick) for each in found}
    claimed = {threat: gain for threat, gain in gains.items() if threat in CLAIMED[form]}
    verdicts = holm(claimed)
    rows = []
    for each in found:
        threat, gain, verdict = THREATS[each.threat], gains[each.threat], verdicts.get(each.threat)
        if each.threat == "T0":
            end = lower(gain, ALPHA)
        else:
            end = gain.upper(ALPHA) if verdict is None else verdict.upper
        rows.append(
            CardRow(
                threat=each.threat,
                title=threat.title,
                given=threat.given,
                attack=each.attack,
                metric=threat.metric,
                figure=_rounded(gain.value),
                end=_rounded(end),
                unit=threat.unit,
                chance=threat.chance,
                threshold=gain.bar,
                reason=threat.reason,
                samples=gain.count,
                masks=each.masks,
                outcome=outcome_of(each.threat, form, gain, verdict, ALPHA),
                others=tuple(
                    Finding(attack=name, figure=_rounded(value))
                    for name, value in each.others.items()
                ),
                notes=each.notes,
            )
        )
    return rows


def _with_bar(found: Found, *, quick: bool) -> Gain:
    threat = THREATS[found.threat]
    return replace(found.gain, bar=threat.quick if quick else threat.threshold)


def _rounded(value: float) -> float:
    return round(value, 4)


def figures_of(card: PrivacyCard) -> dict[str, float]:
    """Figures of a record: ``card_MODE_T0`` and so on, what each threshold is on.

    That of T0 is the lower end of its interval, that of a claimed row the upper end; of all others
    the figure itself.
    """
    figures = {}
    for row in card.rows:
        bound = row.unit == PERCENT or row.threat in CLAIMED[card.form]
        figures[f"card_{card.mode}_{row.threat}"] = row.end if bound else row.figure
    return figures
