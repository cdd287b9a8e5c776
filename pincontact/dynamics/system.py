"""A scene compiled for the kernels: Pinocchio's data read in place, flat tables of contacts, work arrays."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pinocchio as pin

from ..callback import kernel_address
from ..constraints.stationary import INTEGERS_FOUND, REALS_FOUND, find_stationary
from ..contacts import characteristic_length
from ..contours.motion import MOTION_CALLABLE, MOTION_NONE, MOTION_TWIST, motion_at
from ..errors import FrictionError, UnusableResult
from ..geometry.carriers import ORIGIN
from ..geometry.location import NO_CLOSED_FORM, closed_form
from ..geometry.patterns import NO_NORMAL
from ..jit import compile_kernels
from ..layout import (
    ALONG_BODY_1,
    ALONG_BODY_2,
    ANISOTROPIC,
    ASPECT,
    CARRIER,
    CHART,
    CLOSED_FORM,
    END_MARGIN,
    EVALUATOR,
    FREE,
    FRICTIONLESS,
    FROZEN,
    HIGH_END,
    HIGH_FORCE,
    JOINT,
    JOINT_Q,
    JOINT_V,
    K1,
    K2,
    KIND,
    LAST_SPEED,
    LENGTH,
    LIMIT_SLACK,
    LOW_END,
    LOW_FORCE,
    MODE,
    MOTION_EVALUATOR,
    MOTION_KIND,
    MOTION_POOL,
    MOTION_POOL_SIZE,
    MU,
    MU_FAST,
    MU_NOW,
    MU_STATIC,
    NEXT,
    NORMAL_1,
    NORMAL_SIGN,
    NUMBER_OF_WORKS,
    OVERLAP,
    OWNER,
    PATTERN,
    POOL_ADDRESS,
    POOL_SIZE,
    ROLLING,
    ROLLING_ROW,
    SCALING_11,
    SCALING_22,
    SIDE,
    SLIP_SIGN,
    SPAN,
    SPINNING,
    SPINNING_ROW,
    START_SPEED,
    SUPPORT_SIZE,
    SYSTEM,
    TANGENTS,
    TIME_DEPENDENT,
    UNILATERAL,
    VISCOUS,
)
from ..workspace import Workspace, address_of
from .equations import dry_friction_force
from .evaluation import KINEMATICS_OF_ALL, evaluate_state
from .joints import joint_locks
from .manifold import TURNING, configuration_blocks
from .pinocchio_calls import PinocchioCalls

if TYPE_CHECKING:
    from ..contacts import AttachedContour, Contact
    from ..contours.motion import Motion
    from .joints import JointLimit

# Friction up to this much above its limit is round-off: a contact exactly at the limit sticks.
FORCE_SLACK = 1e-13
# Bodies that come over the end of a contour less far below it than this part of the smaller one overlap with its edge;
# points, which are never thick, only as far as places are told apart.
_OVERLAP, _OVERLAP_OF_POINTS = 0.05, 1e-3
# Lengths of resistances below this part of their contact's make torques that rounding of its forces hides.
_NEGLIGIBLE_RESISTANCE = 1e-12


class Torque(NamedTuple):
    """What sets `tau` for a system's (q, v).

    ask(t): in Python, at time t; compiled: a C function that the kernels ask instead (see `control`), or None.
    """

    ask: Callable[[float], None]
    compiled: Any

    @property
    def address(self) -> int:
        return 0 if self.compiled is None else int(self.compiled.address)


class System(Workspace):
    """Everything that evaluations of a scene need, laid out once (see `evaluation` for the protocol).

    The arrays of `layout.SYSTEM` are attributes. `evaluate(t)` runs Pinocchio and one kernel at the state in `q`, `v`,
    `location`.

    locks: coordinates that the model locks. Nothing moves them, and nothing that they do is felt: `moves` takes their
    loads away, they are no part of the `parents` by which the mass matrix couples others, and move no contact
    (`support`). What is left is the mechanism with these joints welded.
    """

    def __init__(
        self,
        model: pin.Model,
        contacts: Sequence[Contact],
        works: bool = False,
        limits: Sequence[JointLimit] = (),
        resistances: bool = False,
    ) -> None:
        compile_kernels(several=len(contacts) > 1)
        super().__init__(SYSTEM)
        self.model = model
        self.contacts = list(contacts)
        self.data = model.createData()
        nq, nv, nc = model.nq, model.nv, len(self.contacts)
        self.nq, self.nv, self.nc, self.ng = nq, nv, nc, len(limits)
        # (contact, whether it is about the normal) of each resistance to turning
        self.resistances = _resistances(self.contacts) if resistances else []
        self.nr = len(self.resistances)
        self.items = nc + self.ng + self.nr
        nwork = NUMBER_OF_WORKS if works else 0
        ny = nq + nv + 4 * nc + nwork
        self.ny = ny
        blocks = configuration_blocks(model)
        # whether velocities differ between the axes of joints and of their parents
        self.turns = any(block[0] in TURNING for block in blocks)
        items, sides = max(self.items, 1), 2 * max(nc, 1)
        # a record as an array, which can be written to as a whole
        self.zeros("sizes")[()] = nq, nv, nc, model.njoints, len(blocks), 0, nwork, ny
        self.allocate(
            nq=nq, nv=nv, some_nv=max(nv, 1), ny=ny, joints=model.njoints, blocks=len(blocks), limits=max(self.ng, 1),
            items=items, sides=sides, item_sides=2 * items, rows=3 * items, bordered=3 * items + 1,
        )  # fmt: skip
        self.q[:] = pin.neutral(model)
        self.pinocchio = PinocchioCalls(model, self.data, self.q, self.v)
        self.locks = joint_locks(model)
        self.locked = [lock.index_v for lock in self.locks]
        self.moves[:] = 1.0
        self.moves[self.locked] = 0.0
        self._map_pinocchio()
        self.joint_table[:] = np.reshape(blocks, (-1, 4))
        self._map_contacts()
        self._map_joint_limits(limits)
        self._map_resistances()
        self._map_calls()
        self.counters.paired = bool((self.contact_int[: self.nc, NEXT] != np.arange(self.nc)).any())
        self.counters.charted = any(len(b.contour.charts) > 1 for c in self.contacts for b in (c.body1, c.body2))

    def _map_pinocchio(self) -> None:
        data, model = self.data, self.model
        self.put("mass", data.M.T)
        self.set_tree(list(data.parents_fromRow)[: model.nv])
        self.bias_forces = self.put("nle", self.pinocchio.bias_forces)
        # of one degree of freedom Pinocchio gives a vector
        self.put("jacobian", data.J.reshape(6, -1).T)
        for j in range(1, model.njoints):
            pose = data.oMi[j]
            parts = (pose.rotation, pose.translation, data.v[j].vector, data.a_gf[j].vector)
            self.joint_addresses[j] = [address_of(part) for part in parts]
        self.gravity[:], self.damping[:] = model.gravity.linear, model.damping

    def set_tree(self, parents: Sequence[int]) -> None:
        """Take these (nv,) for the tree of the mass matrix, but for coordinates that are locked."""
        tree = list(parents)
        for k in self.locked:
            tree = [tree[k] if parent == k else parent for parent in tree]
            tree[k] = -1
        self.parents[: self.nv] = tree

    def _map_contacts(self) -> None:
        self.contact_real[:, [START_SPEED, LAST_SPEED]] = np.inf
        self.contact_real[:, LIMIT_SLACK] = FORCE_SLACK
        self.python_drives: list[tuple[int, str, Motion]] = []
        self._pools: list[np.ndarray] = []
        self._carriers: dict[tuple[int, Motion | None], int] = {}
        for c, contact in enumerate(self.contacts):
            integers, numbers = self.contact_int[c], self.contact_real[c]
            one, two = contact.body1, contact.body2
            integers[PATTERN] = contact.pattern.code
            integers[K1], integers[K2] = one.contour.dimension, two.contour.dimension
            integers[TANGENTS] = contact.pattern.tangents
            integers[MODE] = FRICTIONLESS
            integers[UNILATERAL] = int(not contact.bilateral)
            integers[SIDE] = contact.side or 1
            integers[SLIP_SIGN] = integers[NORMAL_SIGN] = 1
            kinds = one.contour.kind, two.contour.kind
            integers[CLOSED_FORM] = closed_form(contact.pattern.code, *kinds, contact.bilateral)
            _map_friction(contact, integers, numbers)
            numbers[LENGTH] = characteristic_length(contact)
            numbers[OVERLAP] = numbers[LENGTH] * (_OVERLAP if integers[K1] else _OVERLAP_OF_POINTS)
            numbers[NORMAL_1] = numbers[SPAN] = 1.0
            self._map_side(2 * c, one)
            self._map_side(2 * c + 1, two)
        # bilateral contacts hold bodies together, wherever they touch
        pairs = [
            frozenset((contact.name,) if contact.bilateral else (contact.first.name, contact.second.name))
            for contact in self.contacts
        ]
        for c, pair in enumerate(pairs):
            others = range(c + 1, c + 1 + self.nc)
            self.contact_int[c, NEXT] = next(i % self.nc for i in others if pairs[i % self.nc] == pair)
        # places in the state of what does not move, and of contact coordinates that do not exist, or are not
        # integrated: a closed form needs no start to find them
        columns = self.contact_int[: self.nc]
        unfollowed = np.tile(np.arange(2), 2) >= np.repeat(columns[:, [K1, K2]], 2, axis=1)
        unfollowed[columns[:, CLOSED_FORM] != NO_CLOSED_FORM] = True
        still = [k for lock in self.locks for k in (lock.index_q, self.nq + lock.index_v)]
        self.unfollowed = np.array([*still, *(self.nq + self.nv + np.flatnonzero(unfollowed))], dtype=int)

    def _map_side(self, side: int, attached: AttachedContour) -> None:
        contour, integers = attached.contour, self.side_int[side]
        pool = np.array(contour.pool if contour.pool.size else [0.0], dtype=float)
        self._pools.append(pool)
        integers[KIND], integers[CHART], integers[JOINT] = contour.kind, 0, attached.joint
        integers[CARRIER] = self._carriers.setdefault(attached.carrier, len(self._carriers))
        integers[TIME_DEPENDENT] = int(contour.time_dependent)
        integers[POOL_ADDRESS], integers[POOL_SIZE] = address_of(pool), pool.size
        integers[EVALUATOR] = kernel_address(contour.evaluator)
        self.side_shape[side] = contour.shape_row()
        self.side_domain[side] = contour.ends() + END_MARGIN * np.array([-1.0, 1.0, -1.0, 1.0])
        placement = attached.placement_in_joint
        self.side_base[side, :9] = placement.rotation.ravel()
        self.side_base[side, 9:] = placement.translation
        if attached.joint == 0:
            self.frames[side, 0:3], self.frames[side, ORIGIN] = placement.rotation, placement.translation
        else:
            moving = [k for k in _support(self.model, attached.joint) if k not in self.locked]
            integers[SUPPORT_SIZE] = len(moving)
            self.support[side, : len(moving)] = moving
        if attached.motion is not None:
            motion = attached.motion
            parameters = np.asarray(motion.parameters, dtype=float)
            motion_pool = np.array(motion.pool if motion.pool.size else [0.0], dtype=float)
            self._pools.append(motion_pool)
            integers[MOTION_KIND] = motion.kind
            integers[MOTION_POOL], integers[MOTION_POOL_SIZE] = address_of(motion_pool), motion_pool.size
            integers[MOTION_EVALUATOR] = kernel_address(motion_at)
            self.side_motion_parameters[side, : parameters.size] = parameters
            if motion.kind == MOTION_CALLABLE:
                self.python_drives.append((side, attached.name, motion))

    def _map_joint_limits(self, limits: Sequence[JointLimit]) -> None:
        """Joint coordinates with limits or dry friction are items after the contacts, of one constraint row each."""
        nc, ng = self.nc, self.ng
        self.joint_count[0] = ng
        self.limits = list(limits)
        for g, limit in enumerate(limits):
            self.joint_int[g, JOINT_Q], self.joint_int[g, JOINT_V] = limit.index_q, limit.index_v
            self.joint_real[g, LOW_FORCE], self.joint_real[g, HIGH_FORCE] = limit.low_force, limit.high_force
            self.joint_real[g, LOW_END], self.joint_real[g, HIGH_END] = limit.low_end, limit.high_end
            self.contact_int[nc + g, MODE] = FREE
            self.basis[nc + g] = np.eye(3)
            self.rows[nc + g, 2, limit.index_v] = 1.0

    def _map_resistances(self) -> None:
        """Resistances to turning are rows after those of joint coordinates: see `resistance`."""
        self.resistance_count[0] = self.nr
        for item, (c, spins) in enumerate(self.resistances, start=self.nc + self.ng):
            integers, numbers = self.contact_int[item], self.contact_real[item]
            law = self.contacts[c].friction
            assert law is not None
            self.contact_int[c, SPINNING_ROW if spins else ROLLING_ROW] = item
            integers[OWNER], integers[PATTERN], integers[MODE] = c, NO_NORMAL, FREE
            integers[TANGENTS] = 1 if spins else self.contact_int[c, TANGENTS]
            integers[SLIP_SIGN] = integers[NORMAL_SIGN] = 1
            numbers[[MU, MU_FAST, MU_STATIC, MU_NOW]] = law.spinning if spins else law.rolling
            numbers[[ASPECT, SCALING_11, SCALING_22, SPAN, LENGTH, NORMAL_1]] = 1.0

    def before_evaluation(self, torque: Torque | None = None) -> None:
        """Set the Python function that the kernels ask before Pinocchio's terms: none where there is nothing to ask."""
        self._callback_error: BaseException | None = None
        self._culprit = ""
        # kept alive here: the kernels know the addresses only; the one without torques stays the same for good, and so
        # do the addresses in a copy of the arrays
        self._asked = self._asked_for_drives if torque is None else (self._to_be_asked(torque.ask), ())
        self._torque = torque
        asked, given = map(id, self._asked) if self._asked else (0, 0)
        # whether any of the user's functions is called
        self.asks = asked != 0
        self.callback.asked, self.callback.asked_with = asked, given
        # motions that are written in Python are asked with it
        self.callback.control = 0 if torque is None or self.python_drives else torque.address

    def _map_calls(self) -> None:
        callback = self.callback
        calls = self.pinocchio
        for name, (function, given) in zip(("called", "called_next"), calls.algorithms):
            callback[name], callback[name + "_with"] = id(function), id(given)
        callback["placed"], callback["placed_with"] = (id(thing) for thing in calls.placing)
        if calls.native is not None:
            callback["native"] = address_of(calls.native)
            callback["model"] = calls.native[0, 1]
            callback["model_size"], callback["model_joints"] = calls.model_words
        callback["call_failed"] = id(False)
        callback["evaluation"] = kernel_address(evaluate_state)
        self._asked_for_drives = (self._to_be_asked(None), ()) if self.python_drives else None
        callback["asked_for_places"] = bool(self.python_drives)
        self.before_evaluation()

    def _to_be_asked(self, torque: Callable[[float], None] | None) -> Callable[[], bool]:
        # a motion is asked once, however many contacts its contour has
        drives: dict[int, tuple[str, Motion, list[np.ndarray]]] = {}
        for side, name, motion in self.python_drives:
            drives.setdefault(id(motion), (name, motion, []))[2].append(self.side_motion[side])
        if torque is not None and not drives:
            return self.callback_of(torque)

        def ask(t: float) -> None:
            if torque is not None:
                torque(t)
            for name, motion, (row, *others) in drives.values():
                try:
                    motion.evaluate(t, row)
                except UnusableResult as error:
                    raise UnusableResult(f"t = {t:.9g} s: the motion of contour {name!r}: {error}") from None
                except BaseException:
                    self.blame(f"t = {t:.9g} s: the motion of contour {name!r}")
                    raise
                for other in others:
                    other[:] = row

        return self.callback_of(ask)

    @property
    def varies_with_time(self) -> bool:
        """Whether evaluations depend on time: by a user's function, or by a prescribed motion that is not steady."""
        return self.asks or self._driven_unsteadily

    @property
    def is_passive(self) -> bool:
        """Whether nothing does work on the motion: no user's function, and no prescribed motion."""
        return not (self.asks or self.side_int[: 2 * self.nc, [MOTION_KIND, TIME_DEPENDENT]].any())

    @cached_property
    def _driven_unsteadily(self) -> bool:
        sides = self.side_int[: 2 * self.nc, [MOTION_KIND, TIME_DEPENDENT]].tolist()
        return any(depends or kind not in (MOTION_NONE, MOTION_TWIST) for kind, depends in sides)

    def callback_of(self, ask: Callable[[float], None]) -> Callable[[], bool]:
        """ask(t) at the kernels' time, as they call it. What it raises must not pass through compiled code: it gives
        False, and is raised by `check_callbacks`."""
        scalars = self.scalars

        def function() -> bool:
            try:
                ask(scalars.time)
            except BaseException as error:
                if self._callback_error is None:
                    self._callback_error = error
                return False
            return True

        return function

    def check_callbacks(self) -> None:
        """Raise what users' functions have raised since the last call, as it was; UnusableResult for torques that are
        not finite. For everybody who has called an entry kernel that evaluates."""
        error, self._callback_error = self._callback_error, None
        if error is not None:
            raise error
        if self.scalars.bad_torque != 0.0:
            raise _bad_torque(self.scalars.bad_torque, self.scalars.bad_time)

    def check_torques(self, t: float) -> None:
        """The same of torques at t that no kernel has looked at."""
        bad = self.tau[~np.isfinite(self.tau)]
        if bad.size:
            raise _bad_torque(bad[0], t)

    def is_own(self, error: BaseException) -> bool:
        """Whether an exception says of a user's function that it has not answered as it should, and is not its own."""
        return isinstance(error, UnusableResult) and not self._culprit

    def blame(self, who: str) -> None:
        """Note the time, and which of the user's functions raises."""
        self._culprit = who

    def tell(self, error: BaseException) -> str:
        """What has ended a run, in words; for the user's exceptions with who raised them."""
        if self.is_own(error):
            return str(error)
        try:
            text = f": {error}" if str(error) else ""
        except Exception:
            # a user's own __str__ may fail, too
            text = ""
        if self._culprit and isinstance(error, Exception):
            return f"{self._culprit} raised {type(error).__name__}{text}"
        # an interrupt, say, wherever it came
        return f"t = {self.scalars.time:.9g} s: ended by {type(error).__name__}{text}"

    def checked(self, result: int) -> int:
        """What an entry kernel that evaluates has returned; raises what `check_callbacks` does."""
        if self.asks:
            self.check_callbacks()
        return result

    def evaluate(self, t: float) -> int:
        """Accelerations, forces and event functions at (q, v) in the present modes; returns a status of `layout`."""
        return self.checked(evaluate_state(self.address, t, 0))

    def evaluate_kinematics(self, t: float) -> int:
        """Contact coordinates, rows and biases of all contacts at (q, v), open ones too; a status of `layout`."""
        return self.checked(evaluate_state(self.address, t, KINEMATICS_OF_ALL))

    def find_stationary(
        self, t: float, starts: np.ndarray, branches: np.ndarray, charts: tuple[int, int]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Where Newton's method leads at (q, v) from contact coordinates (n, 4) of the only contact, in these charts
        and then in others, with branches (n,) of closed forms: integers and reals, see `constraints.stationary`."""
        self.evaluate_kinematics(t)
        bodies = self.contacts[0].body1, self.contacts[0].body2
        pairs = sorted(product(*(body.contour.charts for body in bodies)), key=lambda pair: pair != charts)
        integers = np.zeros((len(starts), INTEGERS_FOUND), dtype=np.int64)
        reals = np.zeros((len(starts), REALS_FOUND))
        find_stationary(self.address, starts, branches, np.array(pairs, dtype=np.int64), integers, reals)
        return integers, reals

    def alone(self, c: int) -> System:
        """A system of contact c only."""
        return System(self.model, [self.contacts[c]])

    @cached_property
    def modes(self) -> np.ndarray:
        """(nc,) view of the contacts' modes."""
        return self.contact_int[: self.nc, MODE]

    def held(self) -> list[int]:
        """Numbers of the joint coordinates that their limits or dry friction hold."""
        return [g for g in range(self.ng) if self.contact_int[self.nc + g, MODE] != FREE]

    def joint_forces(self) -> np.ndarray:
        """(nv,) forces of joint limits and dry joint friction in the last evaluation, N or N m."""
        out = np.zeros(self.nv)
        for g in range(self.ng):
            limit, mode = self.joint_int[g], self.contact_int[self.nc + g, MODE]
            moving = dry_friction_force(mode, limit, self.joint_real[g])
            out[limit[JOINT_V]] = moving if mode == FREE else self.force[self.nc + g, 2]
        return out

    def jacobians(self, side: int, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(3, nv) linear Jacobian of the material point of a side at `point`, (3, nv) angular Jacobian of its body."""
        linear, angular = np.zeros((3, self.nv)), np.zeros((3, self.nv))
        jacobian = np.asarray(self.data.J).reshape(6, self.nv)
        for column in self.support[side, : self.side_int[side, SUPPORT_SIZE]]:
            angular[:, column] = jacobian[3:, column]
            linear[:, column] = jacobian[:3, column] + np.cross(jacobian[3:, column], point)
        return linear, angular

    def closed(self) -> list[int]:
        """Indices of the contacts that are not open."""
        return [c for c, mode in enumerate(self.modes.tolist()) if mode != FREE]

    def frozen(self) -> list[int]:
        """Items that slip in a given direction, whatever their v_c."""
        return [i for i, frozen in enumerate(self.contact_int[:, FROZEN].tolist()) if frozen]

    def resisting(self) -> list[int]:
        """Items that are resistances of contacts that are not open."""
        if not self.nr:
            return []
        owners = self.contact_int[self.nc + self.ng : self.items, OWNER]
        return [self.nc + self.ng + i for i in np.flatnonzero(self.contact_int[owners, MODE] != FREE)]

    def resists(self, c: int) -> bool:
        """Whether contact c resists turning."""
        return bool(self.contact_int[c, SPINNING_ROW] + self.contact_int[c, ROLLING_ROW])

    @cached_property
    def trees(self) -> np.ndarray:
        """(nv, trees) of which tree of joints each velocity coordinate is: one acts on another by contacts alone."""
        model, tree = self.model, [-1]
        for j in range(1, model.njoints):
            tree.append(tree[model.parents[j]] if model.parents[j] else max(tree) + 1)
        found = np.zeros((self.nv, max(tree, default=-1) + 1))
        for j in range(1, model.njoints):
            first = model.joints[j].idx_v
            found[first : first + model.joints[j].nv, tree[j]] = 1.0
        return found

    def owner(self, item: int) -> int:
        """The contact that item, a contact or a resistance, belongs to."""
        return int(self.contact_int[item, OWNER]) if item >= self.nc + self.ng else item


def _bad_torque(value: float, t: float) -> UnusableResult:
    return UnusableResult(f"t = {t:.9g} s: control returned {value}")


def _resistances(contacts: Sequence[Contact]) -> list[tuple[int, bool]]:
    """(contact, whether it is about the normal) of what resists spinning and rolling, above round-off."""
    out = []
    for c, contact in enumerate(contacts):
        law = contact.friction
        if law is not None and law.resists_turning:
            least = _NEGLIGIBLE_RESISTANCE * characteristic_length(contact)
            out += [(c, spins) for spins in (True, False) if (law.spinning if spins else law.rolling) > least]
    return out


def _map_friction(contact: Contact, integers: np.ndarray, numbers: np.ndarray) -> None:
    """What the kernels know of a contact's friction law; zeros for none."""
    law = contact.friction
    numbers[ASPECT] = numbers[SCALING_11] = numbers[SCALING_22] = 1.0
    if law is None:
        return
    # kernels compute the coefficient of the class that says by which curve
    curve, known = law.curve, next(kind for kind in type(law).__mro__ if "curve" in vars(kind))
    if type(law).coefficient is not vars(known).get("coefficient") or (not curve and law.onset != law.sliding):
        raise FrictionError(
            f"contact {contact.name!r}: no kernel computes the coefficient of {type(law).__name__}, which depends on "
            "slip speed"
        )
    if law.onset == 0.0 < law.sliding:
        raise FrictionError(
            f"contact {contact.name!r}: {law} has no friction as slip starts, and kernels take that for none"
        )
    numbers[MU] = numbers[MU_NOW] = law.onset
    numbers[MU_FAST], numbers[MU_STATIC] = law.sliding, law.sticking
    numbers[VISCOUS], numbers[SPINNING], numbers[ROLLING] = law.viscous, law.spinning, law.rolling
    for column, number in curve.items():
        numbers[column] = number
    if law.aspect != 1.0:
        # body 2's first tangent is the basis' first vector
        integers[ANISOTROPIC] = ALONG_BODY_1 if law.along == contact.body1.name else ALONG_BODY_2
        numbers[ASPECT] = numbers[SCALING_22] = law.aspect


def _support(model: pin.Model, joint: int) -> list[int]:
    """Velocity coordinates that move a joint."""
    moving: list[int] = []
    for j in model.supports[joint]:
        if j > 0:
            start = model.idx_vs[j]
            moving.extend(range(start, start + model.nvs[j]))
    return moving
