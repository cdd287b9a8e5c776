"""Section 6 of Zhao and Liu's paper: a thin disk on a rough plane, in the paper's six coordinates.

The paper's equations, with its misprints corrected (see `pincontact/docs/paper.md`), are written out here, and SciPy
integrates them: M q'' = H + v_,q' F (Eq. 60) with the velocity constraints of rolling (62) or the friction of sliding
(63), the normal constraint (61), and the rates of the contact coordinates (48). The package runs the same body on
Pinocchio's joints beside it. Printed is how far the two are apart, and how long both traces of the contact point are.

    python examples/paper_section6.py [--plot FILE] [--html FILE]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pinocchio as pin
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline

import pincontact as pc

MASS, RADIUS, GRAVITY, MU = 1.7, 0.45, 9.81, 0.3
J1, J3 = 0.25 * MASS * RADIUS**2, 0.5 * MASS * RADIUS**2
# The order of Eq. 36: place of the centre, precession, nutation, rotation about the disk's axis.
JOINTS = {
    "q1": pin.JointModelPX,
    "q2": pin.JointModelPY,
    "q3": pin.JointModelPZ,
    "q4": pin.JointModelRZ,
    "q5": pin.JointModelRY,
    "q6": pin.JointModelRZ,
}
CONTACT = "rim/plane"
# Velocity in m/s of the rim over the plane at the start.
SLIDING = (0.8, -0.5)
RTOL, ATOL = 1e-11, 1e-13
# So many that quadratures of the speeds between them are as exact.
OUTPUTS = 801

# ------------------------------------------------------------------------------------------ the paper's equations


def mass_matrix(q: np.ndarray) -> np.ndarray:
    """M of Eq. 60."""
    s5, c5 = np.sin(q[4]), np.cos(q[4])
    matrix = np.diag([MASS, MASS, MASS, J3 * c5**2 + J1 * s5**2, J1, J3])
    matrix[3, 5] = matrix[5, 3] = J3 * c5
    return matrix


def generalized_forces(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """H of Eq. 60, its third and fourth entries in their places."""
    (v4, v5, v6), s5, double = v[3:], np.sin(q[4]), np.sin(2.0 * q[4])
    turning = [
        (J3 - J1) * v4 * v5 * double + J3 * v6 * v5 * s5,
        0.5 * (J1 - J3) * v4**2 * double - J3 * v6 * v4 * s5,
        J3 * v4 * v5 * s5,
    ]
    return np.array([0.0, 0.0, -MASS * GRAVITY, *turning])


def velocity_derivatives(q: np.ndarray) -> np.ndarray:
    """v_,q' of Eq. 60, (6, 3), for v_c = v_2 - v_1 as in Eq. 54: with it F acts on the plane."""
    s4, c4, s5, c5 = np.sin(q[3]), np.cos(q[3]), np.sin(q[4]), np.cos(q[4])
    turning = [[s4 * c5, -c4 * c5, 0.0], [c4 * s5, s4 * s5, c5], [s4, -c4, 0.0]]
    return np.vstack([-np.eye(3), RADIUS * np.array(turning)])


def velocity_bias(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """The rate of v_c that q'' does not make: Eq. 54 differentiated by hand."""
    (v4, v5, v6), s4, c4, s5, c5 = v[3:], np.sin(q[3]), np.cos(q[3]), np.sin(q[4]), np.cos(q[4])
    across, along = c5 * (v4**2 + v5**2) + v4 * v6, 2.0 * s5 * v4 * v5
    return RADIUS * np.array([c4 * across - s4 * along, s4 * across + c4 * along, -s5 * v5**2])


def accelerations(q: np.ndarray, v: np.ndarray, rolls: bool) -> tuple[np.ndarray, np.ndarray]:
    """q'' and the force F on the plane: Eq. 60 with (61) and (62) differentiated, or with (61) and (63)."""
    derivatives = velocity_derivatives(q)
    directions, held = np.eye(3), slice(0, 3)
    if not rolls:
        slip = (derivatives.T @ v)[:2]
        # the disk presses on the plane: |F_3| = -F_3
        directions, held = np.array([[*(MU * slip / np.linalg.norm(slip)), 1.0]]).T, slice(2, 3)
    rows = derivatives[:, held].T
    zeros = np.zeros((len(rows), directions.shape[1]))
    matrix = np.block([[mass_matrix(q), -derivatives @ directions], [rows, zeros]])
    solution = np.linalg.solve(matrix, np.r_[generalized_forces(q, v), -velocity_bias(q, v)[held]])
    force = directions @ solution[6:]
    assert force[2] < 0.0, "the disk would have to be pulled down"
    return solution[:6], force


def location_rates(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Rates of xi*, eta_1*, eta_2* (Eq. 48)."""
    s4, c4, s5, c5 = np.sin(q[3]), np.cos(q[3]), np.sin(q[4]), np.cos(q[4])
    eta1 = v[0] - RADIUS * (s4 * c5 * v[3] + c4 * s5 * v[4])
    eta2 = v[1] + RADIUS * (c4 * c5 * v[3] - s4 * s5 * v[4])
    return np.array([-v[5], eta1, eta2])


def location(q: np.ndarray) -> np.ndarray:
    """xi*, eta_1*, eta_2* (Eq. 50)."""
    return np.array([-q[5], q[0] + RADIUS * np.cos(q[3]) * np.cos(q[4]), q[1] + RADIUS * np.sin(q[3]) * np.cos(q[4])])


def start(sliding: tuple[float, float] = (0.0, 0.0)) -> tuple[np.ndarray, np.ndarray]:
    """(q, q') with the rim on the plane: (61) holds, and v_c is minus `sliding` (m/s); zero is rolling (62)."""
    q = np.array([0.0, 0.0, 0.0, 0.4, 1.1, 0.0])
    q[2] = RADIUS * np.sin(q[4])
    v = np.array([0.0, 0.0, 0.0, 0.6, 0.2, 6.0])
    v[:3] = velocity_derivatives(q)[3:].T @ v[3:] + [*sliding, 0.0]
    return q, v


def integrate(q: np.ndarray, v: np.ndarray, times: np.ndarray, rolls: bool) -> dict[str, np.ndarray]:
    """q, v, F, p and p' of the paper's equations at the times, and the lengths s1, s2 of both traces."""

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        moving = location_rates(y[:6], y[6:12])
        traces = RADIUS * abs(moving[0]), np.hypot(moving[1], moving[2])
        return np.r_[y[6:12], accelerations(y[:6], y[6:12], rolls)[0], moving, traces]

    found = solve_ivp(rates, times[[0, -1]], np.r_[q, v, location(q), 0.0, 0.0], "DOP853", times, rtol=RTOL, atol=ATOL)
    y = found.y.T
    return {
        "q": y[:, :6],
        "v": y[:, 6:12],
        "force": np.array([accelerations(row[:6], row[6:12], rolls)[1] for row in y]),
        "location": y[:, 12:15],
        "rates": np.array([location_rates(row[:6], row[6:12]) for row in y]),
        "traces": y[:, 15:],
    }


# ------------------------------------------------------------------------------------------ the package's run


def disk_scene(friction: pc.FrictionLaw) -> pc.Scene:
    """The disk on joints along and about the axes of Eq. 36, so that Pinocchio's coordinates are the paper's."""
    model, joint = pin.Model(), 0
    for name, kind in JOINTS.items():
        joint = model.addJoint(joint, kind(), pin.SE3.Identity(), name)
    model.appendBodyToJoint(joint, pin.Inertia(MASS, np.zeros(3), np.diag([J1, J1, J3])), pin.SE3.Identity())
    model.addBodyFrame("disk", joint, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    rim, plane = scene.add_contour("rim", pc.Circle(RADIUS), frame="disk"), scene.add_contour("plane", pc.Plane())
    scene.add_contact(CONTACT, rim, plane, friction=friction, bilateral=True)
    return scene


def compare(run: pc.Trajectory, paper: dict[str, np.ndarray]) -> dict[str, float]:
    """The largest differences between the run and the paper's equations, over all outputs."""
    track = run.contacts[CONTACT]
    found = {"q": run.q, "v": run.v, "force": track.force, "location": track.location, "rates": track.rates}
    # the rim's parameter is known up to whole turns
    turns = 2.0 * np.pi * np.round((track.location[0, 0] - paper["location"][0, 0]) / (2.0 * np.pi))
    found["location"] = track.location - [turns, 0.0, 0.0]
    return {name: float(np.abs(values - paper[name]).max()) for name, values in found.items()}


def traces(run: pc.Trajectory) -> np.ndarray:
    """(n, 2) lengths in m of the package's traces of the contact point, on the rim and on the plane, at each output."""
    rates = run.contacts[CONTACT].rates
    speeds = np.column_stack([RADIUS * np.abs(rates[:, 0]), np.hypot(rates[:, 1], rates[:, 2])])
    return np.asarray(make_interp_spline(run.t, speeds, k=7).antiderivative()(run.t))


def draw(runs: dict[str, tuple[pc.Trajectory, dict[str, np.ndarray]]], path: Path) -> None:
    """Contact coordinates and lengths of traces: the package's lines, the paper's equations as dots."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, grid = pyplot.subplots(2, 2, figsize=(9.0, 6.0), layout="constrained", sharex="col")
    for (name, (run, paper)), (above, below) in zip(runs.items(), grid.T):
        few = slice(None, None, OUTPUTS // 20)
        run.plot(kinds=["location"], axes=[above])
        above.plot(run.t[few], paper["location"][few], "k.", markersize=3)
        for values, label in zip(traces(run).T, ("on the rim, s1", "on the plane, s2")):
            below.plot(run.t, values, label=label)
        below.plot(run.t[few], paper["traces"][few], "k.", markersize=3)
        above.set_title(f"{name}; dots: the paper's equations")
        below.set_xlabel("t [s]")
        below.set_ylabel("length of trace [m]")
        below.legend()
    figure.savefig(path)
    pyplot.close(figure)


def main(duration: float = 2.0, plot: Path | None = None, html: Path | None = None) -> dict[str, float]:
    """Roll, and slide for as long as the disk slides; returns the differences, and what is known of the traces."""
    rolling, sliding = disk_scene(pc.NoSlip()), disk_scene(pc.Coulomb(MU))
    # until shortly before the disk comes to roll: there the direction of friction is 0 / 0
    slides = pc.simulate(sliding, sliding.initial_state(*start(SLIDING)), duration, rtol=RTOL, atol=ATOL)
    sticks = next((event.time for event in slides.events if event.kind == "stick"), duration)
    result: dict[str, float] = {"sticks_at": sticks}
    runs = {}
    for name, scene, initial, end in (
        ("rolling", rolling, start(), duration),
        ("sliding", sliding, start(SLIDING), min(0.95 * sticks, duration)),
    ):
        times = np.linspace(0.0, end, OUTPUTS)
        run = pc.simulate(scene, scene.initial_state(*initial), end, t_eval=times, rtol=RTOL, atol=ATOL)
        paper = integrate(*initial, times, rolls=name == "rolling")
        runs[name] = run, paper
        result |= {f"{name}_{key}": value for key, value in compare(run, paper).items()}
        lengths = traces(run)
        result[f"{name}_traces"] = float(np.abs(lengths - paper["traces"]).max())
        result[f"{name}_apart"] = float(np.abs(lengths[:, 0] - lengths[:, 1]).max())
        result[f"{name}_way"] = float(lengths[-1, 1])
        # M and H at the end, as `analyze` gives them
        at = pc.analyze(scene, run.state())[CONTACT]
        q, v = run.q[-1], run.v[-1]
        result[f"{name}_matrices"] = float(
            max(np.abs(at.M - mass_matrix(q)).max(), np.abs(at.H - generalized_forces(q, v)).max())
        )
        print(f"{name}, {end:.4f} s: {run.message}")
        print("  package against the paper's equations, largest differences:")
        for key, unit in (("q", "m, rad"), ("v", "m/s, rad/s"), ("force", "N"), ("location", "m, rad")):
            print(f"    {key:<9} {result[f'{name}_{key}']:.1e} {unit}")
        print(f"    {'rates':<9} {result[f'{name}_rates']:.1e} m/s, rad/s")
        print(f"    {'traces':<9} {result[f'{name}_traces']:.1e} m")
        print(f"  traces on rim and plane {lengths[-1, 0]:.9f} m and {lengths[-1, 1]:.9f} m")
    if plot is not None:
        draw(runs, plot)
        print(f"wrote {plot}")
    if html is not None:
        print(f"wrote {pc.export_html(runs['rolling'][0], html)}")
    return result


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw contact coordinates and traces into a picture")
    parser.add_argument("--html", type=Path, metavar="FILE", help="write a replay of the rolling disk as an HTML file")
    arguments = parser.parse_args()
    main(plot=arguments.plot, html=arguments.html)
