"""The parameters of springs, loads and friction as symbols, beside those of `parameters.py`.

    tf1, wf1           Coulomb friction of a joint: torque and speed
    k1, ds1            stiffness and damping of spring 1
    S01 (or phi1)      its free length (or angle)
    e1x, .., h1x, ..   its ends, if no tips
    F1x, F1y (or T1)   load 1, a force (or torque)
    c1x, c1y           where it acts, if not at a tip

The number is that of the joint for friction, else that of the spring or load in the scene.
"""

from __future__ import annotations

from collections.abc import Sequence

from robodyn.equations.parameters import Parameters
from robodyn.equations.symbolic import ZERO, Planar, Role, Sum, Symbol
from robodyn.scene.scene import Description, JointSpring, Load, Moment, Spring


class SceneParameters(Parameters):
    """All symbols of a scene."""

    def __init__(self, description: Description, arms: Sequence[float] = ()) -> None:
        super().__init__(description, arms)
        for k in range(len(description.links)):
            self.friction(k)
        for i, spring in enumerate(description.springs):
            self.stiffness(i)
            self.spring_damping(i)
            if isinstance(spring, JointSpring):
                self.free_angle(i)
            else:
                self.free_length(i)
                self.ends(i)
        for i, load in enumerate(description.loads):
            if isinstance(load, Moment):
                self.torque(i)
            else:
                self.force(i)
                self.load_point(i)

    def friction(self, k: int) -> tuple[Sum, Symbol] | None:
        """Torque and speed of the friction at link k's joint."""
        friction, name = self.description.links[k].friction, self.description.links[k].name
        if friction is None or not friction.torque:
            return None
        place, told = (k, "f"), f"friction at the joint of {name}"
        torque = self.symbol(f"tf{k + 1}", Role.force, place, friction.torque, "N m", told)
        named = f"wf{k + 1}", Role.force, place
        self.symbol(*named, friction.speed, "rad/s", f"rate that smooths the {told}")
        return torque, Symbol(*named)

    def stiffness(self, i: int) -> Sum:
        spring = self.description.springs[i]
        unit = "N m/rad" if isinstance(spring, JointSpring) else "N/m"
        named = f"k{i + 1}", Role.force, (i, "k")
        return self.symbol(*named, spring.stiffness, unit, f"stiffness of {self._spring(i)}")

    def spring_damping(self, i: int) -> Sum:
        spring = self.description.springs[i]
        if not spring.damping:
            return ZERO
        unit = "N m s/rad" if isinstance(spring, JointSpring) else "N s/m"
        named = f"ds{i + 1}", Role.damping, (i, "s")
        return self.symbol(*named, spring.damping, unit, f"damping of {self._spring(i)}")

    def free_angle(self, i: int) -> Sum:
        spring = self.description.springs[i]
        assert isinstance(spring, JointSpring)
        named = f"phi{i + 1}", Role.length, (i, "phi")
        return self.symbol(*named, spring.angle, "rad", f"free angle of {self._spring(i)}")

    def free_length(self, i: int) -> Sum:
        spring = self.description.springs[i]
        assert isinstance(spring, Spring)
        named = f"S0{i + 1}", Role.length, (i, "S0")
        return self.symbol(*named, spring.length, "m", f"free length of {self._spring(i)}")

    def ends(self, i: int) -> tuple[Planar, Planar]:
        """The ends of a spring between points, each in its own frame."""
        spring = self.description.springs[i]
        assert isinstance(spring, Spring)
        found = []
        for letter, point in (("e", spring.first), ("h", spring.second)):
            names = f"{letter}{i + 1}x", f"{letter}{i + 1}y"
            meaning = f"end of spring {i + 1} {self.on(point)}"
            place = len(self.description.links) + i, letter  # after lengths
            found.append(self.point(point, names, place, meaning))
        return found[0], found[1]

    def force(self, i: int) -> Planar:
        load = self.description.loads[i]
        assert isinstance(load, Load)
        frame = "its link's frame" if load.turns else "the ground's frame"
        meaning = f"force of load {i + 1}, in {frame}"
        names = f"F{i + 1}x", f"F{i + 1}y"
        return self.pair(names, (i, "F"), load.force, meaning, Role.force, "N")

    def load_point(self, i: int) -> Planar:
        """Where a force acts, in its link's frame."""
        load = self.description.loads[i]
        assert isinstance(load, Load)
        meaning = f"point of load {i + 1} {self.on(load.point)}"
        return self.point(load.point, (f"c{i + 1}x", f"c{i + 1}y"), (i, "c"), meaning)

    def torque(self, i: int) -> Sum:
        load = self.description.loads[i]
        assert isinstance(load, Moment)
        name = self.description.links[load.link].name
        named = f"T{i + 1}", Role.force, (i, "T")
        return self.symbol(*named, load.torque, "N m", f"torque of load {i + 1} on {name}")

    def _spring(self, i: int) -> str:
        spring = self.description.springs[i]
        if isinstance(spring, JointSpring):
            return f"spring {i + 1}, at the joint of {self.description.links[spring.joint].name}"
        return f"spring {i + 1}"
