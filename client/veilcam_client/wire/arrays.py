"""Answers that are arrays, and their place in JSON.

NumPy is loaded with the first array: who asks for labels needs none.
"""

from __future__ import annotations

import base64
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

from veilcam_client.wire.base import Answer

if TYPE_CHECKING:
    import numpy.typing as npt
    from pydantic import GetCoreSchemaHandler  # loads what makes JSON schemas
    from pydantic_core import CoreSchema

    from veilcam_client.numbers import Float32


class _AsList:
    """A flat array of float32 that is a list of numbers in JSON, and is not written to."""

    @classmethod
    def __get_pydantic_core_schema__(
        cls, source: object, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        from veilcam_client import numbers  # noqa: PLC0415

        return numbers.list_schema(handler.generate_schema(tuple[float, ...]))


if TYPE_CHECKING:
    Float32List: TypeAlias = Annotated[Float32, _AsList]
else:
    Float32List = Annotated[Any, _AsList]


class ArrayAnswer(Answer):
    """An answer that ``np.asarray`` takes."""

    def array(self) -> Float32:
        """Return the array, not to be written to."""
        raise NotImplementedError

    def __array__(
        self, dtype: npt.DTypeLike | None = None, copy: bool | None = None
    ) -> npt.NDArray[Any]:
        from veilcam_client import numbers  # noqa: PLC0415

        return numbers.converted(self.array(), dtype, copy)

    if not TYPE_CHECKING:  # no more than pydantic's own, which would make every name an attribute

        def __getattr__(self, name: str) -> Any:
            # np.asarray asks for two protocols before __array__, which pydantic searches long for.
            if name.startswith("__array_"):
                raise AttributeError(name)
            return super().__getattr__(name)


class PicturedArray(ArrayAnswer):
    """An array with a length, an index and a picture."""

    def __len__(self) -> int:
        return len(self.array())

    def __getitem__(self, key: Any) -> Any:
        return self.__array__()[key]

    def __iter__(self) -> Iterator[Any]:  # type: ignore[override]  # fields are no rows
        return iter(self.__array__())

    def _repr_png_(self) -> bytes:
        """As Jupyter shows it: the smallest value black, the largest white."""
        from veilcam_client import numbers  # noqa: PLC0415

        return numbers.picture(self.array())

    def _repr_html_(self) -> str:
        """As Jupyter shows it where it can."""
        shape = " × ".join(str(each) for each in self.array().shape)
        source = base64.b64encode(self._repr_png_()).decode()
        return f'<img alt="embedding, {shape}" src="data:image/png;base64,{source}">'
