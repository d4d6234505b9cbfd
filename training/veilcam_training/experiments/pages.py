"""Pages that need no other file and nothing of the network."""

import base64
import io

from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape
from matplotlib.figure import Figure


def page(name: str, **values: object) -> str:
    """Return the page that a template of this room makes of ``values``; they are escaped.

    Args:
        name: name of the template, without its ``.html.jinja``.
        values: values and functions that the template names.
    """
    environment = Environment(
        loader=PackageLoader("veilcam_training.experiments"),
        autoescape=select_autoescape(("html.jinja",)),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(f"{name}.html.jinja").render(values)


def png(figure: Figure, dpi: int) -> bytes:
    """Return the file of a figure; the same figure gives the same bytes."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=dpi, facecolor="white", metadata={"Software": None})
    return stream.getvalue()


def embedded(picture: bytes) -> str:
    """Return a PNG as an address that holds it."""
    return "data:image/png;base64," + base64.b64encode(picture).decode()
