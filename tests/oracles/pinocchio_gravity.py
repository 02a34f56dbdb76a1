"""Gravity of a D-H chain whose links have masses, by pinocchio. Tests only."""

import numpy as np
import pinocchio as pin

from tests.oracles.pinocchio_chain import PinocchioChain


class PinocchioGravity:
    """Torque that holds a D-H chain up; a link's mass hangs where its joint turns."""

    def __init__(self, mass, centre, gravity) -> None:
        self.chain = PinocchioChain(len(mass))
        model = self.chain.model
        for link, (m, c) in enumerate(zip(mass, centre, strict=True)):
            inertia = pin.Inertia(float(m), np.asarray(c), np.zeros((3, 3)))
            model.appendBodyToJoint(5 * link + 1, inertia, pin.SE3.Identity())
        model.gravity.linear = np.asarray(gravity)
        self.data = model.createData()

    def holding_torque(self, theta, s, a, alpha):
        """Torque (links,) about every joint of one pose, N m."""
        q = self.chain.q_of(theta, s, a, alpha)
        return pin.computeGeneralizedGravity(self.chain.model, self.data, q)[::5]

    def energy(self, theta, s, a, alpha):
        """Potential energy of one pose, J."""
        q = self.chain.q_of(theta, s, a, alpha)
        return pin.computePotentialEnergy(self.chain.model, self.data, q)
