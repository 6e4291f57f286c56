"""Arrays on the wire: ``{dtype, shape, data}``, little-endian in C order; base64 text in JSON."""

import base64
import binascii
import math
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PlainSerializer, WithJsonSchema, model_validator

DType = Literal["float32", "float64", "bool"]


def _to_bytes(value: object) -> object:
    if not isinstance(value, str):
        return value
    try:
        return base64.b64decode(value, validate=True)
    except (binascii.Error, ValueError) as error:
        raise ValueError(f"expected bytes, in JSON as base64, got text that is not: {error}") from None


def _to_text(value: bytes) -> str:
    return base64.b64encode(value).decode("ascii")


Data = Annotated[
    bytes,
    BeforeValidator(_to_bytes),
    PlainSerializer(_to_text, return_type=str, when_used="json"),
    WithJsonSchema({"type": "string", "contentEncoding": "base64", "description": "bin in MessagePack"}),
]


class Array(BaseModel):
    """A dense array; ``data`` holds exactly the elements that ``shape`` names."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    dtype: DType
    shape: tuple[Annotated[int, Field(ge=1)], ...] = Field(min_length=1, max_length=4)
    data: Data

    @model_validator(mode="after")
    def _size_fits(self) -> Self:
        expected = math.prod(self.shape) * np.dtype(self.dtype).itemsize
        if len(self.data) != expected:
            raise ValueError(
                f"expected {expected} bytes of data for shape {self.shape} and {self.dtype}, got {len(self.data)}"
            )
        return self

    @classmethod
    def of(cls, values: NDArray[Any]) -> Self:
        """Return ``values`` as a message; numbers that are not float32 or bool become float64."""
        dtype: DType = "float32" if values.dtype == np.float32 else "bool" if values.dtype == np.bool_ else "float64"
        little = np.ascontiguousarray(values, np.dtype(dtype).newbyteorder("<"))
        return cls.model_construct(dtype=dtype, shape=values.shape, data=little.tobytes())

    def values(self) -> NDArray[Any]:
        """Return the elements as a read-only array that shares this message's memory."""
        return np.frombuffer(self.data, np.dtype(self.dtype).newbyteorder("<")).reshape(self.shape)
