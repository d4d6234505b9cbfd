"""Files of ``veilcam-train export``: classifiers as ONNX and safetensors, and a model card.

Masks stay in the bundle. A classifier of a stored pair tells of its mask all the same, so every
file is its owner's alone.
"""

import json
import math
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import NormalDist

import numpy as np
import safetensors.numpy
import torch

from veilcam_optics.files import write_whole
from veilcam_training.bundle import Accuracy, Bundle, Fresh, Pair, sentences
from veilcam_training.errors import TrainingError
from veilcam_training.models.network import build_classifier

CARD = "model-card.md"
CONFIDENCE = 0.95
OPSET = 18
"""The first one that torch's exporter writes."""
INPUT, OUTPUT = "measurement", "logits"


def export_bundle(bundle: Bundle, folder: Path, command: str) -> tuple[Path, ...]:
    """Write every classifier of a bundle, and the card of all of them.

    Args:
        bundle: read from its file.
        folder: made if it is not there.
        command: command of the export, for the card.

    Returns:
        The files that were written.

    Raises:
        TrainingError: onnx is not installed, or the folder cannot be written to.
    """
    contents: dict[str, bytes] = {}
    for name, reader in _readers(bundle):
        contents[f"{name}.onnx"] = onnx_model(
            build_classifier(reader.layers, reader.weights), bundle.inputs, bundle.labels
        )
        described = {
            "format": "veilcam-classifier",
            "bundle": bundle.digest,
            "labels": json.dumps(bundle.labels),
            "layers": json.dumps([layer.model_dump(mode="json") for layer in reader.layers]),
        }
        weights = {each: np.asarray(array, order="C") for each, array in reader.weights.items()}
        contents[f"{name}.safetensors"] = safetensors.numpy.save(weights, metadata=described)
    contents[CARD] = model_card(bundle, tuple(contents), command).encode()
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        for name, content in contents.items():
            write_whole(folder / name, content, private=True)
    except OSError as error:
        raise TrainingError(f"{folder} cannot be written to ({error.strerror})") from None
    return tuple(folder / name for name in contents)


def onnx_model(classifier: torch.nn.Module, inputs: int, labels: Sequence[str]) -> bytes:
    """Return the file of an ONNX model from (batch, inputs) float32 to logits (batch, labels).

    Its metadata hold the labels, one a line, and nothing of this machine.

    Args:
        classifier: classifier in evaluation mode.
        inputs: number of values that it takes.
        labels: labels in the order of the logits.

    Raises:
        TrainingError: the packages of the extra ``export`` are not installed.
    """
    try:
        import onnx  # noqa: PLC0415 - of an extra, as the next
        import onnxscript  # noqa: F401, PLC0415 - torch wants it
    except ModuleNotFoundError:
        raise TrainingError(
            "ONNX files need the extra 'export': run pip install -e '.[export]' in the checkout"
        ) from None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the exporter's own packages
        program = torch.onnx.export(
            classifier,
            (torch.zeros(2, inputs),),
            input_names=[INPUT],
            output_names=[OUTPUT],
            opset_version=OPSET,
            dynamic_shapes=({0: torch.export.Dim("batch")},),
            verbose=False,
        )
    assert program is not None  # noqa: S101 - for mypy: it is None where a file is asked for
    model = program.model_proto
    for part in (model.graph, *model.graph.node, *model.graph.value_info):
        part.ClearField("metadata_props")  # paths of source files
    onnx.helper.set_model_props(model, {"labels": "\n".join(labels)})
    return bytes(model.SerializeToString(deterministic=True))


def _readers(bundle: Bundle) -> Iterator[tuple[str, Pair | Fresh]]:
    if bundle.fresh is not None:
        yield "classifier", bundle.fresh
    for number, pair in enumerate(bundle.pairs):
        yield f"classifier-{number}", pair


def accuracy_interval(accuracy: Accuracy) -> tuple[float, float]:
    """Wilson's interval of a share (E. B. Wilson, JASA 22, 1927), both ends in [0, 1]."""
    share, count = accuracy.value, accuracy.samples
    z = NormalDist().inv_cdf((1 + CONFIDENCE) / 2)
    middle = (share + z**2 / (2 * count)) / (1 + z**2 / count)
    half = z / (1 + z**2 / count) * math.sqrt(share * (1 - share) / count + (z / (2 * count)) ** 2)
    return max(0.0, middle - half), min(1.0, middle + half)


def model_card(bundle: Bundle, files: tuple[str, ...], command: str) -> str:
    """Return the facts about these classifiers that a person needs, in Markdown."""
    rows, columns = bundle.embedding.shape
    taken = (
        f"a measurement of {rows} x {columns}"
        + (", R, G, B one after the other" if bundle.channels == 3 else "")
        if bundle.fresh is None
        else f"the decoded scene, {bundle.scene.rows} x {bundle.scene.columns}"
    )
    sections = (
        ("Classifiers", _classifiers(bundle, files, taken)),
        ("Accuracy", _accuracy(bundle)),
        ("Data", _data(bundle)),
        ("Privacy", _privacy(bundle)),
        ("Made by", _made_by(bundle, command)),
    )
    text = "\n\n".join(f"## {title}\n\n" + "\n".join(lines) for title, lines in sections)
    return f"# {bundle.task}, {bundle.embedding}, mode {bundle.mode}\n\n{text}\n"


def _classifiers(bundle: Bundle, files: tuple[str, ...], taken: str) -> list[str]:
    masks = (
        "Masks come from keys that the camera draws; one classifier reads behind all."
        if bundle.fresh is not None
        else "Each reads behind one stored mask, which is in the bundle alone."
    )
    return [
        f"In: float32 (batch, {bundle.inputs}), {taken}, row by row. Out: logits "
        f"(batch, {len(bundle.labels)}) of {', '.join(bundle.labels)}.",
        masks,
        "",
        *(f"- `{name}`" for name in files),
    ]


def _accuracy(bundle: Bundle) -> list[str]:
    accuracy = bundle.accuracy
    if accuracy is None:
        return ["Not measured."]
    low, high = accuracy_interval(accuracy)
    mean = f", the mean of {len(bundle.pairs)} classifiers" if len(bundle.pairs) > 1 else ""
    return [
        f"{100 * accuracy.value:.2f} % ({100 * low:.2f} to {100 * high:.2f} % with a confidence of "
        f"{100 * CONFIDENCE:.0f} %) on {accuracy.test_set}, {accuracy.samples} samples{mean}. In "
        "simulation, unless it says measurements."
    ]


def _data(bundle: Bundle) -> list[str]:
    digests = bundle.provenance.get("data_sha256")
    if not isinstance(digests, dict) or not digests:
        return ["Not written down."]
    return [*(f"- `{name}`, SHA-256 `{digest}`" for name, digest in digests.items())]


def _privacy(bundle: Bundle) -> list[str]:
    record, card = bundle.valid_hiding, bundle.card
    found = [] if record is None else [*sentences(record), ""]
    if card is None:
        return [*found, "No privacy card: nothing is claimed of what embeddings tell."]
    quick = ", a quick look" if card.quick else ""
    return [
        *found,
        f"{card.outcome} for embeddings that leave {card.form}{quick}, {card.made_at:%Y-%m-%d}.",
        "",
        "| threat | outcome | figure | end of its interval |",
        "|---|---|---|---|",
        *(
            f"| {row.threat} {row.title} | {row.outcome} | {row.figure:g} {row.unit} "
            f"| {row.end:g} |"
            for row in card.rows
        ),
    ]


def _made_by(bundle: Bundle, command: str) -> list[str]:
    known = bundle.provenance
    lines = [
        f"- {what}: `{known[name]}`"
        for name, what in (("command", "trained"), ("commit", "commit"), ("date", "date"))
        if isinstance(known.get(name), str)
    ]
    adapted = known.get("adapted")
    if isinstance(adapted, dict):
        lines.append(
            f"- adapted: to {adapted.get('count')} measurements, from bundle "
            f"`{adapted.get('bundle')}`"
        )
    return [*lines, f"- exported: `{command}`, from bundle `{bundle.digest}`"]
