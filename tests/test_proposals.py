"""Many contacts at once, and pairs proposed for them: against distances of all pairs, one by one."""

import itertools
import math
import warnings
from importlib import metadata
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest

import pincontact as pc

# Kind, contour and coal's shape of it; what is thin there is thin in another way than in the package.
KINDS = [
    ("sphere", pc.Sphere(0.1), coal.Sphere(0.1)),
    ("egg", pc.Ellipsoid(0.2, 0.1, 0.15), coal.Ellipsoid(0.2, 0.1, 0.15)),
    ("point", pc.Point(), coal.Sphere(0.0)),
    ("rim", pc.Circle(0.2), coal.Cylinder(0.2, 1e-9)),
    ("edge", pc.Line(domain=(-0.2, 0.2)), coal.Box(0.4, 1e-9, 1e-9)),
    ("side", pc.Cylinder(0.1, domain=(None, (-0.15, 0.15))), coal.Cylinder(0.1, 0.3)),
    ("patch", pc.Plane(domain=((-0.2, 0.2), (-0.1, 0.1))), coal.Box(0.4, 0.2, 1e-9)),
    ("plane", pc.Plane(), coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)),
]
# Of these none touches the other at one point only, however they lie; a point on a curve in space never opens.
NEVER = {
    frozenset(pair)
    for pair in [
        *itertools.combinations_with_replacement(("patch", "plane"), 2),
        *itertools.product(("patch", "plane"), ("edge", "side")),
        *itertools.combinations_with_replacement(("point", "rim"), 2),
        *itertools.product(("point", "rim"), ("edge",)),
    ]
}


def free_bodies(count):
    model = pin.Model()
    for i in range(count):
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), f"j{i}")
        model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    return model


@pytest.mark.parametrize("seed", range(3))
def test_pairs_are_those_of_all_distances(seed):
    """Two contours of each kind on bodies of their own, at random in a box of 1 m; none are parallel."""
    rng = np.random.default_rng(seed)
    names = [f"{kind}{copy}" for kind, *_ in KINDS for copy in range(2)]
    contours = {f"{kind}{copy}": (contour, solid) for kind, contour, solid in KINDS for copy in range(2)}
    scene = pc.Scene(free_bodies(len(names)))
    q = pin.neutral(scene.model)
    poses = {}
    for i, name in enumerate(names):
        offset = pin.SE3(pin.exp3(rng.normal(size=3)), 0.1 * rng.normal(size=3))
        motion = pc.HarmonicMotion(amplitude=[0.0, 0.0, 0.1], frequency=1.0, phase=0.5)
        scene.add_contour(name, contours[name][0], f"j{i}", offset, motion if i % 3 == 0 else None)
        q[7 * i : 7 * i + 3] = rng.uniform(size=3)
        q[7 * i + 3 : 7 * i + 7] = pin.Quaternion(pin.exp3(rng.normal(size=3))).coeffs()
        pose = pin.XYZQUATToSE3(q[7 * i : 7 * i + 7]) * offset
        poses[name] = pose * motion.placement(0.0) if i % 3 == 0 else pose
    for distance in (1e-3, 0.1, 0.4):
        expected = set()
        for one, two in itertools.combinations(names, 2):
            if frozenset((one[:-1], two[:-1])) in NEVER:
                continue
            solids, places = zip(*((contours[n][1], poses[n]) for n in (one, two)))
            placed = [coal.Transform3s(p.rotation, p.translation) for p in places]
            apart = coal.distance(
                solids[0], placed[0], solids[1], placed[1], coal.DistanceRequest(), coal.DistanceResult()
            )
            # at the limit itself coal's own tolerance, 1e-6, decides
            assert abs(apart - distance) > 1e-5
            if apart < distance:
                expected.add((one, two))
        proposed = list(zip(*scene.propose_contacts(distance, q)))
        assert len(proposed) == len(set(proposed)) and set(proposed) == expected
    assert len(expected) > 25
    contacts = scene.add_contacts(*scene.propose_contacts(0.1, q))
    assert all(contact.pattern.constraints == 1 for contact in contacts)
    # what has a contact is not proposed again
    remaining = set(zip(*scene.propose_contacts(0.4, q)))
    assert remaining == expected - {(contact.first.name, contact.second.name) for contact in contacts}


def test_spheres_and_points_at_closed_distances():
    """A sphere over the floor, a corner over it, and two spheres: gaps of 0.05, 0.25 and 0.1 m."""
    scene = pc.Scene(free_bodies(3))
    for i, contour in enumerate((pc.Sphere(0.1), pc.Sphere(0.2), pc.Point())):
        scene.add_contour(f"c{i}", contour, f"j{i}")
    scene.add_contour("floor", pc.Plane())
    q = pin.neutral(scene.model)
    q[[2, 7, 9, 14, 16]] = 0.15, 0.4, 0.15, 5.0, 0.25
    assert scene.propose_contacts(0.049, q) == (["c1"], ["floor"])  # overlaps
    assert scene.propose_contacts(0.051, q) == (["c0", "c1"], ["floor", "floor"])
    assert set(zip(*scene.propose_contacts(0.101, q))) == {("c0", "c1"), ("c0", "floor"), ("c1", "floor")}
    assert ("c2", "floor") not in set(zip(*scene.propose_contacts(0.249, q)))
    assert ("c2", "floor") in set(zip(*scene.propose_contacts(0.251, q)))


@pytest.mark.parametrize(
    "kinds", [("rim", "patch"), ("rim", "plane"), ("edge", "edge"), ("edge", "side"), ("side",) * 2]
)
def test_what_is_parallel_is_left_out(kinds):
    """Rims whose axes are those of planes, edges and cylinders side by side; turned by a tenth they are proposed."""
    shapes = {kind: contour for kind, contour, _ in KINDS}
    scene = pc.Scene(free_bodies(2))
    # the axis of a line is x, of all others z
    upright = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.5 * math.pi, 0.0), np.zeros(3))
    for i, kind in enumerate(kinds):
        scene.add_contour(f"c{i}", shapes[kind], f"j{i}", upright if kind == "edge" else None)
    q = pin.neutral(scene.model)
    # within reach and, for rims, above
    q[:3] = (0.0, 0.0, 0.02) if "rim" in kinds else (0.25, 0.0, 0.0)
    assert scene.propose_contacts(0.3, q) == ([], [])
    q[3:7] = pin.Quaternion(pin.exp3(np.array([0.1, 0.0, 0.0]))).coeffs()
    assert scene.propose_contacts(0.3, q) == (["c0"], ["c1"])


def test_a_tyre_stands_on_a_floor():
    """Its gap is that of the centre circle's lowest point, less the tube's radius; flat on the floor, and with what may
    be in its hole, it is not proposed."""
    major, minor, height = 0.16, 0.03, 0.2
    scene = pc.Scene(free_bodies(2))
    scene.add_contour("tyre", pc.Torus(major, minor), "j0")
    scene.add_contour("ball", pc.Sphere(0.05), "j1")
    scene.add_contour("floor", pc.Plane())
    scene.add_contour("step", pc.Plane(domain=((-1.0, 1.0), (-1.0, 1.0))))
    q = pin.neutral(scene.model)
    q[2], q[9] = height, 1.0
    for tilt in (0.3, 1.0, 0.5 * math.pi):
        q[3:7] = pin.Quaternion(pin.exp3(np.array([tilt, 0.0, 0.0]))).coeffs()
        gap = height - major * math.sin(tilt) - minor
        # coal's own accuracy is 1e-6
        assert scene.propose_contacts(gap - 1e-5, q) == ([], [])
        assert scene.propose_contacts(gap + 1e-5, q) == (["tyre"], ["floor"])
    q[2], q[9] = 0.0, 0.0
    q[3:7] = 0.0, 0.0, 0.0, 1.0
    assert scene.propose_contacts(0.1, q) == (["ball", "ball"], ["floor", "step"])


def chain(root):
    model = pin.Model()
    parent = 0
    for i, kind in enumerate((root, pin.JointModelRX(), pin.JointModelRY())):
        parent = model.addJoint(parent, kind, pin.SE3.Identity(), f"j{i}")
        model.appendBodyToJoint(parent, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    scene = pc.Scene(model)
    scene.add_contour("floor", pc.Plane())
    for i in range(3):
        scene.add_contour(f"ball{i}", pc.Sphere(0.1), f"j{i}")
        scene.add_contour(f"other{i}", pc.Sphere(0.1), f"j{i}")
    return scene


@pytest.mark.parametrize("root", [pin.JointModelFreeFlyer(), pin.JointModelPZ(), pin.JointModelRZ()])
def test_neighbours_are_left_out(root):
    """A base that can leave the floor is no neighbour of the world's; one that only turns on it is."""
    found = set(zip(*chain(root).propose_contacts(0.05, within=True)))
    on_floor = {("floor", f"{kind}{i}") for kind in ("ball", "other") for i in range(3)}
    if "RZ" in root.shortname():
        on_floor -= {("floor", "ball0"), ("floor", "other0")}
    apart = {pair for pair in found if "floor" not in pair}
    assert found - apart == on_floor
    assert apart == {(f"{a}0", f"{b}2") for a in ("ball", "other") for b in ("ball", "other")}
    # by default no links of one robot
    assert set(zip(*chain(root).propose_contacts(0.05))) == on_floor


@pytest.mark.parametrize(("joint", "held"), [(pin.JointModelPZ(), False), (pin.JointModelRZ(), True)])
def test_neighbours_of_one_joint(joint, held):
    model = pin.Model()
    model.addJoint(0, joint, pin.SE3.Identity(), "joint")
    model.addBodyFrame("body", 1, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    scene.add_contour("ball", pc.Sphere(0.1), "body")
    scene.add_contour("floor", pc.Plane())
    assert scene.propose_contacts(0.2, within=True) == ([], []) if held else (["floor"], ["ball"])


def test_planar_mechanisms_have_planar_pairs():
    """On a joint in the plane a disk touches a line and a point; two lines of the plane never cross."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPlanar(), pin.SE3.Identity(), "j")
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    scene = pc.Scene(model)
    scene.add_contour("wheel", pc.Circle(0.1), "j")
    scene.add_contour("rod", pc.Line(domain=(-0.1, 0.1)), "j")
    scene.add_contour("nail", pc.Point())
    scene.add_contour("ground", pc.Line(domain=(-1.0, 1.0)))
    found = set(zip(*scene.propose_contacts(0.2)))
    assert found == {("wheel", "nail"), ("wheel", "ground"), ("rod", "nail")}
    assert {c.pattern.name for c in scene.add_contacts(*zip(*found))} == {"2C-2C", "P-2C"}


def test_other_contours_are_named():
    scene = pc.Scene(free_bodies(1))
    scene.add_contour("cap", pc.Cone(0.4), "j0")
    scene.add_contour("ball", pc.Sphere(0.1), "j0")
    for name, contour in (("rail", pc.Line()), ("strip", pc.Plane(domain=((-1.0, 1.0), None))), ("floor", pc.Plane())):
        scene.add_contour(name, contour)
    with pytest.warns(UserWarning, match=r"cap \(Cone.*rail \(Line.*strip \(Plane") as caught:
        assert scene.propose_contacts(0.1) == (["ball"], ["floor"])
    assert caught[0].filename == __file__
    assert pc.Scene(free_bodies(1)).propose_contacts(0.1) == ([], [])


def balls(count):
    scene = pc.Scene(free_bodies(count))
    return scene, [scene.add_contour(f"b{i}", pc.Sphere(0.1), f"j{i}") for i in range(count)]


def test_pairs_and_one_against_many():
    scene, (b0, b1, b2) = balls(3)
    floor = scene.add_contour("floor", pc.Plane())
    law = pc.Coulomb(0.5)
    made = scene.add_contacts([b0, "b1", b2], floor, law, side=1, restitution=0.3)
    assert [c.name for c in made] == ["b0-floor", "b1-floor", "b2-floor"] == list(scene.contacts)
    assert all(c.friction is law and c.side == 1 and c.restitution == 0.3 and not c.bilateral for c in made)
    made = scene.add_contacts("floor", iter(["b0", "b1"]), bilateral=True)
    assert [(c.first, c.second) for c in made] == [(floor, b0), (floor, b1)] and made[0].bilateral
    assert [c.name for c in scene.add_contacts(["b0", "b1"], ["b1", b2])] == ["b0-b1", "b1-b2"]
    assert [c.name for c in scene.add_contacts(b0, b2)] == ["b0-b2"]
    # as in NumPy: one against none is none
    assert scene.add_contacts([], []) == scene.add_contacts([], floor) == []
    assert len(scene.contacts) == 8 and scene.contacts["b0-b2"].second is b2


@pytest.mark.parametrize(
    ("firsts", "seconds", "options", "error", "message"),
    [
        (["b0", "b1"], ["floor"] * 3, {}, pc.ArgumentError, "2 and 3 contours"),
        (["b0", "b1"], [], {}, pc.ArgumentError, "2 and 0 contours"),
        (["b0", 3], "floor", {}, pc.ArgumentError, "firsts must be contours"),
        ("b0", None, {}, pc.ArgumentError, "seconds must be contours"),
        (["b0", "roof"], "floor", {}, pc.ArgumentError, "'roof-floor': unknown contour 'roof'"),
        (["b0", "b1", "b0"], "floor", {}, pc.ArgumentError, "already a contact named 'b0-floor'"),
        (["b0", "b1"], "b1", {}, pc.ArgumentError, "'b1-b1'"),
        (["b0", "tip"], "nail", {}, pc.PatternError, "'tip-nail'"),
        (["b0", "b2"], "floor", {}, pc.ArgumentError, "already a contact named 'b2-floor'"),
        (["b0", "b1"], "floor", {"restitution": 2.0}, pc.ArgumentError, "'b0-floor': restitution"),
    ],
)
def test_all_or_none(firsts, seconds, options, error, message):
    scene, _ = balls(3)
    for name, contour, frame in (("floor", pc.Plane(), "universe"), ("nail", pc.Point(), "universe")):
        scene.add_contour(name, contour, frame)
    scene.add_contour("tip", pc.Point(), "j0")
    kept = scene.add_contact("b2-floor", "b2", "floor")
    with pytest.raises(error, match=message):
        scene.add_contacts(firsts, seconds, **options)
    assert scene.contacts == {"b2-floor": kept}


def test_contours_of_another_scene_are_refused():
    scene, (b0, b1) = balls(2)
    _, (_, other) = balls(2)
    with pytest.raises(pc.ArgumentError, match=r"contact 'b0-b1'.*another scene"):
        scene.add_contacts([b1, b0], [b0, other])
    assert not scene.contacts


def test_a_quadruped_falls_on_a_floor():
    """Declared in two lines: feet and corners near the floor, on which the limp robot comes down."""
    try:
        description = metadata.distribution("example-robot-data").locate_file("cmeel.prefix/share/example-robot-data")
    except metadata.PackageNotFoundError:
        pytest.skip("example-robot-data is not installed: no quadruped falls")
    path = Path(description) / "robots" / "a1_description" / "urdf" / "a1.urdf"
    with warnings.catch_warnings():
        # meshes are not looked up
        warnings.simplefilter("ignore")
        scene = pc.Scene.from_urdf(path, floating_base=True)
        scene.add_contours_from_collision(kinds="corners")
        scene.add_contours_from_collision(links=[f"{leg}_foot" for leg in ("FL", "FR", "RL", "RR")])
    q = np.concatenate([[0.0, 0.0, 0.35, 0.0, 0.0, 0.0, 1.0], np.tile([0.0, 0.8, -1.6], 4)])
    scene.add_contour("floor", pc.Plane())
    contacts = scene.add_contacts(*scene.propose_contacts(0.1, q), friction=pc.Coulomb(0.7))
    names = [contact.name for contact in contacts]
    assert sum("foot" in name for name in names) == 4 and all(name.endswith("-floor") for name in names)
    run = pc.simulate(scene, scene.initial_state(q, free=names), 0.3, method="Moreau", step=2e-3)
    assert run.status == 0
    # it has come down, and no contour is below the floor by more than steps of 2 ms leave
    assert run.q[-1, 2] < 0.3
    assert max(run.contacts[name].force[:, 2].min() for name in names) <= 0.0
    assert min(run.contacts[name].gap.min() for name in names) > -1e-3


def test_a_humanoid_stands_on_a_floor():
    """Talos, declared in two lines: the lower corners of its soles' boxes, on which stiff joints hold it."""
    try:
        share = Path(metadata.distribution("example-robot-data").locate_file("cmeel.prefix/share"))
    except metadata.PackageNotFoundError:
        pytest.skip("example-robot-data is not installed: no humanoid stands")
    folder = share / "example-robot-data" / "robots" / "talos_data"
    with warnings.catch_warnings():
        # joints that mimic others, and meshes
        warnings.simplefilter("ignore")
        scene = pc.Scene.from_urdf(folder / "robots" / "talos_reduced_box.urdf", floating_base=True, package_dirs=share)
        scene.add_contours_from_collision(kinds="corners")
    model = scene.model
    pin.loadReferenceConfigurations(model, str(folder / "srdf" / "talos.srdf"), False)
    q = np.array(model.referenceConfigurations["half_sitting"])
    scene.add_contour("floor", pc.Plane())
    contacts = scene.add_contacts(*scene.propose_contacts(0.01, q), friction=pc.Coulomb(0.6))
    soles = {f"leg_{side}_6_link_0_corner_{x}x{y}y-z" for side in ("left", "right") for x in "+-" for y in "+-"}
    assert {contact.first.name for contact in contacts} == soles
    state = scene.initial_state(q)
    stepper, joints = pc.Stepper(scene, state, dt=1e-3), np.arange(model.nv) >= 6
    stepper.pd(1e4 * joints, 1e3 * joints, state.q)

    def ankles(q):
        data = model.createData()
        pin.forwardKinematics(model, data, q)
        return np.array([data.oMi[model.getJointId(f"leg_{side}_6_joint")].homogeneous for side in ("left", "right")])

    stepper.step(np.zeros(model.nv), 2000)
    assert (stepper.modes == 1).all()
    # it sways at some 10 / s and is damped nearly critically: two seconds later it rests, and carries its weight
    assert np.abs(stepper.v).max() < 1e-3
    carried = -sum(stepper.forces.values())
    np.testing.assert_allclose(carried, [0.0, 0.0, 9.81 * pin.computeTotalMass(model)], rtol=0.0, atol=0.5)
    # soles do not creep
    np.testing.assert_allclose(ankles(stepper.q), ankles(state.q), rtol=0.0, atol=1e-9)


def humanoid():
    """A trunk with two legs of two links and feet of four corners; a ball in the way. Shapes of the links overlap."""
    model = pin.Model()
    trunk = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "trunk")
    model.appendBodyToJoint(trunk, pin.Inertia.FromBox(20.0, 0.2, 0.3, 0.5), pin.SE3.Identity())
    for side, y in (("left", 0.1), ("right", -0.1)):
        parent, place = trunk, np.array([0.0, y, -0.3])
        for link in ("thigh", "shank", "foot"):
            parent = model.addJoint(parent, pin.JointModelRY(), pin.SE3(np.eye(3), place), f"{side} {link}")
            model.appendBodyToJoint(parent, pin.Inertia.FromSphere(2.0, 0.1), pin.SE3.Identity())
            place = np.array([0.0, 0.0, -0.4])
    ball = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "ball")
    model.appendBodyToJoint(ball, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    scene = pc.Scene(model)
    for side in ("left", "right"):
        scene.add_contour(f"{side} knee", pc.Sphere(0.12), f"{side} shank")
        for i, (x, y) in enumerate(((0.15, 0.05), (0.15, -0.05), (-0.05, 0.05), (-0.05, -0.05))):
            corner = pin.SE3(np.eye(3), np.array([x, y, -0.05]))
            scene.add_contour(f"{side} corner {i}", pc.Point(), f"{side} foot", corner)
    scene.add_contour("belly", pc.Sphere(0.15), "trunk")
    scene.add_contour("ball", pc.Sphere(0.1), "ball")
    q = pin.neutral(model)
    q[2], q[-7:-4] = 1.15, (0.25, 0.1, 0.1)
    return scene, q


def test_a_humanoid_on_a_floor_is_two_lines():
    """Its corners and the ball, which lies before a foot, on the floor; knees that overlap touch on request only."""
    scene, q = humanoid()
    floor = scene.add_contour("floor", pc.Plane())
    contacts = scene.add_contacts(*scene.propose_contacts(0.02, q), friction=pc.Coulomb(0.8))
    corners = [f"{side} corner {i}-floor" for side in ("left", "right") for i in range(4)]
    assert [contact.name for contact in contacts] == [*corners, "ball-floor"]
    assert all(contact.second is floor for contact in contacts)
    pairs = set(zip(*scene.propose_contacts(0.02, q, within=True)))
    assert pairs == {("left knee", "right knee")}
    # another robot's, or an object's, are proposed
    assert ("left corner 0", "ball") in set(zip(*scene.propose_contacts(0.2, q)))
    run = pc.simulate(scene, scene.initial_state(q), 0.05, method="Moreau")
    assert run.status == 0 and all((run.contacts[name].gap > -1e-9).all() for name in corners)


def test_a_flag_is_true_or_false():
    with pytest.raises(pc.ArgumentError, match="within"):
        humanoid()[0].propose_contacts(0.1, within="links")
