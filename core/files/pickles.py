"""Reading of pickles of arrays, such as FLAME's models, without executing anything that they name."""

from __future__ import annotations

import io
import pickle
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError
from ..numeric import linalg
from .reading import shown

_MAX_DENSE = 1 << 25
"""Largest number of elements of a sparse matrix that is made dense; FLAME's regressor of joints has 25,115."""


class _Kept:
    """Stands in for a sparse matrix of scipy, or an array of chumpy, and keeps only its state."""

    def __init__(self, *_: Any) -> None:
        self.state: Any = None

    def __setstate__(self, state: Any) -> None:
        self.state = state


def _made(kind: Any, *_: Any) -> _Kept:
    """Make a stand-in, as `copyreg` makes objects for old protocols."""
    if not (isinstance(kind, type) and issubclass(kind, _Kept)):
        raise DataError("it contains {name}, which is not an array", name=shown(str(kind)))
    return kind()


def _encoded(text: str, _: str = "") -> bytes:
    """Return the bytes that a pickle for Python 2 stores as text."""
    return text.encode("latin1")


class _Chumpy(_Kept):
    pass


class _Sparse(_Kept):
    pass


_SPARSE: dict[str, type[_Sparse]] = {
    name: type(name, (_Sparse,), {}) for name in ("csc_matrix", "csr_matrix", "coo_matrix")
}
_NAMED: dict[str, dict[str, Any]] = {
    "numpy": {
        "_reconstruct": np.zeros(0).__reduce__()[0],
        "scalar": np.float64(0.0).__reduce__()[0],
        "ndarray": np.ndarray,
        "dtype": np.dtype,
    },
    "scipy": dict(_SPARSE),
    "chumpy": {"Ch": _Chumpy},
    "builtins": {"set": set, "object": object},
    "copyreg": {"_reconstructor": _made},
    "_codecs": {"encode": _encoded},
}
"""What a pickle may name, by package; Python 2 had other names for two of them."""
_PYTHON_2 = {"__builtin__": "builtins", "copy_reg": "copyreg"}


class _Arrays(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        """Return what a pickle of arrays may name; anything else is refused before it is imported."""
        package = module.partition(".")[0]
        found = _NAMED.get(_PYTHON_2.get(package, package), {}).get(name)
        if found is None:
            raise DataError("it contains {name}, which is not an array", name=shown(f"{module}.{name}"))
        return found


def arrays_of_pickle(data: bytes) -> dict[str, NDArray[Any]]:
    """Return the arrays of numbers in a pickled dictionary, by name; sparse matrices become dense.

    The dictionary may be the only element of an array, as in `.npy` files.

    Raises ValueError if the pickle names anything but arrays, none of which is imported or called, or is damaged.
    """
    try:
        content = _Arrays(io.BytesIO(data), encoding="latin1").load()
        content = content.item() if isinstance(content, np.ndarray) else content
        arrays = {str(name): _array(value) for name, value in dict(content).items()}
    except DataError:
        raise
    except Exception as error:  # a damaged pickle can raise anything
        raise DataError("it is not an intact table of arrays") from error
    return {name: array for name, array in arrays.items() if array.dtype.kind in "biuf"}


def _array(value: Any) -> NDArray[Any]:
    if isinstance(value, _Chumpy) and isinstance(value.state, Mapping):
        value = value.state.get("x")
    if isinstance(value, _Sparse):
        return _dense(value)
    return value if isinstance(value, np.ndarray) else np.empty(0, dtype=object)


def _dense(kept: _Sparse) -> NDArray[Any]:
    """Return a sparse matrix as an array; raises ValueError if it is too large or its indices are out of range."""
    state, kind = kept.state, type(kept).__name__
    shape = tuple(int(count) for count in state["_shape"])
    if not 0 < int(np.prod(shape, dtype=object)) <= _MAX_DENSE:
        raise DataError("it has a matrix of the shape {shape}", shape=shape)
    places = (state["row"], state["col"]) if kind == "coo_matrix" else (state["indices"], state["indptr"])
    parts = (state["data"], places) if kind == "coo_matrix" else (state["data"], *places)
    matrix = getattr(linalg.part("sparse"), kind)(parts, shape)
    if kind != "coo_matrix":
        matrix.check_format(full_check=True)
    return np.asarray(matrix.toarray())
