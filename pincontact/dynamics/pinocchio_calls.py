"""Which of Pinocchio's algorithms an evaluation takes, and how kernels reach them.

A call through Pinocchio's Python module takes half a microsecond more than the algorithm itself, which for one body is
two thirds to three quarters of the whole: its arguments are converted every time. The library below that module exports
the same functions for the same vectors, and kernels call them by address, as C++ does. Where an installation does not
have them, or its objects do not lie in memory as is checked here, kernels call through Python, with the same numbers.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache
from typing import Any

import numba
import numpy as np
import pinocchio as pin

from ..workspace import address_of

# Names of Pinocchio 4's functions of (model, data, q, v), (model, data, q, v, a) and (model, data, q, convention) in
# its library, for vectors that are passed as Eigen::Ref.
_TERMS_OF_PLACES = (
    "_ZN9pinocchio4impl34computeJointJacobiansTimeVariationIdLi0ENS_25JointCollectionDefaultTplEN5Eigen3RefIKNS3_6Matr"
    "ixIdLin1ELi1ELi0ELin1ELi1EEELi0ENS3_11InnerStrideILi1EEEEESA_EERKNS_7DataTplIT_XT0_ET1_E8Matrix6xERKNS_8ModelTplIS"
    "C_XT0_ESD_EERSE_RKNS3_10MatrixBaseIT2_EERKNSN_IT3_EE"
)
_INVERSE_DYNAMICS = (
    "_ZN9pinocchio4impl4rneaIdLi0ENS_25JointCollectionDefaultTplEN5Eigen3RefIKNS3_6MatrixIdLin1ELi1ELi0ELin1ELi1EEELi0E"
    "NS3_11InnerStrideILi1EEEEESA_SA_EERKNS_7DataTplIT_XT0_ET1_E17TangentVectorTypeERKNS_8ModelTplISC_XT0_ESD_EERSE_RKN"
    "S3_10MatrixBaseIT2_EERKNSN_IT3_EERKNSN_IT4_EE"
)
_MASS_MATRIX = (
    "_ZN9pinocchio4crbaIdLi0ENS_25JointCollectionDefaultTplEN5Eigen3RefIKNS2_6MatrixIdLin1ELi1ELi0ELin1ELi1EEELi0ENS2_1"
    "1InnerStrideILi1EEEEEEERKNS_7DataTplIT_XT0_ET1_E8MatrixXsERKNS_8ModelTplISB_XT0_ESC_EERSD_RKNS2_10MatrixBaseIT2_EE"
    "NS_10ConventionE"
)
# Integers with which a model begins, and pointers among the first ones of a data object to its arrays' first elements.
_FIRST_INTEGERS = ("nq", "nv", "nvExtended", "njoints", "nbodies", "nframes")
_POINTERS = 64
_WORD = ctypes.sizeof(ctypes.c_size_t)
# Where a Python object of Boost.Python has the address of what holds its C++ object, and where that is from there.
_HOLDER, _HELD = object.__basicsize__ + 3 * _WORD, 2 * _WORD

# A row for `call_by_address`: a function and its five arguments, of which it takes the first ones.
NATIVE_COLUMNS = 6
# Rows of `PinocchioCalls.native`.
NATIVE_ROWS = 3

Call = tuple[Callable[..., Any], tuple[Any, ...]]


class PinocchioCalls:
    """What fills `data` at (q, v), arrays of constant addresses.

    algorithms: calls for mass matrix, bias forces, Jacobians, poses, velocities and bias accelerations; placing: the
    one for Jacobians, poses and velocities alone; native: (NATIVE_ROWS, NATIVE_COLUMNS) int, two rows that do what
    `algorithms` do and one for `placing`, or None; model_words: the two words, nq and nv, nvExtended and njoints, with
    which the model begins, as these rows were made for; bias_forces (nv,): where they are found.
    """

    def __init__(self, model: pin.Model, data: pin.Data, q: np.ndarray, v: np.ndarray) -> None:
        rest = np.zeros(model.nv)
        # in the world's convention the mass matrix comes with the Jacobians; at rest inverse dynamics are bias forces
        self.algorithms: list[Call] = [
            (pin.rnea, (model, data, q, v, rest)),
            (pin.crba, (model, data, q, pin.Convention.WORLD)),
        ]
        self.placing: Call = (pin.computeJointJacobiansTimeVariation, (model, data, q, v))
        # one call, so that every part of data has its final size before an address is taken
        for function, arguments in self.algorithms:
            function(*arguments)
        self.bias_forces = data.tau
        # kept alive: their addresses are known to kernels
        self._rest, self._vectors = rest, [_as_ref(array) for array in (q, v, rest)]
        self.native = _native_calls(model, data, self._vectors)
        self.model_words = (0, 0) if self.native is None else _words_at(int(self.native[0, 1]))


def _native_calls(model: pin.Model, data: pin.Data, vectors: list[np.ndarray]) -> np.ndarray | None:
    """See `PinocchioCalls.native`; vectors: q, v and an acceleration of zero, as `_as_ref` gives them."""
    return _rows(model, data, vectors) if not numba.config.DISABLE_JIT and _agrees() else None


def _rows(model: pin.Model, data: pin.Data, vectors: list[np.ndarray]) -> np.ndarray | None:
    functions = _functions()
    model_at, data_at = _address_of_model(model), _address_of_data(data)
    if functions is None or model_at == 0 or data_at == 0:
        return None
    inverse_dynamics, mass_matrix, places = functions
    q, v, rest = (address_of(vector) for vector in vectors)
    return np.array(
        [
            [inverse_dynamics, model_at, data_at, q, v, rest],
            [mass_matrix, model_at, data_at, q, int(pin.Convention.WORLD), 0],
            [places, model_at, data_at, q, v, 0],
        ],
        dtype=np.int64,
    )


@cache
def _functions() -> list[int] | None:
    """Addresses of the three functions in the library that Pinocchio's Python module uses."""
    try:
        # what the module was linked to is searched with it
        library = ctypes.CDLL(pin.pinocchio_pywrap_default.__file__)
        found = [getattr(library, name) for name in (_INVERSE_DYNAMICS, _MASS_MATRIX, _TERMS_OF_PLACES)]
    except (AttributeError, OSError):
        return None
    return [int(ctypes.cast(function, ctypes.c_void_p).value or 0) for function in found]


def _as_ref(array: np.ndarray) -> np.ndarray:
    """The vector as Eigen::Ref has it in memory: address and length come first, and are all that is read."""
    words = np.zeros(8, dtype=np.int64)
    words[0], words[1] = address_of(array), array.size
    return words


def _address_of_object(thing: Any) -> int:
    """Address of the C++ object that a Python object of Boost.Python holds by value; 0 where it is not known."""
    kind = type(thing)
    if type(kind).__module__ != "Boost.Python" or kind.__basicsize__ < _HOLDER + _WORD:
        return 0
    holder = ctypes.c_size_t.from_address(id(thing) + _HOLDER).value
    return holder + _HELD if holder else 0


def _words_at(address: int) -> tuple[int, int]:
    first, second = (ctypes.c_int64 * 2).from_address(address)
    return first, second


def _address_of_model(model: pin.Model) -> int:
    address = _address_of_object(model)
    if address == 0:
        return 0
    found = (ctypes.c_int * len(_FIRST_INTEGERS)).from_address(address)
    return address if list(found) == [getattr(model, name, -1) for name in _FIRST_INTEGERS] else 0


def _address_of_data(data: pin.Data) -> int:
    address = _address_of_object(data)
    if address == 0:
        return 0
    found = set((ctypes.c_size_t * _POINTERS).from_address(address))
    arrays = (data.v[0].vector, data.a_gf[0].vector, data.oMi[0].rotation)
    return address if found.issuperset(address_of(array) for array in arrays) else 0


@cache
def _agrees() -> bool:
    """Whether the functions do to a small model what they do through Python."""
    model = pin.Model()
    for joint in (pin.JointModelFreeFlyer(), pin.JointModelRX()):
        place = pin.SE3(np.eye(3), np.array([0.1, 0.2, 0.3]))
        index = model.addJoint(model.njoints - 1, joint, place, joint.shortname())
        model.appendBodyToJoint(index, pin.Inertia(1.5, np.array([0.1, -0.2, 0.3]), np.diag([0.4, 0.5, 0.6])), place)
    q, v, rest = pin.neutral(model), np.linspace(-0.5, 1.0, model.nv), np.zeros(model.nv)
    q[:] = pin.integrate(model, q, np.linspace(0.2, 0.9, model.nv))
    vectors = [_as_ref(array) for array in (q, v, rest)]
    through_python, natively = model.createData(), model.createData()
    rows = _rows(model, natively, vectors)
    if rows is None:
        return False
    prototype = ctypes.CFUNCTYPE(ctypes.c_void_p, *(ctypes.c_int64,) * (NATIVE_COLUMNS - 1))
    for calls, native in (
        ([(pin.rnea, (q, v, rest)), (pin.crba, (q, pin.Convention.WORLD))], rows[:2]),
        ([(pin.computeJointJacobiansTimeVariation, (q, v))], rows[2:]),
    ):
        for function, arguments in calls:
            function(model, through_python, *arguments)
        for address, *numbers in native.tolist():
            prototype(address)(*numbers)
        pairs = [
            [data.tau, np.triu(data.M), data.J, data.oMi[2].homogeneous, data.v[2].vector, data.a_gf[2].vector]
            for data in (through_python, natively)
        ]
        if not all(np.allclose(one, two, rtol=1e-12, atol=1e-12) for one, two in zip(*pairs)):
            return False
    return True
