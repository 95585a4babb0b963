"""Checks of arrays from callers: shape, type and finiteness, with messages that quote what was given."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import FacemimeError

FloatArray = NDArray[np.floating[Any]]
IntArray = NDArray[np.integer[Any]]


def as_points(
    values: ArrayLike,
    name: str,
    *,
    count: int | None = None,
    error: type[FacemimeError] = FacemimeError,
) -> FloatArray:
    """Convert to a contiguous (N, 3) array of floats.

    Raises `error`, with the name, if the shape is wrong, N is not `count`, or a value is NaN or infinite.
    """
    array: FloatArray = np.ascontiguousarray(values, dtype=np.float64)
    expected = f"({'N' if count is None else count}, 3)"
    if array.ndim != 2 or array.shape[1] != 3 or (count is not None and array.shape[0] != count):
        raise error(
            "{name} must have the shape {expected}; got {shape}.", name=name, expected=expected, shape=array.shape
        )
    if not np.isfinite(array).all():
        rows = np.flatnonzero(~np.isfinite(array).all(axis=1))
        raise error(
            "{name} must be finite; {rows} rows are not, first row {first}.", name=name, rows=len(rows), first=rows[0]
        )
    return array


_SAMPLED = 8
"""Step between the pixels that tell the range of a floating-point image."""
_BRIGHTEST = 1.5
"""Median of such an image above which its range is not 0 to 1, as one of 0 to 255 has 2 even in the dark."""


def as_image(frame: ArrayLike, name: str = "image") -> NDArray[np.uint8]:
    """Convert to a contiguous 8-bit grey (H, W) or BGR (H, W, 3) image.

    Alpha is dropped. 16-bit images are reduced to 8 bits. Floats are expected from 0 to 1; those that are not finite
    become black, and lights may exceed 1. Raises FacemimeError, with the name, if the shape, the type or the range is
    not that of an image, or it is empty.
    """
    image = np.asarray(frame)
    if image.ndim == 3 and image.shape[2] == 1:
        image = image[..., 0]
    if image.ndim == 3 and image.shape[2] == 4:
        image = image[..., :3]
    if image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] != 3) or image.size == 0:
        raise FacemimeError("{name} must be (H, W), (H, W, 3) or (H, W, 4); got {shape}.", name=name, shape=image.shape)
    if image.dtype == np.uint8:
        return np.ascontiguousarray(image)
    if image.dtype == np.uint16:
        return np.ascontiguousarray((image >> 8).astype(np.uint8))
    if np.issubdtype(image.dtype, np.floating):
        known = np.nan_to_num(image, posinf=0.0, neginf=0.0)
        usual = float(np.median(known[::_SAMPLED, ::_SAMPLED]))
        if usual > _BRIGHTEST:
            raise FacemimeError(
                "{name} must be float in 0..1; its median is {usual:.3g}. Divide it by 255.", name=name, usual=usual
            )
        return np.ascontiguousarray((np.clip(known, 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8))
    if image.dtype == np.bool_:
        return np.ascontiguousarray(image.astype(np.uint8) * 255)
    raise FacemimeError("{name} must be 8 or 16 bit, or float in 0..1; got {dtype}.", name=name, dtype=image.dtype)
