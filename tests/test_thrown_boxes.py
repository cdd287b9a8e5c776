"""Time stepping goes on: random boxes thrown onto a floor, of all laws, restitutions and resistances to turning."""

import numpy as np
from thrown_boxes import thrown_box

import pincontact as pc
from pincontact.friction.loads import RADII_TOLERANCE, TOLERANCE, Loads


def test_thrown_boxes():
    """None ends early, contacts and joints never do positive work, and nearly every problem has its own solution.

    A step that is told to be too long is not when halved."""
    problems = settled = halved = 0
    for seed in range(12):
        scene, state, step = thrown_box(seed)
        run = pc.simulate(scene, state, 1.0, method="Moreau", step=step, energies=True)
        if run.status == -9:
            halved, step = halved + 1, 0.5 * step
            run = pc.simulate(scene, state, 1.0, method="Moreau", step=step, energies=True)
        assert run.status == 0, (seed, run.message)
        energies = run.energies()
        works = np.diff(energies.friction_work + energies.damping_work)
        # the impulse that ends slip within a step meets the mean of the velocities at both ends: an error of order h
        assert works.max() <= step * energies.kinetic.max(), seed
        problems, settled = problems + run.stats["cone_problems"], settled + run.stats["settled"]
    assert settled <= 1e-3 * problems
    assert halved <= 1


def random_product(rng):
    """A few contacts in eight velocities or fewer, each with a disc for its resistance to turning."""
    contacts, nv = int(rng.integers(1, 5)), int(rng.integers(3, 9))
    n = 2 * contacts
    rows = rng.normal(size=(3 * n, nv))
    normal, tangents = np.zeros(n), rng.integers(1, 3, n).astype(float)
    mu, slope = rng.uniform(0.05, 0.8, n), np.zeros((n, 2, 3 * n))
    for i in range(contacts):
        normal[2 * i] = 1.0
        slope[2 * i, 0, 6 * i + 2] = slope[2 * i + 1, 0, 6 * i + 2] = 1.0
    for i in range(n):
        rows[3 * i + int(tangents[i]) : 3 * i + 2] = 0.0
        if not normal[i]:
            rows[3 * i + 2] = 0.0
    # velocities that some motion has, so that another one parts all contacts
    base = rows @ rng.normal(size=nv)
    return Loads(rows @ rows.T, base, normal, tangents, mu, np.zeros(2 * n), slope.reshape(2 * n, -1))


def laws_violated(product, forces, radii):
    """Signorini's law and friction within given radii, written out one by one; relative to forces and velocities."""
    u, worst = product.gram @ forces + product.base, 0.0
    force, speed = np.abs(forces).max() or 1.0, np.abs(product.base).max()
    for i, count in enumerate(product.tangents.astype(int)):
        k = 3 * i
        f, slip = forces[k : k + count], u[k : k + count]
        if product.normal[i]:
            worst = max(worst, -forces[k + 2] / force, -u[k + 2] / speed, abs(forces[k + 2] * u[k + 2]) / force / speed)
        worst = max(worst, (np.linalg.norm(f) - radii[i]) / force)
        # the power that friction takes is as large as the radius allows
        worst = max(worst, (radii[i] * np.linalg.norm(slip) + f @ slip) / force / speed)
    return worst


def test_contacts_and_resistances_together():
    """300 random problems, coefficients up to 0.8: a solution obeys the laws to 1e-8, since residuals of 1e-10
    in forces become larger where the operator is badly conditioned; what settles, for radii that are not
    those of the solution, obeys the laws for the radii that are used, and takes energy."""
    rng = np.random.default_rng(3)
    solved = 0
    for _ in range(300):
        product = random_product(rng)
        forces, residual = product.solve(np.zeros_like(product.base))
        if residual <= TOLERANCE:
            solved += 1
            assert laws_violated(product, forces, product.radii(forces)) < 1e-8
        start = forces * rng.uniform(0.5, 1.5)
        forces, _, residual, _ = product.solve_with_radii(start)
        assert residual <= RADII_TOLERANCE
        # a residual of 1e-6, which is larger where the operator is badly conditioned
        assert laws_violated(product, forces, product.radii(start)) < 1e-4
        work, size = forces @ (product.base + 0.5 * product.gram @ forces), np.abs(forces) @ np.abs(product.base)
        assert work <= 1e-9 * size
    assert solved >= 290


def test_elastic_impacts_keep_the_energy():
    """Frictionless boxes, e = 1: what the total energy changes in a second, some eight impacts, falls with h^2, and is
    less than 4e-4 of the kinetic energy at h = 1 ms, where the impacts of boxes that spin slowly change 1e-5."""
    changes = []
    for step in (4e-3, 1e-3, 5e-4):
        worst = total = 0.0
        for seed in range(10):
            scene, state, _ = thrown_box(seed, law=None, bounce=1.0)
            run = pc.simulate(scene, state, 1.0, method="Moreau", step=step, energies=True)
            assert run.status == 0, seed
            energies = run.energies()
            worst = max(worst, float(np.ptp(energies.total) / energies.kinetic.max()))
            total += float(np.ptp(energies.total) / energies.kinetic.max())
        changes.append(total)
        if step == 1e-3:
            assert worst < 4e-4
    # 1/64 (of first order 1/8), and what the times of impacts within steps scatter
    assert changes[2] < 0.06 * changes[0]
