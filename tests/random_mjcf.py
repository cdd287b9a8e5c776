"""Random MJCF files within what can be read: every way to say where things are, what they weigh and how they move."""

import numpy as np

_SEQUENCES = ("xyz", "XYZ", "zxZ", "yXz", "ZyX")


class RandomFile:
    """text: a file with a few bodies, several of them in the world, with classes, frames and inertias of all kinds."""

    def __init__(self, seed):
        self.rng = np.random.default_rng(seed)
        self.names = 0
        rng = self.rng
        self.radian = bool(rng.integers(2))
        compiler = {
            "angle": "radian" if self.radian else "degree",
            "eulerseq": rng.choice(_SEQUENCES),
            "inertiafromgeom": rng.choice(["auto", "true"], p=[0.8, 0.2]),
            "balanceinertia": "true",
        }
        if rng.random() < 0.3:
            compiler |= {"boundmass": 0.7, "boundinertia": 0.01}
        if rng.random() < 0.3:
            compiler["settotalmass"] = 5.0
        if rng.random() < 0.3:
            compiler["inertiagrouprange"] = "0 2"
        worlds = "".join(self._body(0, True) for _ in range(rng.integers(1, 4)))
        self.text = f"""
<mujoco model="random">
  <compiler {self._attributes(compiler)}/>
  <option gravity="{self._numbers(3)}"/>
  <default>
    <joint damping="0.3" armature="0.02"/>
    <geom density="700"/>
    <default class="stiff">
      <joint frictionloss="0.4" limited="false"/>
      <geom euler="{self._angles(3)}" group="3"/>
      <default class="light"><geom density="90" type="box" size="0.1 0.2 0.3"/><joint damping="0"/></default>
    </default>
  </default>
  <asset>
    <mesh name="m0" vertex="{self._numbers(24)}" refpos="{self._numbers(3)}" refquat="{self._numbers(4)}"/>
    <mesh name="m1" vertex="{self._numbers(18)}" scale="0.2 0.3 -0.1" inertia="shell"/>
  </asset>
  <worldbody>
    <geom type="plane" size="0 0 1"/>
    {worlds}
  </worldbody>
</mujoco>"""

    def _body(self, depth, of_world):
        rng = self.rng
        self.names += 1
        name = f"b{self.names}"
        parts = [self._joints(of_world)]
        if rng.random() < 0.6:
            parts.append(self._inertial())
        # one has mass in any case, as MuJoCo asks of bodies that move
        parts += [
            '<geom type="sphere" size="0.1" mass="0.3" group="0"/>',
            *(self._geom() for _ in range(rng.integers(0, 3))),
        ]
        if rng.random() < 0.5:
            parts.append(self._framed(f'<site name="s{self.names}" {self._pose()}/>'))
        if depth < 3:
            children = [self._body(depth + 1, False) for _ in range(rng.integers(0, 3 - depth // 2))]
            parts += [self._framed(child) if rng.random() < 0.3 else child for child in children]
        childclass = f'childclass="{rng.choice(["stiff", "light"])}"' if rng.random() < 0.3 else ""
        return f'<body name="{name}" {childclass} {self._pose()}>{"".join(parts)}</body>'

    def _framed(self, content):
        return f"<frame {self._pose()}>{content}</frame>"

    def _joints(self, of_world):
        rng = self.rng
        kind = rng.choice(["free", "ball", "axes", "none"] if of_world else ["ball", "axes", "none"])
        if kind == "free":
            freejoint = f'<freejoint align="{rng.choice(["true", "false"])}"/>'
            return freejoint if rng.random() < 0.5 else '<joint type="free" armature="0" frictionloss="0"/>'
        if kind == "none":
            return ""
        if kind == "ball":
            return f'<joint type="ball" pos="{self._numbers(3)}" damping="{rng.random()}"/>'
        made = "".join(self._joint() for _ in range(rng.integers(1, 4)))
        return self._framed(made) if rng.random() < 0.2 else made

    def _joint(self):
        rng = self.rng
        kind = rng.choice(["hinge", "slide"])
        attributes = {"type": kind, "axis": self._numbers(3), "pos": self._numbers(3)}
        if rng.random() < 0.3:
            attributes["axis"] = rng.choice(["1 0 0", "0 1 0", "0 0 1", "0 0 -2"])
        scale = 1.0 if self.radian or kind == "slide" else 180.0 / np.pi
        if rng.random() < 0.5:
            attributes["range"] = f"{-scale * rng.random()} {scale * rng.random()}"
            attributes["limited"] = rng.choice(["auto", "true", "false"])
        if rng.random() < 0.3:
            attributes["ref"] = scale * rng.normal()
        for name in ("damping", "armature", "frictionloss"):
            if rng.random() < 0.3:
                attributes[name] = rng.random()
        if rng.random() < 0.2:
            attributes["class"] = rng.choice(["stiff", "light", "main"])
        return f"<joint {self._attributes(attributes)}/>"

    def _inertial(self):
        rng = self.rng
        mass, moments = 0.2 + rng.random(), 0.1 * rng.random(3)
        if rng.random() < 0.5:
            root = rng.normal(size=(3, 3))
            full = root @ root.T * 0.01
            full = [full[0, 0], full[1, 1], full[2, 2], full[0, 1], full[0, 2], full[1, 2]]
            return f'<inertial pos="{self._numbers(3)}" mass="{mass}" fullinertia="{_joined(full)}"/>'
        return f'<inertial {self._pose()} mass="{mass}" diaginertia="{_joined(moments)}"/>'

    def _geom(self):
        rng = self.rng
        kind = rng.choice(["sphere", "capsule", "cylinder", "ellipsoid", "box"])
        attributes = {"type": kind, "size": self._sizes(3)}
        pose = self._pose()
        if kind != "sphere" and rng.random() < 0.4:
            attributes["fromto"], attributes["class"], pose = self._numbers(6), "main", ""
        elif rng.random() < 0.2:
            attributes |= {"mesh": rng.choice(["m0", "m1"]), "type": rng.choice(["mesh", kind])}
        if rng.random() < 0.4:
            attributes[rng.choice(["mass", "density"])] = rng.choice([0.0, 0.4, 300.0])
        if rng.random() < 0.3:
            attributes |= {"contype": 0, "conaffinity": 0}
        if rng.random() < 0.3:
            attributes["group"] = rng.integers(0, 6)
        return f"<geom {pose} {self._attributes(attributes)}/>"

    def _pose(self):
        kind = self.rng.choice(["none", "quat", "axisangle", "euler", "xyaxes", "zaxis"])
        if kind == "none":
            return f'pos="{self._numbers(3)}"'
        values = {
            "quat": lambda: self._numbers(4),
            "axisangle": lambda: f"{self._numbers(3)} {self._angles(1)}",
            "euler": lambda: self._angles(3),
            "xyaxes": lambda: self._numbers(6),
            "zaxis": lambda: self._numbers(3),
        }[kind]()
        return f'pos="{self._numbers(3)}" {kind}="{values}"'

    def _numbers(self, count):
        return _joined(self.rng.normal(size=count))

    def _sizes(self, count):
        return _joined(0.05 + 0.2 * self.rng.random(count))

    def _angles(self, count):
        return _joined(self.rng.normal(size=count) * (1.0 if self.radian else 180.0 / np.pi))

    @staticmethod
    def _attributes(values):
        return " ".join(f'{name}="{value}"' for name, value in values.items())


def _joined(values):
    return " ".join(repr(float(value)) for value in values)
