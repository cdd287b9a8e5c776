"""Compiled systems kept between the runs of a scene: making one costs as much as a short run.

Of a scene and of every way to run it as many are kept as there are processors. A run takes one, so that runs within
runs and runs in other threads have their own, and puts it back when it has ended well. It is used again only if
everything that it was made from still has the same bits: models, placements and motions are objects that users can
write to. All its arrays are then what they were when new, so that a run cannot tell.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

from .contacts import Contact
from .cores import available_cores
from .dynamics.joints import joint_limits
from .friction.laws import LAWS
from .integration.run_system import RunSystem
from .scene import Scene

if TYPE_CHECKING:
    # with it come kernels to compile, for those who use them
    from .integration.moreau import MoreauStep

# by works and resistances; not in the scene, whose copies must not share it. What is done to a deque is done at once,
# also where other threads do it
_cache: WeakKeyDictionary[Scene, dict[tuple[bool, bool], deque[CachedSystem]]] = WeakKeyDictionary()


class CachedSystem:
    """A system, and copies of what it was made from."""

    def __init__(self, scene: Scene, works: bool, resistances: bool) -> None:
        self.options = works, resistances
        self._given, self._model = scene.model, scene.model.copy()
        self._contacts, self._parts = _made_of(scene)
        self.system = RunSystem(scene.model, self._contacts, works, joint_limits(scene.model), resistances)
        self.system.keep()
        self._stepper: MoreauStep | None = None

    def stepper(self) -> MoreauStep:
        """Time stepping of this system, as new."""
        if self._stepper is None:
            from .integration.moreau import MoreauStep

            self._stepper = MoreauStep(self.system, self._contacts)
        else:
            self._stepper.renew()
        return self._stepper

    def fits(self, scene: Scene) -> bool:
        """Whether a new system would be the same."""
        same = scene.model is self._given and scene.model == self._model
        return same and _made_of(scene) == (self._contacts, self._parts)


def take_system(scene: Scene, works: bool, resistances: bool) -> CachedSystem:
    """A system of the scene as it is now, with all limited joints of its model, as new. Raises what `System` does.

    works: with an account of works in the state; resistances: with resistances to turning as items of their own.
    """
    try:
        cached = _cache[scene][works, resistances].pop()
    except (KeyError, IndexError):
        return CachedSystem(scene, works, resistances)
    if not cached.fits(scene):
        return CachedSystem(scene, works, resistances)
    cached.system.restore()
    return cached


def put_back(scene: Scene, cached: CachedSystem) -> None:
    """Keep it for the scene's next run; nobody may use its system any more."""
    # nothing of the user's is kept alive
    cached.system.before_evaluation()
    if all(contact.friction is None or type(contact.friction) in LAWS for contact in cached.system.contacts):
        kept = _cache.setdefault(scene, {})
        if cached.options not in kept:
            kept.setdefault(cached.options, deque(maxlen=available_cores()))
        kept[cached.options].append(cached)


def _made_of(scene: Scene) -> tuple[list[Contact], list[tuple[Any, ...]]]:
    """What a system is made of besides the model: the contacts, and copies of what can be written to in them."""
    contacts, parts = list(scene.contacts.values()), []
    for contact in contacts:
        for side in (contact.first, contact.second):
            pool, motion = side.contour.pool, side.motion
            numbers = None if motion is None else (motion.kind, motion.parameters.tobytes(), motion.pool.tobytes())
            parts.append((side.placement_in_joint.copy(), pool.tobytes() if pool.size else b"", numbers))
    return contacts, parts
