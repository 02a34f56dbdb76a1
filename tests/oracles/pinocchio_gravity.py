"""Gravity torques of a D-H chain by pinocchio."""

import numpy as np
import pinocchio as pin

from tests.oracles.pinocchio_chain import PinocchioChain


class PinocchioGravity:
    """A D-H chain with a mass on each link, given in the frame after the joint's rotation."""

    def __init__(self, mass, centre, gravity) -> None:
        self.chain = PinocchioChain(len(mass))
        model = self.chain.model
        for link, (m, c) in enumerate(zip(mass, centre, strict=True)):
            inertia = pin.Inertia(float(m), np.asarray(c), np.zeros((3, 3)))
            model.appendBodyToJoint(5 * link + 1, inertia, pin.SE3.Identity())
        model.gravity.linear = np.asarray(gravity)
        self.data = model.createData()

    def holding_torque(self, theta, s, a, alpha):
        q = self.chain.q_of(theta, s, a, alpha)
        return pin.computeGeneralizedGravity(self.chain.model, self.data, q)[::5]

    def energy(self, theta, s, a, alpha):
        q = self.chain.q_of(theta, s, a, alpha)
        return pin.computePotentialEnergy(self.chain.model, self.data, q)
