"""A ball on a tilting plate is steered to the centre by planning ahead (cross-entropy method).

The plate hangs in a gimbal; two torques tilt it, and the ball rolls as it will, or slips, or falls off. Before every
action copies of the scene, a vectorised Gymnasium environment, try sequences of torques from the present state on. The
best of them say where to look next; of the plan that comes out the first action is taken. Nothing is known of the
dynamics but what the environment answers. The same seed gives the same numbers to the last bit.

    pip install ".[gym]"
    python examples/ball_on_plate.py [--html FILE]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pinocchio as pin

import pincontact as pc
from pincontact.gym import ContactEnv

URDF = Path(__file__).resolve().parent.parent / "urdf" / "ball_on_plate.urdf"
RADIUS, HALF_WIDTH, TOP = 0.03, 0.25, 0.005
DT, SUBSTEPS = 5e-3, 10
# Plans that are tried, the best of them, rounds of trying before an action, actions that are looked ahead, and knots.
SAMPLES, ELITES, ROUNDS, HORIZON, KNOTS = 24, 6, 3, 12, 5


def build() -> tuple[pc.Scene, pc.State]:
    """The scene, whose q is the ball's place and quaternion, roll and pitch, and where the ball starts."""
    scene = pc.Scene.from_urdf(URDF)
    edges = (-HALF_WIDTH, HALF_WIDTH)
    top = pin.SE3(np.eye(3), np.array([0.0, 0.0, TOP]))
    plate = scene.add_contour("plate", pc.Plane(domain=(edges, edges)), "plate", top)
    ball = scene.add_contour("ball", pc.Sphere(RADIUS), "ball")
    scene.add_contact("ball/plate", ball, plate, friction=pc.Coulomb(0.5))
    q, v = pin.neutral(scene.model), np.zeros(scene.model.nv)
    q[:3], v[:2] = (0.14, -0.1, TOP + RADIUS), (0.15, 0.25)
    return scene, scene.initial_state(q, v)


def reward(stepper: pc.Stepper, tau: np.ndarray) -> float:
    """What the ball's distance and speed and the plate's tilt cost, and next to nothing for torques."""
    place, tilt, speed, rates = stepper.q[:2], stepper.q[7:], stepper.v[:3], stepper.v[6:]
    cost = 20.0 * place @ place + 3.0 * speed @ speed + tilt @ tilt + 0.1 * rates @ rates + 0.02 * tau @ tau
    return -float(cost)


def has_fallen(stepper: pc.Stepper) -> bool:
    """Whether the ball is beyond the plate's edge."""
    return bool(np.abs(stepper.q[:2]).max() > HALF_WIDTH)


class Planner:
    """The cross-entropy method on copies of an environment; plans are kept from one action to the next.

    A plan has torques at a few times, the knots, and is linear in between: next to noise from one action to the next
    a plate does not move.
    """

    def __init__(self, env: ContactEnv, seed: int) -> None:
        self.envs = env.vector(SAMPLES, autoreset_mode="NextStep")
        self.rng = np.random.default_rng(seed)
        self.knots = np.linspace(0.0, HORIZON - 1.0, KNOTS)
        self.mean = np.zeros((KNOTS, *env.action_space.shape))

    def at(self, actions: np.ndarray) -> np.ndarray:
        """(n, KNOTS) what the knots' torques weigh in these actions, counted from the present one."""
        return np.array([np.interp(actions, self.knots, unit) for unit in np.eye(KNOTS)]).T

    def action(self, state: pc.State) -> np.ndarray:
        """The first action of the plan from this state on."""
        spread = np.full_like(self.mean, 0.5)
        for _ in range(ROUNDS):
            plans = np.clip(self.mean + spread * self.rng.normal(size=(SAMPLES, *self.mean.shape)), -1.0, 1.0)
            plans[0] = self.mean
            values = self._values(state, self.at(np.arange(HORIZON)) @ plans)
            best = plans[np.argsort(-values)[:ELITES]]
            self.mean, spread = best.mean(axis=0), best.std(axis=0)
        # the best plan that has been tried, from the next action on, is where the next search begins
        self.mean = self.at(self.knots + 1.0) @ best[0]
        return best[0, 0].copy()

    def _values(self, state: pc.State, plans: np.ndarray) -> np.ndarray:
        """(SAMPLES,) sums of rewards; what falls off loses more than any other plan can."""
        self.envs.reset(options={"state": state})
        values, going_on = np.zeros(len(plans)), np.ones(len(plans), dtype=bool)
        for actions in plans.transpose(1, 0, 2):
            _, rewards, terminated, truncated, _ = self.envs.step(actions)
            values += np.where(going_on, rewards, -10.0)
            going_on &= ~(terminated | truncated)
        return values


def main(html: Path | None = None, duration: float = 2.4, seed: int = 0) -> dict[str, float]:
    scene, state = build()
    env = ContactEnv(scene, state, ["roll", "pitch"], reward, terminate=has_fallen, dt=DT, substeps=SUBSTEPS)
    planner = Planner(env, seed)
    env.reset(seed=seed)
    hold, distance = DT * SUBSTEPS, [float(np.hypot(*state.q[:2]))]
    actions, over, total = [], False, 0.0
    while not over and len(actions) < round(duration / hold):
        actions.append(planner.action(env.stepper.state))
        _, gained, terminated, truncated, _ = env.step(actions[-1])
        total, over = total + gained, terminated or truncated
        distance.append(float(np.hypot(*env.stepper.q[:2])))
    result = {
        "start": distance[0],
        "end": distance[-1],
        "speed": float(np.linalg.norm(env.stepper.v[:3])),
        "fell": float(over),
        "reward": total,
    }
    print(
        f"{len(actions)} actions of {hold:g} s: the ball has come from {1e3 * distance[0]:.0f} mm to "
        f"{1e3 * distance[-1]:.1f} mm from the centre, at {1e3 * result['speed']:.1f} mm/s; reward {total:.3f}"
    )
    # the same actions in a run with contact forces and a replay; a control is asked in the middle of every step
    torques = np.zeros((len(actions), scene.model.nv))
    torques[:, 6:] = scene.model.effortLimit[6:] * np.array(actions)
    run = pc.simulate(
        scene,
        state,
        hold * len(actions),
        method="Moreau",
        dt=DT,
        control=lambda t, q, v: torques[min(int(t / hold), len(torques) - 1)],
    )
    result["replayed"] = float(np.abs(run.q[-1] - env.stepper.q).max())
    share = 100.0 * float((run.contacts["ball/plate"].mode == 2).mean())
    print(f"{run.message} It ends {result['replayed']:.1e} from there; the ball slips {share:.0f} % of the time")
    if html is not None:
        print(f"wrote {pc.export_html(run, html)}")
    return result


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--html", type=Path, metavar="FILE", help="write a replay as an HTML file")
    main(parser.parse_args().html)
